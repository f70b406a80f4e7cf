"""Where the modules of version 0.1 are now, for the error of a method that still imports one of them."""

from __future__ import annotations

import ast
import traceback
from pathlib import Path

_MODULES = {
    "angles": "maps.grid",
    "array": "scene.array",
    "checkpoints": "runs.checkpoints",
    "config": "methods.config",
    "dataset": "data.dataset",
    "facets": "scene.facets",
    "generate": "data.generate",
    "hdf5": "data.hdf5",
    "image_method": "tracing.image.tracer",
    "machine": "system.machine",
    "materials": "scene.materials",
    "mesh": "scene.meshes",
    "method": "methods.contract",
    "metrics": "maps.metrics",
    "parallel": "system.workers",
    "pas": "maps.bartlett",
    "paths": "tracing.paths",
    "placement": "scene.placement",
    "predictions": "runs.predictions",
    "protocols": "data.splits",
    "records": "runs.records",
    "run": "runs.run",
    "scene": "scene.model",
    "solvers": "tracing.solvers",
    "splatting.aperture": "methods.learning.aperture",
    "splatting.composite": "methods.splatting.composite",
    "splatting.density": "methods.splatting.density",
    "splatting.encoding": "methods.learning.encoding",
    "splatting.footprints": "methods.splatting.footprints",
    "splatting.gaussians": "methods.splatting.gaussians",
    "splatting.learned": "methods.learning.training",
    "splatting.loss": "methods.learning.loss",
    "splatting.network": "methods.learning.network",
    "splatting.projection": "methods.splatting.projection",
    "splatting.splat": "methods.splatting.field",
    "splatting.view": "methods.learning.targets",
    "storage": "system.files",
    "testing": "methods.check",
    "tracing": "tracing.tracer",
    "transmitters": "methods.lookup",
}
_NAMES = {  # those that have not moved with their modules
    ("angles", "FloatArray"): "types",
    ("dataset", "DatasetHeader"): "data.schema",
    ("dataset", "IntArray"): "types",
    ("dataset", "PasWriter"): "data.writer",
    ("mesh", "IntArray"): "types",
    ("mesh", "sees"): "scene.visibility",
    ("method", "Fit"): "methods.fitting",
    ("method", "build_method"): "methods.registry",
    ("method", "checked_maps"): "methods.fitting",
    ("method", "fit_within"): "methods.fitting",
    ("method", "method_names"): "methods.registry",
    ("method", "predict_checked"): "methods.fitting",
    ("method", "resolve_method"): "methods.registry",
    ("testing", "plane_wave_data"): "data.plane_waves",
    ("testing", "stored_channels"): "data.plane_waves",
}


def new_places(error: ImportError, module: str, name: str) -> str:
    """Sentences that say where to import what `error` did not find; empty where none of it has moved.

    What was asked for is read from the import statement that failed. Without one, it was `name` of `module`.
    """
    wanted = _failed_statement(error) or [(module, name)]
    places = {f"{old}.{what}" if what else old: _new_module(old, what) for old, what in wanted}
    return " ".join(f"{old} is now in {new}." for old, new in places.items() if new)


def _new_module(module: str, name: str) -> str | None:
    old = module.removeprefix("xfreqbench").removeprefix(".")
    if not module.startswith("xfreqbench"):
        return None
    new = _NAMES.get((old, name)) or _MODULES.get(old) or _MODULES.get(f"{old}.{name}".strip("."))
    return f"xfreqbench.{new}" if new else None


def _failed_statement(error: ImportError) -> list[tuple[str, str]]:
    """Modules and names of the import statement that raised an error; no names for `import module`."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if not frame.filename.startswith("<frozen ")]
    try:
        tree = ast.parse(Path(own[-1].filename).read_bytes())
    except (OSError, IndexError, SyntaxError, ValueError):
        return []
    line = own[-1].lineno or 0
    for node in ast.walk(tree):
        if not isinstance(node, ast.Import | ast.ImportFrom) or not node.lineno <= line <= (
            node.end_lineno or 0
        ):
            continue
        if isinstance(node, ast.Import):
            return [(alias.name, "") for alias in node.names]
        return [(node.module or "", alias.name) for alias in node.names]
    return []
