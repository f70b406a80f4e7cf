"""A tiny collection of rooms: a wall mirrors every transmitter, in each room at another distance, no rays traced."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from xfreqbench.data.collection import Collection, Room, room_of, write_collection
from xfreqbench.data.schema import DatasetHeader
from xfreqbench.data.unseen_rooms import ASKED_GHZ, HEARD_GHZ
from xfreqbench.data.writer import PasWriter, SampleBlock
from xfreqbench.maps.bartlett import BartlettBeam
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.scene.array import steering_vector
from xfreqbench.scene.model import ReceiverArray, Scene, Surface
from xfreqbench.units import SPEED_OF_LIGHT_M_S, ghz_to_hz

CARRIER_HZ = np.array(sorted(map(ghz_to_hz, (*HEARD_GHZ, *ASKED_GHZ))))
NUM_TX = 80  # as many as the protocol needs
REFLECTION = 0.8


def write_room(path: Path, seed: int, num_tx: int = NUM_TX, maps: bool = False, moved_m: float = 0.0) -> None:
    """The data set of the room that a seed makes, its wall moved."""
    random = np.random.default_rng(seed)
    wall_m, receiver = float(random.uniform(1.5, 4.0)) + moved_m, ReceiverArray(position_m=(0.0, 0.0, 2.6))
    wall = Surface(f"wall {seed}", "wood", 0.02, (wall_m, -5.0, 0.0), (wall_m, 5.0, 3.0))
    scene = Scene(f"room {seed}", receiver, surface=(wall,))
    tx_position_m = random.uniform((-4.0, -4.0, 0.8), (wall_m - 0.3, 4.0, 1.8), size=(num_tx, 3))
    header = DatasetHeader(
        scene_name=scene.name,
        scene_json=scene.canonical_json,
        scene_sha256="0" * 64,
        receiver=receiver,
        carrier_hz=CARRIER_HZ,
        num_tx=num_tx,
        pas_kind="power",
        maps=maps,
        settings={},
        software={},
        rejected={},
    )
    element = receiver.element_position_wavelengths
    source_m = np.stack([tx_position_m, tx_position_m * (-1, 1, 1) + (2 * wall_m, 0, 0)], axis=1)  # and its image
    offset_m = (source_m - receiver.position_m) @ receiver.rotation
    length_m = np.linalg.norm(offset_m, axis=2)
    travel = np.exp(-2j * np.pi * length_m[:, None] * CARRIER_HZ[:, None] / SPEED_OF_LIGHT_M_S)
    # positions in wavelengths are positions in metres at a wavelength of one metre
    response = steering_vector(element, offset_m / length_m[..., None], SPEED_OF_LIGHT_M_S)
    cfr = np.einsum("tp,tfp,tpm->tfm", np.array([1, REFLECTION]) / length_m, travel, response)
    beam = BartlettBeam(element, AngularGrid.hemisphere())
    with PasWriter(path, header) as writer:
        samples = SampleBlock.of_channels(cfr, np.full(cfr.shape[:2], 2), beam, "power")
        writer.append(tx_position_m, np.ones(num_tx, bool), samples)


def tiny_rooms(folder: Path, **counts: int) -> Collection:
    """A collection with so many rooms of each part, as in `train=4, validation=1, test=2, other=1`."""
    rooms, left = list[Room](), dict(counts)
    for seed in range(1000):
        percent = Room(seed, "box", "a.h5", "0" * 64, 1).percent
        part = "train" if percent < 80 else "validation" if percent < 90 else "test"
        name, kind = (part, "box") if left.get(part) else ("other", "hall")
        if not left.get(name):
            continue
        left[name] -= 1
        write_room(folder / f"{seed}.h5", seed)
        rooms.append(room_of(folder, f"{seed}.h5", seed, kind))
    told = {"name": "tiny", "family": {"walls": 1}, "options": {}, "held_out_types": ["hall"]}
    return write_collection(folder, rooms, carrier_hz=CARRIER_HZ.tolist(), **told)
