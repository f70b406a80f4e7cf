"""The page that says what a data set or a scene holds: its facts and tables; `page.html` puts them in place."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.splits import HELD_OUT_RECEIVER, PROTOCOLS, Split, make_splits
from xfreqbench.errors import ProtocolError
from xfreqbench.report.drawing.markdown import ABSENT, number
from xfreqbench.report.drawing.orbit import BORESIGHT_M, by_material, millimetres, one_surface, packed
from xfreqbench.report.drawing.templates import PageTable, Picture, owner_mark, render
from xfreqbench.report.view.describe import CarrierSummary, links_in_words
from xfreqbench.report.view.figures import NUMBERED_RAYS, Rgba, group_colour, point_along, ray_colour
from xfreqbench.report.view.plan import MAX_RAYS, RAY_RANGE_DB, ShownRoom, ViewPlan
from xfreqbench.scene.glb_writer import material_hex
from xfreqbench.scene.materials import complex_permittivity, conductivity_s_m, material_bands
from xfreqbench.scene.meshes import slabs_of
from xfreqbench.types import FloatArray
from xfreqbench.units import format_ghz, format_ghz_list


def view_page(
    view: ViewPlan, summary: CarrierSummary | None, pictures: Mapping[str, Sequence[Picture]], model: str, all_maps: str
) -> str:
    """HTML of a view whose rays are traced; equal views give equal text.

    `summary` is that of the view's data set, None without one. `pictures` are of the `scene`, `maps` and `carriers`;
    `model` and `all_maps` are the names of files in the page's folder: the 3D model, and the maps at every carrier.
    """
    splits, refusals = _protocols(view.dataset) if view.dataset else ([], [])
    room, num_tx = view.room, view.header.num_tx
    rays = [
        (str(index), f"{ray.level_db:.1f}".replace("-", "−"), f"{ray.delay_s * 1e9:.2f}", ray.label)
        for index, ray in enumerate(room.rays, start=1)
    ]
    split_rows = [
        (
            split.name,
            f"{len(split.train):,}",
            f"{len(split.test):,}",
            str(split.num_without_path),
            "yes, at other carriers" if split.shares_transmitters else "no",
            f"{split.nearest_trained_m:.2f}",
        )
        for split in splits
    ]
    of_splits = ("split", "trained on", "tested on", "left out, no path", "same transmitters", "nearest trained (m)")
    others = [] if room.in_sight is None else np.flatnonzero(room.in_sight != room.in_sight[room.tx]).tolist()
    groups = {name: _hex(group_colour(name)) for name, points in room.groups().items() if len(points)}
    return render(
        "view/page.html",
        title=f"{view.dataset.path.name}: {view.header.scene_name}" if view.dataset else view.header.scene_name,
        lead=_lead(view),
        owner=owner_mark(view.subject),
        facts=_facts(view),
        view=view,
        dataset=view.dataset,
        summary=summary,
        pictures=pictures,
        orbit=packed(orbit_scene(room)),
        colours=groups | {name.replace("_", " "): material_hex(name) for name in by_material(room.meshes)},
        next_tx=(room.tx + 1) % num_tx,
        other_tx=others[0] if others else None,
        model=model,
        all_maps=all_maps,
        carrier=format_ghz(view.carrier_hz),
        tx_place=_metres(view.room.tx_m),
        max_rays=MAX_RAYS,
        ray_range_db=f"{RAY_RANGE_DB:g}",
        rays=PageTable(("ray", "power (dB)", "delay (ns)", "what it meets"), rays),
        materials=_material_table(view),
        carriers=_carrier_table(summary) if summary else None,
        splits=PageTable(of_splits, split_rows),
        refusals=refusals,
        origin=PageTable(("what", "value"), [*_origin_rows(view)]),
    )


def orbit_scene(room: ShownRoom) -> dict[str, Any]:
    """What is drawn of a room, for `orbit.packed`.

    `surfaces` are one a material, `groups` the transmitters in sight and in shadow, and `rays` lines from the
    transmitter to the array centre, the weakest first, so that strong ones are drawn over them.
    """
    ahead_m = room.receiver_m + BORESIGHT_M * room.boresight
    groups = room.groups().items()
    rays = sorted(room.rays, key=lambda ray: ray.level_db)
    return {
        "surfaces": [
            one_surface(meshes, material_hex(material)) for material, meshes in by_material(room.meshes).items()
        ],
        "groups": [{"colour": _hex(group_colour(name)), "points": millimetres(points)} for name, points in groups],
        "rays": [{"colour": _hex(ray_colour(ray.level_db)), "points": millimetres(ray.points_m)} for ray in rays],
        "transmitter": millimetres(room.tx_m),
        "receiver": millimetres(room.receiver_m),
        "boresight": millimetres(np.stack([room.receiver_m, ahead_m])),
        "labels": [{"text": text, "at": millimetres(at_m)} for text, at_m in _labels(room)],
    }


def _labels(room: ShownRoom) -> Iterator[tuple[str, Float[FloatArray, "3"]]]:
    """The lengths of the room, the numbers of its strongest rays, and both ends, each at its place."""
    if room.meshes:
        corners_m = np.concatenate([mesh.vertices_m for mesh in room.meshes])
        low_m, high_m = corners_m.min(axis=0), corners_m.max(axis=0)
        for axis, (name, length_m) in enumerate(zip("xyz", high_m - low_m, strict=True)):
            middle_m = np.array([low_m[0] if name == "x" else high_m[0], low_m[1], low_m[2]])
            middle_m[axis] += length_m / 2
            yield f"{name}: {length_m:.3g} m", middle_m
    numbered = sorted(room.rays, key=lambda ray: -ray.level_db)[:NUMBERED_RAYS]
    for place, ray in enumerate(numbered, start=1):
        yield str(place), point_along(ray.points_m, place / (len(numbered) + 1))
    yield "receiver", room.receiver_m
    yield f"transmitter {room.tx}", room.tx_m


def _hex(colour: Rgba) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


def _lead(view: ViewPlan) -> str:
    num_tx, num_carriers = view.header.num_tx, len(view.header.carrier_hz)
    what = (
        f"{num_tx:,} transmitters × {num_carriers} carriers = {num_tx * num_carriers:,} power angular spectra."
        if view.dataset
        else "A scene, without data: `xfreqbench generate` would use these transmitters."
    )
    return f"{what} {view.scene.description if view.scene else ''}".strip()


def _facts(view: ViewPlan) -> dict[str, str]:
    header, dataset = view.header, view.dataset
    in_sight, receiver = view.room.in_sight, header.receiver
    facts = {
        "Receiver": f"{receiver.rows} × {receiver.cols} elements {receiver.spacing_wavelengths:g} wavelengths apart at "
        f"{_metres(receiver.position_m)}, boresight {_vector(receiver.boresight)}, {receiver.antenna}, "
        f"in plane {receiver.plane} of its frame",
        "Transmitters": f"{header.num_tx:,}, sight of the receiver not published"
        if in_sight is None
        else f"{in_sight.sum():,} in sight of the receiver, {(~in_sight).sum():,} in shadow",
    }
    if header.rejected:
        left_out = [f"{count} {why}" for why, count in header.rejected.items() if count]
        facts["Left out"] = ", ".join(left_out) or "nothing"
    if dataset:
        rows, columns = dataset.grid.shape
        kept = "stored" if header.maps else "derived from the channels when read"
        channels = "with channels" if header.channels else "without channels"
        maps = f"{header.pas_kind}, {rows} elevations × {columns} azimuths, {kept}, {channels}"
        facts |= {"Carriers": format_ghz_list(header.carrier_hz), "Maps": maps}
        if links := links_in_words(dataset):
            facts["Links"] = f"{links}; all on this page is of the first of each"
        facts["File"] = f"{dataset.path.stat().st_size / 1e6:,.1f} MB"
    return facts | {"Shown": f"transmitter {view.room.tx} at {_metres(view.room.tx_m)}"}


def _material_table(view: ViewPlan) -> PageTable:
    header = "material", "thickness (mm)", "surfaces", "P.2040 bands (GHz)", "outside them"
    of_carrier = f"ε′, {format_ghz(view.carrier_hz)}", "σ (S/m)"
    carriers = view.header.carrier_hz.tolist() if view.dataset else [view.carrier_hz]
    rows = []
    every = [(slab, layer) for slab in slabs_of(view.room.meshes) for layer in slab.layers]
    for slab, (material, thickness_m) in every:
        bands = material_bands(material)
        outside = [carrier for carrier in carriers if not any(band.contains(carrier) for band in bands)]
        permittivity = complex_permittivity(material, view.carrier_hz, "extrapolate")
        sigma_s_m = conductivity_s_m(permittivity, view.carrier_hz)
        cells = (
            str(material).replace("_", " ") + (f", layer of {slab.material}" if len(slab.layers) > 1 else ""),
            f"{thickness_m * 1e3:g}",
            str(sum(mesh.slab == slab for mesh in view.room.meshes)),
            ", ".join(f"{band.low_ghz:g}–{band.high_ghz:g}" for band in bands)
            if isinstance(material, str)
            else "none: the scene's own, the same at every carrier",
            f"{format_ghz_list(outside)}, extrapolated" if outside else ABSENT,
            f"{permittivity.real:.3g}",
            f"{sigma_s_m:,.0f}" if sigma_s_m > 1000 else f"{sigma_s_m:.3g}",
        )
        rows.append(cells)
    return PageTable((*header, *of_carrier), rows)


def _carrier_table(summary: CarrierSummary) -> PageTable:
    header = ["carrier (GHz)", "without path", "median paths", "power median (dB)", "10 to 90 % (dB)"]
    is_sampled = len(summary.compared_hz) < len(summary.carrier_hz)
    to_next = dict(zip(summary.compared_hz, np.diagonal(summary.median_ssim, 1), strict=False))  # none for the last
    rows = []
    for index, carrier_hz in enumerate(summary.carrier_hz):
        heard = summary.has_path[:, index]
        paths = ABSENT if summary.num_paths is None else f"{np.median(summary.num_paths[:, index]):.0f}"
        power = [ABSENT, ABSENT]
        if summary.peak_db is not None and heard.any():
            low, middle, high = np.percentile(summary.peak_db[heard, index], (10, 50, 90))
            power = [f"{middle:.1f}", f"{low:.1f} to {high:.1f}"]
        ssim = number(float(to_next.get(carrier_hz, np.nan)), 3)
        cells = [f"{carrier_hz / 1e9:.12g}", str(int((~heard).sum())), paths, *power, *[ssim] * bool(to_next)]
        rows.append([cell.replace("-", "−") for cell in cells])
    return PageTable(header + [f"SSIM to the next{' compared' * is_sampled} carrier"] * bool(to_next), rows)


def _protocols(dataset: PasDataset) -> tuple[list[Split], list[str]]:
    """The splits of every protocol that the data set can serve, and why it cannot serve the others as they are.

    A `lofo` protocol whose usual targets are not among the carriers is shown with every carrier as a target.
    """
    splits: list[Split] = []
    refusals: list[str] = []
    for protocol in (*PROTOCOLS, *([HELD_OUT_RECEIVER] if dataset.file_header.receivers else [])):
        try:
            splits += make_splits(dataset, protocol)
        except ProtocolError as error:
            refusal = str(error)
            if protocol.startswith("lofo"):
                try:
                    splits += make_splits(dataset, protocol, "all")
                    refusal += " Shown here with `--targets all`."
                except ProtocolError as second:
                    refusal = str(second)
            refusals.append(refusal)
    return splits, refusals


def _origin_rows(view: ViewPlan) -> Iterator[tuple[str, str]]:
    for name, value in view.header.settings.items():
        if isinstance(value, dict):
            yield from ((f"{name}: {key}", _words(inner)) for key, inner in value.items())
        else:
            yield name, _words(value)
    yield from ((f"version of {name}", version) for name, version in view.header.software.items())
    yield "references", view.header.references or "unknown"
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
