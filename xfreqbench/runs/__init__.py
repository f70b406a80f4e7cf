"""Runs: a method is fitted on the training rows of a split, predicts the test rows, and is scored.

In come jobs, each of which names a data set, a split, a method, a seed and a budget. Out come files in a results
folder: predicted maps, and one record a run with the scores of the maps as they were stored. The way of a job is
`jobs` (it gets its data set, split and method), `run` (here or on workers: fit, predict, store, score, record), `fit`
(checkpoints and the learning curve), `scoring`, and `folder` (where results are kept).
"""
