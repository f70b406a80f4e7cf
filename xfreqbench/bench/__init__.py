"""Measurements of speed and accuracy, and of numerical stability (`stress`): what `xfreqbench bench …` prints.

In come a scene or settings of a method; tables and figures come out, printed row by row and stored as records for a
report. `solvers` measures error against run time, `savings` what each optimisation gains, `rendering` splatting and
training steps, `executors` distributed work. `tables` prints and stores all of them.
"""
