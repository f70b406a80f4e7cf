"""Our solvers beside the public ones, Sionna RT and DiffeRT, on the same rooms: first the paths, then time and error.

In come a budget of seconds and the numbers of reflections; out go tables. `solvers` makes the rooms, and with `differt`
it brings every solver into one form. `run` times each in a process of its own, and prints.
"""
