from __future__ import annotations

import numpy as np
import torch
from xfreqbench.baselines.virtual_source.field.images import Mirrors
from xfreqbench.baselines.virtual_source.findings.compared import axes_within

ROUNDING = 4 * np.finfo(np.float64).eps  # torch may fuse the two products of a cross product, NumPy rounds each


def normals() -> np.ndarray:
    """Unit vectors along the axes, a little off them, on either side of where the first axis changes, and anywhere."""
    random = np.random.default_rng(0)
    along = np.concatenate([np.eye(3), -np.eye(3)])
    near = along.repeat(20, axis=0) + 1e-3 * random.normal(size=(120, 3))
    almost_level = np.array([[0.0999, 0, 1], [0, 0.0999, -1], [0.1011, 0, 1], [0, -0.1011, 1]])
    every = np.concatenate([along, near, almost_level, random.normal(size=(200, 3))])
    return every / np.linalg.norm(every, axis=1, keepdims=True)


def test_a_found_rectangle_is_read_along_the_axes_that_it_was_written_along() -> None:
    normal = normals()
    written = Mirrors.of_tensors(torch.as_tensor(normal), torch.ones(len(normal), dtype=torch.float64)).axes
    read = np.array([axes_within(unit) for unit in normal])
    np.testing.assert_allclose(read, written.numpy(), rtol=0, atol=ROUNDING)


def test_axes_within_a_plane_are_level_where_they_can_be() -> None:
    for normal in normals():
        first, second = axes_within(normal)
        np.testing.assert_allclose(
            np.stack([first, second, normal]) @ np.stack([first, second, normal]).T, np.eye(3), atol=ROUNDING
        )
        is_level_plane = np.hypot(normal[0], normal[1]) <= 0.1
        assert (first[0] > 0.99) if is_level_plane else (abs(first[2]) < ROUNDING)
