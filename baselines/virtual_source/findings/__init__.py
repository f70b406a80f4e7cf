"""Compares what a method says it has learned with the true scene: `xfreqbench findings` and `xfreqbench residual`.

In come a run's record, whose findings are planes and images, and its data set; `match` finds the surfaces that the
planes show. Out go tables, figures and a 3D model of the findings (`write`), and tables that say which of the true
paths the run's maps lack (`residual`).
"""
