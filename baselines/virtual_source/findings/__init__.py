"""Compares what a method says it has learned with the true scene: `xfreqbench findings` and `xfreqbench residual`.

In come a run's record, whose findings are planes and images, and its data set; `compared` finds the surfaces that the
planes show. Out go a page, tables, figures and a 3D model (`write`), the room as a scene (`room`), and tables that say
which of the true paths the run's maps lack (`residual`).
"""
