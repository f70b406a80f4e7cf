"""The page that says what a data set or a scene holds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from xfreqbench.dataset import PasDataset
from xfreqbench.errors import ProtocolError
from xfreqbench.markdown import ABSENT, number
from xfreqbench.materials import complex_permittivity, material_bands
from xfreqbench.page.document import Link, Part, Picture, Section, Table, document
from xfreqbench.protocols import PROTOCOLS, Split, make_splits
from xfreqbench.scene import ReceiverArray
from xfreqbench.units import VACUUM_PERMITTIVITY_F_M, format_ghz, format_ghz_list
from xfreqbench.view_scene import MAX_RAYS, RAY_RANGE_DB
from xfreqbench.view_summary import CarrierSummary
from xfreqbench.viewing import View


def view_page(view: View, summary: CarrierSummary | None, pictures: Mapping[str, Picture], model: str) -> str:
    """HTML of a view with its rays; `summary` is of its data set, None without one.

    `pictures` go by their file names, `scene.png`, `pas.png` and `carriers.svg`; `model` names the 3D model.
    """
    sections = [Section("Scene", [*_scene_parts(view, pictures["scene.png"], model)])]
    if view.dataset and summary:
        maps, carriers = pictures["pas.png"], pictures["carriers.svg"]
        sections += [
            Section(f"Maps of transmitter {view.room.tx}", [_maps_note(view), maps]),
            Section("From carrier to carrier", [*_carrier_parts(view, summary), carriers]),
            Section("Protocols it can serve", [*_protocol_parts(view.dataset)]),
            Section("Load it", [_code(view.dataset)]),
        ]
    sections.append(Section("Where it comes from", [*_origin_parts(view)]))
    return document(_title(view), _lead(view), view.subject, _facts(view), sections)


def _title(view: View) -> str:
    return f"{view.dataset.path.name}: {view.header.scene_name}" if view.dataset else view.header.scene_name


def _lead(view: View) -> str:
    description = view.scene.description if view.scene else ""
    what = (
        f"{view.header.num_tx:,} transmitters × {len(view.header.carrier_hz)} carriers = "
        f"{view.header.num_tx * len(view.header.carrier_hz):,} power angular spectra."
        if view.dataset
        else "A scene, without data: `xfreqbench generate` would use these transmitters."
    )
    return f"{what} {description}".strip()


def _facts(view: View) -> dict[str, str]:
    header, room = view.header, view.room
    facts = {"Receiver": _receiver(header.receiver), "Transmitters": _transmitters(view)}
    if header.rejected:
        left_out = [f"{count} {why}" for why, count in header.rejected.items() if count]
        facts["Left out"] = ", ".join(left_out) or "nothing"
    if view.dataset:
        facts |= {"Carriers": format_ghz_list(header.carrier_hz), "Maps": _maps(view.dataset)}
    if view.settings:
        facts["Rays"] = (
            f"{view.settings.solver} solver, {', '.join(view.settings.interactions)}, depth "
            f"{view.settings.max_depth}, {view.settings.rays:,} rays, seed {view.settings.seed}"
        )
    if view.dataset:
        facts["File"] = f"{view.dataset.path.stat().st_size / 1e6:,.1f} MB"
    return facts | {"Shown": f"transmitter {room.tx} at {_metres(room.tx_m)}"}


def _receiver(receiver: ReceiverArray) -> str:
    return (
        f"{receiver.rows} × {receiver.cols} elements {receiver.spacing_wavelengths:g} wavelengths apart at "
        f"{_metres(receiver.position_m)}, boresight {_vector(receiver.boresight)}, {receiver.pattern} pattern, "
        f"polarization {receiver.polarization}, in plane {receiver.plane} of its frame"
    )


def _transmitters(view: View) -> str:
    in_sight = view.room.in_sight
    if in_sight is None:
        return f"{view.header.num_tx:,}, sight of the receiver not published"
    return f"{in_sight.sum():,} in sight of the receiver, {(~in_sight).sum():,} in shadow"


def _maps(dataset: PasDataset) -> str:
    rows, columns = dataset.grid.shape
    kept = "stored" if dataset.header.maps else "derived from the channels when read"
    channels = "with channels" if dataset.header.channels else "without channels"
    return f"{dataset.header.pas_kind}, {rows} elevations × {columns} azimuths, {kept}, {channels}"


def _scene_parts(view: View, picture: Picture, model: str) -> Iterator[Part]:
    if view.missing:
        yield view.missing
    yield picture
    yield Link(model, f"The scene in 3D, for any viewer of GLB files: {model}")
    if view.settings and view.scene:
        yield from _ray_parts(view)
    if view.room.meshes:
        yield _material_table(view)


def _ray_parts(view: View) -> Iterator[Part]:
    at = f"transmitter {view.room.tx} at {format_ghz(view.carrier_hz)}"
    if not view.room.rays:
        yield f"No ray of {at} reaches the receiver."
        return
    yield (
        f"The strongest rays of {at}: at most {MAX_RAYS}, within {RAY_RANGE_DB:g} dB of the strongest, "
        "numbered as in the figure and named alike in the 3D model. What a ray meets is told from the transmitter on."
    )
    rows = [
        (str(index), f"{ray.level_db:.1f}".replace("-", "−"), f"{ray.delay_s * 1e9:.2f}", ray.label)
        for index, ray in enumerate(view.room.rays, start=1)
    ]
    yield Table(("ray", "power (dB)", "delay (ns)", "what it meets"), rows)


def _material_table(view: View) -> Table:
    kinds = sorted({(mesh.material, mesh.thickness_m) for mesh in view.room.meshes})
    at = format_ghz(view.carrier_hz)
    header = (
        "material",
        "thickness (mm)",
        "surfaces",
        "P.2040 bands (GHz)",
        "outside them",
        f"ε′, {at}",
        "σ (S/m)",
    )
    return Table(header, [_material_row(view, *kind) for kind in kinds])


def _material_row(view: View, material: str, thickness_m: float) -> tuple[str, ...]:
    kind = (material, thickness_m)
    carriers = view.header.carrier_hz.tolist() if view.dataset else [view.carrier_hz]
    bands = material_bands(material)
    outside = [carrier for carrier in carriers if not any(band.contains(carrier) for band in bands)]
    permittivity = complex_permittivity(material, view.carrier_hz, "extrapolate")
    conductivity_s_m = -permittivity.imag * 2 * np.pi * view.carrier_hz * VACUUM_PERMITTIVITY_F_M
    return (
        material.replace("_", " "),
        f"{thickness_m * 1e3:g}",
        str(sum((mesh.material, mesh.thickness_m) == kind for mesh in view.room.meshes)),
        ", ".join(f"{band.low_ghz:g}–{band.high_ghz:g}" for band in bands),
        f"{format_ghz_list(outside)}, extrapolated" if outside else ABSENT,
        f"{permittivity.real:.3g}",
        f"{conductivity_s_m:,.0f}" if conductivity_s_m > 1000 else f"{conductivity_s_m:.3g}",
    )


def _maps_note(view: View) -> str:
    return (
        "The hemisphere seen from its pole, in dB below each map's peak: the rim is the equator of the receiver's "
        f"frame, azimuth runs counter-clockwise from the right. The transmitter stands at {_metres(view.room.tx_m)}."
    )


def _carrier_parts(view: View, summary: CarrierSummary) -> Iterator[Part]:
    compared = summary.similarity
    if len(compared.carrier_hz) > 1:
        sampled = "all" if compared.num_tx == view.header.num_tx else f"{compared.num_tx} evenly spread"
        yield (
            f"SSIM compares the maps of one transmitter at two carriers; medians are over {sampled} transmitters, "
            "of those heard at both carriers."
        )
    if summary.peak_db is None:
        yield "Received power and paths were not published with these maps."
    header = ("carrier (GHz)", "without path", "median paths", "power median (dB)", "10 to 90 % (dB)")
    nearest = ("SSIM to the next carrier",) if len(compared.carrier_hz) > 1 else ()
    rows = [_carrier_row(summary, index) for index in range(len(summary.carrier_hz))]
    yield Table((*header, *nearest), rows)


def _carrier_row(summary: CarrierSummary, index: int) -> tuple[str, ...]:
    heard = summary.has_path[:, index]
    cells = [f"{summary.carrier_hz[index] / 1e9:g}", str(int((~heard).sum()))]
    paths = summary.num_paths
    cells.append(ABSENT if paths is None else f"{np.median(paths[:, index]):.0f}")
    if summary.peak_db is None or not heard.any():
        cells += [ABSENT, ABSENT]
    else:
        low, middle, high = np.percentile(summary.peak_db[heard, index], (10, 50, 90))
        cells += [f"{middle:.1f}", f"{low:.1f} to {high:.1f}"]
    if len(summary.similarity.carrier_hz) > 1:
        cells.append(_next_ssim(summary, index))
    return tuple(cell.replace("-", "−") for cell in cells)


def _next_ssim(summary: CarrierSummary, index: int) -> str:
    compared = summary.similarity
    places = np.flatnonzero(compared.carrier_hz == summary.carrier_hz[index])
    if not len(places) or places[0] + 1 == len(compared.carrier_hz):
        return ABSENT
    return number(float(compared.median_ssim[places[0], places[0] + 1]), 3)


def _protocol_parts(dataset: PasDataset) -> Iterator[Part]:
    splits: list[Split] = []
    refused: list[str] = []
    for protocol in PROTOCOLS:
        found, note = _splits(dataset, protocol)
        splits += found
        refused += [note] if note else []
    header = (
        "split",
        "trained on",
        "tested on",
        "left out, no path",
        "same transmitters",
        "nearest trained (m)",
    )
    if splits:
        yield Table(header, [_split_row(split) for split in splits])
        yield (
            f"Samples of `xfreqbench run --data {dataset.path.name} --protocol NAME`; the nearest trained transmitter "
            "is the median over tested ones."
        )
    yield from refused


def _splits(dataset: PasDataset, protocol: str) -> tuple[list[Split], str]:
    """Splits of a protocol, with every carrier as its target where the paper's are missing, and why so."""
    try:
        return make_splits(dataset, protocol), ""
    except ProtocolError as error:
        refusal = str(error)
    if not protocol.startswith("lofo"):
        return [], refusal
    try:
        return make_splits(dataset, protocol, "all"), f"{refusal} Shown here with `--targets all`."
    except ProtocolError as error:
        return [], str(error)


def _split_row(split: Split) -> tuple[str, ...]:
    return (
        split.name,
        f"{len(split.train):,}",
        f"{len(split.test):,}",
        str(split.num_without_path),
        "yes, at other carriers" if split.shares_transmitters else "no",
        f"{split.nearest_trained_m:.2f}",
    )


def _code(dataset: PasDataset) -> str:
    F = dataset.num_carriers
    rows, columns = dataset.grid.shape
    return (
        "from xfreqbench.dataset import open_dataset\n"
        f'dataset = open_dataset("{dataset.path.name}")  # {len(dataset):,} rows, one a transmitter and carrier\n'
        f"maps = dataset.pas(slice(0, {F}))  # ({F}, {rows}, {columns}): transmitter 0 at every carrier\n"
    )


def _origin_parts(view: View) -> Iterator[Part]:
    if not view.dataset:
        yield "Transmitters are those of `xfreqbench generate` at the paper's carriers."
    rows = [*_origin_rows(view)]
    yield Table(("what", "value"), rows)


def _origin_rows(view: View) -> Iterator[tuple[str, str]]:
    for name, value in view.header.settings.items():
        if isinstance(value, dict):
            yield from ((f"{name}: {key}", _words(each)) for key, each in value.items())
        else:
            yield name, _words(value)
    yield from ((f"version of {name}", version) for name, version in view.header.software.items())
    yield "sha256 of the scene", view.header.scene_sha256
    if view.dataset:
        yield "sha256 of the data set", view.dataset.sha256


def _words(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value)) or "none"
    return str(value)


def _metres(point_m: Any) -> str:
    return f"{_vector(point_m)} m"


def _vector(values: Any) -> str:
    return f"({', '.join(f'{value:.4g}' for value in values)})"
