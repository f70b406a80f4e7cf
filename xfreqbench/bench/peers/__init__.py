"""Our solvers beside the public ones, Sionna RT and DiffeRT, on the same rooms: first the paths, then time and error.

In come a budget of seconds and the numbers of reflections; out go tables. `rooms` makes the rooms, `solvers` and
`differt` bring every solver into one form, `measure` times one in a process of its own, and `run` prints.
"""
