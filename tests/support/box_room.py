"""A closed room of six walls, and planes as a search finds them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from xfreqbench.baselines.virtual_source.search.planes import Plane

SIZE_M = (5.0, 4.0, 2.6)


def plane(normal: Sequence[float], distance_m: float) -> Plane:
    return Plane(np.array(normal, dtype=float), distance_m, 1e-4, 1e-4, 0.0)
