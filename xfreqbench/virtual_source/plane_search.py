"""Directions of the reflecting planes of a room, found in power maps alone.

Every place of the receiver's mirror image is tried at the lowest carrier, the best are followed from carrier to
carrier, and those that neither chance nor other planes explain are kept.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from xfreqbench.angles import FloatArray
from xfreqbench.virtual_source.coarse_search import coarse_maxima_m
from xfreqbench.virtual_source.fine_search import refined_m, settled
from xfreqbench.virtual_source.line_of_sight import LineOfSightReference
from xfreqbench.virtual_source.selection import accepted, missed


def mirrored_receivers_m(
    reference: LineOfSightReference, generator: np.random.Generator | int
) -> Float[FloatArray, "P 3"]:
    """Images of the receiver in the planes that speak from the maps, the strongest first; there may be none.

    Upright planes of any azimuth, floors and ceilings, which may lean by a few degrees. `generator` chooses the
    transmitters of the coarse search where there are too many. No line-of-sight flag is looked at.

    A path by two planes that are found is not taken for a third. Where all transmitters stand at one height,
    a floor can't be told from a ceiling, and neither is returned.
    """
    if not len(reference.offset_m):
        return np.zeros((0, 3))
    places_m = refined_m(reference, coarse_maxima_m(reference, np.random.default_rng(generator)))
    candidates = [settled(reference, place) for place in places_m]
    found = accepted(reference, candidates)
    if more := missed(reference, found):
        found = accepted(reference, [*candidates, *more])
    return np.array([candidate.place_m for candidate in found]).reshape(-1, 3)
