"""The search for the LLVM library that Dr.Jit compiles with, which runs before Dr.Jit is imported.

Dr.Jit refuses LLVM 14. Versions 15 and 16 abort the whole process on machines with AVX-512, and no program can
catch that. So the library of the pip package is taken first, and of the system's libraries only those from 17 on.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import re
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path

from xfreqbench.errors import MissingLLVMError

VARIABLE = "DRJIT_LIBLLVM_PATH"
PACKAGE = "karellen-llvm-core"
LOWEST_VERSION = 17
SYSTEM_FOLDERS = ("/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64", "/usr/local/lib")


def ensure_llvm() -> str:
    """Tell Dr.Jit of a libLLVM that works, and return the path or name of that library.

    A `DRJIT_LIBLLVM_PATH` that the user has set is kept. Must run before drjit, mitsuba or sionna is first
    imported. Raises `MissingLLVMError` where no library is found, or the user's path names none.
    """
    given = os.environ.get(VARIABLE)
    if given:
        return _existing(given)
    found = _packaged_library() or _system_library()
    if found is None:
        raise MissingLLVMError(
            f"Sionna RT needs an LLVM library of version {LOWEST_VERSION} or later, and there is none here. "
            f"Run `pip install {PACKAGE}`, or set {VARIABLE} to a libLLVM.so."
        )
    os.environ[VARIABLE] = found
    return found


def llvm_version() -> str:
    """Version of the library that `ensure_llvm` found, as its file's name tells it, or `unknown`."""
    numbers = _version_numbers(Path(ensure_llvm()).resolve().name)
    return ".".join(map(str, numbers)) or "unknown"


def _existing(path: str) -> str:
    fault = _why_unusable(path)
    if fault:
        raise MissingLLVMError(
            f"{VARIABLE} is set to {path!r}, {fault}. Set it to a libLLVM.so of version "
            f"{LOWEST_VERSION} or later, or unset it and run `pip install {PACKAGE}`."
        )
    return path


def _why_unusable(path: str) -> str | None:
    if not Path(path).is_file():
        return "where there is no file"
    try:
        return None if hasattr(ctypes.CDLL(path), "LLVMContextCreate") else "a library without LLVM"
    except OSError:
        return "which is not a library that can be loaded"


def _packaged_library() -> str | None:
    """The pip package's library, a real file: symlinks to it appear only when the package is first used."""
    try:
        listed = metadata.files(PACKAGE) or []
    except metadata.PackageNotFoundError:
        return None
    located = (Path(str(file.locate())) for file in listed if file.name.startswith("libLLVM.so."))
    real = (path.resolve() for path in located if path.is_file() and not path.is_symlink())
    return next((str(path) for path in real), None)


def _system_library() -> str | None:
    """The newest usable library of the system."""
    usable = [path for path in _system_candidates() if _version_numbers(path.name)[:1] >= (LOWEST_VERSION,)]
    return str(max(usable, key=lambda path: _version_numbers(path.name))) if usable else None


def _system_candidates() -> Iterable[Path]:
    for folder in SYSTEM_FOLDERS:
        yield from (path for path in Path(folder).glob("libLLVM*.so*") if not path.name[7].isalpha())  # LLVMSPIRVLib
    linked = ctypes.util.find_library("LLVM")
    if linked:
        yield Path(linked)


def _version_numbers(filename: str) -> tuple[int, ...]:
    """(19, 1) for `libLLVM-19.so.1` and for `libLLVM.so.19.1`; () where the name holds no number."""
    return tuple(int(number) for number in re.findall(r"\d+", filename))
