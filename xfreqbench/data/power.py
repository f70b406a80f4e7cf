"""The received power of samples: at the array, averaged about a transmitter's position, and in dBm."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from pydantic import FiniteFloat, InstanceOf, PositiveFloat

from xfreqbench.data.dataset import PasDataset, stored_paths
from xfreqbench.errors import DataError
from xfreqbench.system.arguments import checked
from xfreqbench.types import FloatArray


@checked
def power_db(data: InstanceOf[PasDataset], radius_wavelengths: PositiveFloat | None = None) -> Float[FloatArray, "N"]:
    """Received over transmitted power of each sample in dB: the mean of `|h|²` over the array's elements.

    With a radius, it is the power at the array centre, averaged over the transmitter's position: the mean over a
    horizontal disc about it, by its paths as plane waves; with `math.inf` it is the sum of the powers of the paths.
    It is −inf if no path arrives. Raises `DataError` for data without channels, and with a radius as `PasDataset.paths`
    does.
    """
    if radius_wavelengths is None:
        power = np.mean(np.abs(data.cfr.astype(np.complex128)) ** 2, axis=1)
    else:
        tx, place = np.unique(data.tx_index, return_inverse=True)
        of_tx = stored_paths(data)[0].mean_power(data.header.carrier_hz, tx, radius_wavelengths)
        power = of_tx[place, data.rows % data.header.num_carriers]
    with np.errstate(divide="ignore"):
        return np.asarray(10 * np.log10(power))


@checked
def received_power_dbm(
    data: InstanceOf[PasDataset], transmit_power_dbm: FiniteFloat | None = None
) -> Float[FloatArray, "N"]:
    """Received power of each sample in dBm: `power_db` plus the power that each transmitter sends.

    The default is `power_dbm` in the `[transmitters]` of the scene. Raises `DataError` if the scene gives none, and
    as `power_db` does.
    """
    if transmit_power_dbm is None and (transmitters := data.scene.transmitters):
        transmit_power_dbm = transmitters.power_dbm
    if transmit_power_dbm is None:
        raise DataError(
            f"The scene of {data.path} gives no transmit power. Give it, as in received_power_dbm(data, 20.0), or "
            "write power_dbm = 20.0 into the [transmitters] of the scene."
        )
    return power_db(data) + transmit_power_dbm
