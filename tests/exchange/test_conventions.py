"""How publishers draw their maps: pixels against the formulas of their code, written out here once more."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.transform import Rotation

from tests.support.fuzzing.common import xfreqbench
from tests.support.places import ROOT
from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.errors import DataError, MethodError, UnknownNameError
from xfreqbench.exchange.conventions import CONVENTIONS, NO_CONVENTIONS, convention_named
from xfreqbench.exchange.png_dataset import import_png_folder
from xfreqbench.exchange.png_folder import read_png_folder
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.fitting import fit_within
from xfreqbench.methods.registry import build_method
from xfreqbench.units import SPEED_OF_LIGHT_M_S

GATEWAY_M = np.array([5.0, 0.26, 0.4])
TURNED = (0.51291602, -0.48674136, -0.48674136, 0.51291602)  # of the RFID scene: array on a wall
TURNED_ABOUT_ITS_POLE = (0.1, 0.2, 0.55, 0.8)
TRANSMITTERS_M = np.array([[25.0, 40.0, 9.0], [-30.0, 21.0, -14.0], [4.0, -35.0, 20.0], [11.0, 33.0, -26.0]])


def lone_wave(transmitter_m: np.ndarray, quaternion_xyzw: tuple[float, ...]) -> np.ndarray:
    """Direction from the gateway to a transmitter, in the gateway's frame."""
    offset_m = transmitter_m - GATEWAY_M
    return Rotation.from_quat(quaternion_xyzw).as_matrix().T @ offset_m / np.linalg.norm(offset_m)


def nerf2_levels(arrival: np.ndarray) -> np.ndarray:
    """The generator of NeRF2 on a reader's phases, which grow with distance."""
    ticks_m = (np.arange(4) - 1.5) * 0.16
    element_m = np.array([[x, y, 0.0] for y in ticks_m for x in ticks_m])
    wavenumber = 2 * np.pi * 920e6 / SPEED_OF_LIGHT_M_S
    elevation, azimuth = np.radians(np.arange(1, 91))[:, None], np.radians(np.arange(360))[None]
    looks = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)], axis=-1)
    measured, expected = -wavenumber * element_m @ arrival, -wavenumber * looks @ element_m[:, :2].T
    beam = abs(np.exp(1j * (expected - measured)).sum(axis=-1))
    return ((beam - beam.min()) / np.ptp(beam) * 255).astype(np.uint8)


def xfreq_gs_levels(arrival: np.ndarray) -> np.ndarray:
    """The builder of XFreq-GS on a channel whose phases lead at the elements nearer to the source."""
    ticks = (np.arange(4) - 1.5) * np.pi  # half a wavelength, in radians
    element = np.array([[0.0, y, z] for z in ticks for y in ticks])
    polar, azimuth = np.linspace(0, np.pi / 2, 90)[:, None], np.linspace(-np.pi, np.pi, 360)[None]
    axes = np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)
    looks = np.stack(np.broadcast_arrays(*axes), -1)
    phase = np.angle(np.exp(1j * element @ arrival))
    beam = abs(np.exp(1j * (-(looks @ element.T) - phase)).sum(axis=-1))
    return (beam / beam.max() * 255).astype(np.uint8)


def folder_of_lone_waves(folder: Path, name: str, quaternion_xyzw: tuple[float, ...]) -> PasDataset:
    """Transmitters without a room, drawn by the publisher's formula and imported by its convention."""
    draw = {"nerf2": nerf2_levels, "xfreq-gs": xfreq_gs_levels}[name]
    (folder / "spectrum").mkdir(parents=True)
    for number, transmitter_m in enumerate(TRANSMITTERS_M, start=1):
        image = Image.fromarray(draw(lone_wave(transmitter_m, quaternion_xyzw)))
        image.save(folder / "spectrum" / f"{number:05d}.png")
    rows = [",".join(map(str, position_m)) for position_m in TRANSMITTERS_M.tolist()]
    (folder / "tx_pos.csv").write_text("\n".join(["x,y,z", *rows]))
    (folder / "gateway_info.yml").write_text(
        f"gateway1:\n  position: {GATEWAY_M.tolist()}\n  orientation: {list(quaternion_xyzw)}\n"
    )
    source = read_png_folder(folder, CONVENTIONS[name], carrier_ghz=0.92)
    import_png_folder(source, folder / "data.h5")
    return open_dataset(folder / "data.h5")


@pytest.mark.parametrize("quaternion_xyzw", [(0.0, 0.0, 0.0, 1.0), TURNED, TURNED_ABOUT_ITS_POLE])
@pytest.mark.parametrize("name", ["nerf2", "xfreq-gs"])
def test_lone_waves_at_a_turned_receiver_are_seen_where_their_transmitters_are(
    tmp_path: Path, name: str, quaternion_xyzw: tuple[float, ...]
) -> None:
    dataset = folder_of_lone_waves(tmp_path, name, quaternion_xyzw)
    method = build_method("line-of-sight")
    fit_within(method, dataset, Budget(), seed=0)
    predicted = method.predict(dataset.tx_position_m, dataset.carrier_hz)
    # less than a level is cut off; a pixel, or an array 2 % wider, is 0.04 and more
    np.testing.assert_allclose(dataset.pas(), predicted, atol=1.1 / 255)


@pytest.mark.parametrize(
    ("name", "row", "column", "elevation_deg", "azimuth_deg"),
    [
        ("wideband3dgs", 0, 5, 90, None),
        ("wideband3dgs", 89, 0, 0, -180),
        ("wideband3dgs", 89, 359, 0, 180),
        ("xfreq-gs", 89, 0, 0, -180),
        ("nerf2", 0, 0, 1, 0),
        ("nerf2", 89, 7, 90, None),
        ("wrf-gs", 44, 359, 45, 359),
        ("gsrf", 29, 90, 30, 90),
    ],
)
def test_a_published_pixel_keeps_its_direction(
    name: str, row: int, column: int, elevation_deg: float, azimuth_deg: float | None
) -> None:
    convention = CONVENTIONS[name]
    published = np.zeros((90, 360), np.uint8)
    published[row, column] = 255
    place = np.unravel_index(convention.ascending(published).argmax(), published.shape)
    grid = convention.grid(90, 360)
    assert np.degrees(grid.elevation_rad[place[0]]) == pytest.approx(elevation_deg)
    if azimuth_deg is not None:  # every column of the pole's row is the pole
        assert np.degrees(grid.azimuth_rad[place[1]]) == pytest.approx(azimuth_deg)


def test_columns_that_descend_are_turned_over_and_back() -> None:
    convention = convention_named("nerf2", ["first_column_deg=359", "last_column_deg=0"])
    published = np.arange(12, dtype=np.uint8).reshape(3, 4)
    np.testing.assert_array_equal(convention.ascending(published), published[:, ::-1])
    np.testing.assert_array_equal(convention.ascending(convention.ascending(published)), published)
    assert (np.diff(convention.grid(3, 4).azimuth_rad) > 0).all()


@given(
    quaternion=st.tuples(*[st.floats(-2, 2)] * 4),
    order=st.sampled_from(["xyzw", "wxyz"]),
    peak=st.sampled_from(["source", "opposite"]),
    plane=st.sampled_from(["xy", "yz"]),
)
def test_a_quaternion_comes_back_to_the_last_bit(
    quaternion: tuple[float, ...], order: str, peak: str, plane: str
) -> None:
    changes = [f"quaternion={order}", f"peak={peak}", f"plane={plane}"]
    convention = convention_named("nerf2", changes)
    assert convention.published_quaternion(convention.quaternion_xyzw(quaternion)) == quaternion


@pytest.mark.parametrize(("plane", "normal"), [("xy", (0, 0, 1)), ("yz", (1, 0, 0))])
def test_maps_that_peak_opposite_are_those_of_an_array_turned_half_round(
    plane: str, normal: tuple[int, int, int]
) -> None:
    convention = convention_named("nerf2", ["peak=opposite", f"plane={plane}"])
    turned = Rotation.from_quat(convention.quaternion_xyzw(TURNED_ABOUT_ITS_POLE)).as_matrix()
    half_turn = Rotation.from_rotvec(np.pi * np.array(normal)).as_matrix()
    np.testing.assert_allclose(turned, Rotation.from_quat(TURNED_ABOUT_ITS_POLE).as_matrix() @ half_turn, atol=1e-12)


def test_a_quaternion_that_begins_with_w_is_stated_so() -> None:
    wxyz = (TURNED[3], *TURNED[:3])
    assert convention_named("nerf2", ["quaternion=wxyz"]).quaternion_xyzw(wxyz) == TURNED


@pytest.mark.parametrize(
    ("assignments", "error", "message"),
    [
        (["first_rows_deg=0"], UnknownNameError, "first_row_deg"),
        (["values=decibel"], MethodError, "phase-only-amplitude"),
        (["array_rows=0"], MethodError, "array_rows"),
        (["first_row_deg=nan"], MethodError, "first_row_deg"),
        (["last_row_deg=100"], DataError, "from 1 to 100 degrees"),
        (["last_row_deg=1"], DataError, "from 1 to 1 degrees"),
        (["last_column_deg=0"], DataError, "span 0;"),
        (["last_column_deg=400"], DataError, "span 400;"),
    ],
)
def test_a_convention_that_cannot_be_is_refused(assignments: list[str], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        convention_named("nerf2", assignments)
    with pytest.raises(UnknownNameError, match="'wideband3dgs'"):
        convention_named("wideband-3dgs")


@pytest.mark.parametrize("name", NO_CONVENTIONS)
def test_what_cannot_come_in_is_answered_with_the_reason(name: str, tmp_path: Path) -> None:
    told = xfreqbench("import", tmp_path, "-o", tmp_path / "out.h5", "--convention", name)
    assert told.code == 2
    assert f"There is no convention {name!r}. {NO_CONVENTIONS[name]}" in told.stderr
    assert f"{name}: none. {NO_CONVENTIONS[name]}" in xfreqbench("import", "--conventions").stdout
    assert f"`{name}`" in (ROOT / "docs" / "data-format.md").read_text("utf-8")


@pytest.mark.sionna
def test_maps_of_xfreq_gs_are_stretched_by_its_builder() -> None:
    """As its caveat says: it solves at 3.5 GHz and takes the carrier for an offset, here 1 GHz."""
    from xfreqbench.tracing.sionna.llvm import ensure_llvm

    ensure_llvm()
    import sionna.rt as rt

    scene = rt.load_scene()
    one, four = {"num_rows": 1, "num_cols": 1}, {"num_rows": 4, "num_cols": 4}
    scene.tx_array, scene.rx_array = (rt.PlanarArray(**size, pattern="iso", polarization="V") for size in (one, four))
    source = np.array([3.0, 0.4, -0.5])
    scene.add(rt.Transmitter("tx", position=source.tolist()))
    scene.add(rt.Receiver("rx", position=[0.0, 0.0, 0.0]))
    paths = rt.PathSolver()(scene, max_depth=0, synthetic_array=False, samples_per_src=1000)
    cfr = np.asarray(paths.cfr(1e9, normalize=True, out_type="numpy")).ravel()
    element = scene.rx_array.positions(1.0).numpy().T  # in wavelengths
    grid = CONVENTIONS["xfreq-gs"].grid(90, 360)
    drawn = np.abs((np.exp(-2j * np.pi * grid.directions @ element.T) * np.exp(-1j * np.angle(cfr))).sum(-1))
    row, column = np.unravel_index(drawn.argmax(), drawn.shape)
    opposite = -source / np.linalg.norm(source)
    stretched = (1 + 1 / 3.5) * opposite[1:]
    np.testing.assert_allclose(grid.directions[row, column][1:], stretched, atol=0.02)  # a degree a pixel
