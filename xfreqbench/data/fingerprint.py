"""Fingerprints: a few channels of each shipped scene, with which every data set of the scene is compared."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
from jaxtyping import Complex, Float
from pydantic import BaseModel, ValidationError

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.recipe import Recipe, micrometres
from xfreqbench.errors import DataError
from xfreqbench.scene.toml_files import shipped_folder
from xfreqbench.system.array_files import read_arrays
from xfreqbench.types import FloatArray, NDArray
from xfreqbench.units import format_ghz

TOLERANCE = 1e-3  # of solver `image`; traced with other carriers, shipped scenes differ by up to 5e-4
MIN_TRANSMITTERS = 4  # in common; with fewer, none may see what was changed
_ADVICE = "If it came with xfreqbench, install that again; otherwise make it again."


class _About(BaseModel):
    scene: str
    physics_sha256: str


@dataclass(frozen=True)
class Fingerprint:
    """Channels (T, F, M) of a scene at T transmitters and F carriers, for one `Recipe.physics_sha256`."""

    scene_name: str
    physics_sha256: str
    tx_position_m: Float[FloatArray, "T 3"]
    carrier_hz: Float[FloatArray, "F"]
    cfr: Complex[NDArray[np.complex64], "T F M"]


@dataclass(frozen=True)
class FingerprintMatch:
    """The difference of a data set from the fingerprint of its recipe.

    `difference` is ‖h − h′‖ / ‖h′‖, where h is stored and h′ is the fingerprint: the median over the transmitters in
    common, at the carrier where that is greatest, `worst_carrier_hz`. `tolerance` is the limit for the solver. If
    nothing was compared, `difference` is None, and `why_not` gives the reason.
    """

    recipe: Recipe
    tolerance: float = TOLERANCE
    num_tx: int = 0
    num_carriers: int = 0
    difference: float | None = None
    worst_carrier_hz: float = 0.0
    why_not: str = ""

    @property
    def difference_db(self) -> float:
        """`difference` in decibels, −∞ if the channels are equal; raises `ValueError` if none were compared."""
        if self.difference is None:
            raise ValueError(self.why_not)
        with np.errstate(divide="ignore"):
            return float(20 * np.log10(self.difference))

    @property
    def is_off(self) -> bool:
        """Whether the channels differ by more than `tolerance`, so that `run` refuses them."""
        return self.difference is not None and not self.difference <= self.tolerance

    @property
    def verdict(self) -> str:
        """The line that `generate` and `info` print."""
        if self.difference is None:
            return f"fingerprint of {self.recipe}: nothing to compare with, {self}"
        refused = f"; run and score refuse more than {self.tolerance:g}" if self.is_off else ""
        finding = "differs from" if self.is_off else "matches"
        return f"fingerprint of {self.recipe}: {finding} the reference, {self}{refused}"

    def __str__(self) -> str:
        if self.difference is None:
            return self.why_not
        in_common = f"{self.num_tx} transmitters × {self.num_carriers} carriers in common"
        if self.difference == 0:
            return f"to the last digit at half of the transmitters or more ({in_common})"
        return (
            f"{self.difference_db:.0f} dB off: a median relative field error of {self.difference:.1e} at "
            f"{format_ghz(self.worst_carrier_hz)}, the worst carrier ({in_common})"
        )


def compare_fingerprint(dataset: PasDataset) -> FingerprintMatch:
    """Compare a whole data set with the fingerprint of its recipe, in milliseconds.

    Transmitters are matched by their positions to a micrometre. Raises `DataError` if a shipped fingerprint is
    damaged.
    """
    # Sionna misses more of the weak paths: up to 4e-2 with the default rays
    tolerance = 1e-1 if dataset.header.settings.get("solver") == "sionna" else TOLERANCE
    match = partial(FingerprintMatch, dataset.recipe, tolerance)
    known = _shipped().get(dataset.recipe.physics_sha256 or "")
    if known is None:
        return match(why_not="as xfreqbench ships no reference of this scene with these settings")
    of_stored = {place: tx for tx, place in enumerate(_places(dataset.tables["tx_position_m"]))}
    places = _places(known.tx_position_m)
    pairs = [(of_stored[place], tx) for tx, place in enumerate(places) if place in of_stored]
    carriers_hz, stored, fingerprint = np.intersect1d(
        dataset.header.carrier_hz, known.carrier_hz, assume_unique=True, return_indices=True
    )
    if len(pairs) < MIN_TRANSMITTERS or not len(carriers_hz):
        return match(
            why_not=f"as the data share {len(pairs)} of the reference's {len(places)} transmitters and "
            f"{len(carriers_hz)} of its {len(known.carrier_hz)} carriers, and {MIN_TRANSMITTERS} and 1 are needed"
        )
    stored_tx, known_tx = np.transpose(pairs)
    of_both = dataset.tables["cfr"][np.ix_(stored_tx, stored)], known.cfr[np.ix_(known_tx, fingerprint)]
    difference = field_differences(*of_both)
    worst = int(difference.argmax())
    return match(len(pairs), len(carriers_hz), float(difference[worst]), float(carriers_hz[worst]))


def require_fingerprint(dataset: PasDataset) -> FingerprintMatch:
    """As `compare_fingerprint`; raises `DataError` for channels that differ by more than the tolerance."""
    match = compare_fingerprint(dataset)
    if match.is_off:
        raise DataError(
            f"{dataset.path} says that it is {match.recipe}, but its channels differ from the reference of that: "
            f"{match}; {match.tolerance:g} is allowed. They were traced in another scene, with too few rays or "
            "by other software, or were changed afterwards. Generate them again, as with: xfreqbench generate "
            f"{match.recipe.scene_name}; a scene of your own is generated from its own TOML."
        )
    return match


def field_differences(
    cfr: Complex[NDArray[np.complexfloating], "T F M"], expected: Complex[NDArray[np.complexfloating], "T F M"]
) -> Float[FloatArray, "F"]:
    """Median over T transmitters of ‖h − h′‖ / ‖h′‖, at each carrier, over M elements; h′ is `expected`.

    It is the median, because a solver may miss a rare path of single transmitters. Without a path in h′ the quotient
    is 0 if h has none either, and otherwise infinite.
    """
    off, length = (np.linalg.norm(vector, axis=2) for vector in (cfr - expected.astype(complex), expected))
    relative = np.where(off == 0, 0.0, np.inf)
    np.divide(off, length, out=relative, where=length > 0)
    return np.median(relative, axis=0)


def read_fingerprint(path: Path) -> Fingerprint:
    """A stored fingerprint; raises `DataError` if it is missing or damaged."""
    wanted = {"about": "text", "tx_position_m": "<f8 T 3", "carrier_hz": "<f8 F", "cfr": "<c8 T F M"}
    stored = read_arrays(path, wanted, _ADVICE)
    try:
        about = _About.model_validate_json(str(stored.pop("about")))
    except ValidationError as error:
        raise DataError(f"{path} does not name its scene. {_ADVICE}") from error
    return Fingerprint(about.scene, about.physics_sha256, **stored)


@cache
def _shipped() -> dict[str, Fingerprint]:
    """The fingerprint of every shipped scene, by the hash of its physics."""
    fingerprints = map(read_fingerprint, sorted(shipped_folder().glob("*_fingerprint.npz")))
    return {fingerprint.physics_sha256: fingerprint for fingerprint in fingerprints}


def _places(tx_position_m: Float[FloatArray, "T 3"]) -> list[tuple[int, ...]]:
    return [tuple(place) for place in micrometres(tx_position_m).tolist()]
