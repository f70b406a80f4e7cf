"""The predictors that learn nothing, of which every other method has to beat the best."""

from __future__ import annotations

from .line_of_sight import LineOfSight
from .log_frequency import LogFrequency
from .mean_over_frequency import MeanOverFrequency
from .nearest import Nearest

TRIVIAL = (LineOfSight, Nearest, MeanOverFrequency, LogFrequency)
