"""A package for a method of one's own: the template of `examples/`, with other names."""

from __future__ import annotations

import keyword
import re
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

from xfreqbench.errors import MethodError
from xfreqbench.methods.registry import method_names, room_method_names
from xfreqbench.system.files import atomic_folder

TEMPLATE, ROOMS_TEMPLATE = "xfreqbench-method-template", "xfreqbench-rooms-template"
TEMPLATE_FILES = {
    TEMPLATE: (
        ".github/workflows/tests.yml",
        "README.md",
        "pyproject.toml",
        "src/plane_waves/__init__.py",
        "tests/test_plane_waves.py",
    ),
    ROOMS_TEMPLATE: (
        "README.md",
        "pyproject.toml",
        "src/soft_direct_wave/__init__.py",
        "tests/test_soft_direct_wave.py",
    ),
}
_COPIED = ", to copy and to change"
_MAX_NAME = 40


def write_method_package(name: str, folder: Path, rooms: bool = False) -> list[Path]:
    """Write a package with a method of this name that learns at once, and with its tests; returns its files.

    The method learns in one room, or with `rooms` across many, as a `RoomMethod`.

    The name is that of the package for pip, of the entry point, and so of the method on the leaderboard. The
    module and the classes are named after it: `my-waves` has `MyWaves` in `my_waves`. Raises `MethodError` for a name
    that cannot be all of these or is taken, `OutputExistsError` where the folder is neither absent nor empty, and
    `StorageError`.
    """
    template = ROOMS_TEMPLATE if rooms else TEMPLATE
    folder_of_it = files("xfreqbench.examples") / template
    contents = {path: (folder_of_it / path).read_text("utf-8") for path in TEMPLATE_FILES[template]}
    module, class_name = name.replace("-", "_"), "".join(part.capitalize() for part in name.split("-"))
    _require_free(name, module, class_name, "\n".join(contents.values()))
    names = {
        f"A method for xfreqbench{_COPIED}": f"{name}: a method for xfreqbench",
        f"A method for xfreqbench that learns across rooms{_COPIED}": f"{name}: a method that learns across rooms",
        template: name,
        "plane-waves": name,
        "plane_waves": module,
        "PlaneWaveField": f"{class_name}Field",
        "PlaneWaves": class_name,
        "soft-direct-wave": name,
        "soft_direct_wave": module,
        "SoftDirectWave": class_name,
    }
    written = []
    with atomic_folder(folder) as temporary:
        for path, text in contents.items():
            for old, new in names.items():
                path, text = path.replace(old, new), text.replace(old, new)
            (temporary / path).parent.mkdir(parents=True, exist_ok=True)
            (temporary / path).write_text(text, encoding="utf-8")
            written.append(folder / path)
    return written


def _require_free(name: str, module: str, class_name: str, template: str) -> None:
    if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", name) or len(name) > _MAX_NAME:
        raise MethodError(
            f"A method is named by words of small letters and digits with hyphens between, as in my-method, of "
            f"{_MAX_NAME} characters at most, but got {name!r}."
        )
    taken = (
        f"there is an installed method {name!r}"
        if name in (*method_names(), *room_method_names())
        else f"there is a module {module!r} already"
        if keyword.iskeyword(module) or module in ("src", "tests") or find_spec(module)
        else f"the template has a {class_name} of its own"
        if re.search(rf"\b{class_name}\b", template)
        else ""
    )
    if taken:
        raise MethodError(f"A method cannot be called {name!r}: {taken}. Choose another name.")
