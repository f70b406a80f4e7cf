"""Hashes of source files: of this package, and of a method's own code."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from sysconfig import get_path

PACKAGE = "xfreqbench"
_BASELINES = f"{PACKAGE}.baselines"  # in an editable install their folder is next to the package's


def package_sha256() -> str:
    """Hash of all Python files of this package, those of the built-in methods included, with their names."""
    return _sha256(_files_of(PACKAGE) | _files_of(_BASELINES))


def method_sha256(modules: Iterable[str]) -> str:
    """Hash of the files of a method's own package, and of `xfreqbench.methods` and `xfreqbench.maps`, with their names.

    `modules` are those of its class and of the bases of that. Built-in methods in single files count together; of a
    module outside of any package it is the Python files of its folder. The standard library is left out.
    """
    files = _files_of(f"{PACKAGE}.methods") | _files_of(f"{PACKAGE}.maps")
    for module in modules:
        top, path = module.partition(".")[0], getattr(sys.modules.get(module), "__file__", None)
        is_installed = path is not None and "site-packages" in Path(path).parts
        if path is None or (Path(path).is_relative_to(get_path("stdlib")) and not is_installed):
            continue
        if top == PACKAGE:
            singles = {name: file for name, file in _files_of(_BASELINES).items() if name.count("/") == 2}
            own = ".".join(module.split(".")[:3])  # its package, or itself, of which there are no files below
            files |= singles | _files_of(own)
        elif hasattr(sys.modules.get(top), "__path__"):
            files |= _files_of(top)
        else:
            beside = [Path(path)] if is_installed else Path(path).parent.glob("*.py")
            files |= {file.name: file for file in beside}
    return _sha256(files)


def _sha256(files: dict[str, Path]) -> str:
    digest = hashlib.sha256()
    for name, path in sorted(files.items()):
        digest.update(name.encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def _files_of(package: str) -> dict[str, Path]:
    """Python files of a package by their paths within it, the same however it is installed."""
    return {
        f"{package.replace('.', '/')}/{name}": path for folder in _folders(package) for name, path in _python(folder)
    }


@cache
def _folders(package: str) -> tuple[Path, ...]:
    spec = find_spec(package)  # `__path__` of this package has folders of data, too
    return tuple(map(Path, (spec.submodule_search_locations if spec else None) or ()))


def _python(folder: Path) -> Iterator[tuple[str, Path]]:
    for path in folder.rglob("*.py"):
        within = path.relative_to(folder)
        if within.parts[0] not in ("examples", "scenes"):
            yield within.as_posix(), path
