"""Where fetched data, and what Numba and Matplotlib make, are kept: the usual places, or ours where those fail."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

_PACKAGE = Path(__file__).parents[1]
_VARIABLES = {"NUMBA_CACHE_DIR": "numba", "MPLCONFIGDIR": "matplotlib"}


def settle_caches() -> None:
    """Choose folders for the caches of libraries where the user has no home folder to write to, as in some containers.

    Without one, libraries fail, or make a folder `~` in each working folder. Ours is `xfreqbench-UID` in the folder for
    temporary files. Where another user may own that, compiled code is kept in a folder that is removed with this
    process, and a warning says so. Variables stay as they are where they name folders that can be written.
    """
    if all(map(_is_writable, _home_folders())):
        return
    # Numba keeps what it compiles next to its source if it can
    sound = {"NUMBA_CACHE_DIR"} if all(map(_is_writable, (_PACKAGE, _PACKAGE / "scene"))) else set()
    sound |= {name for name in _VARIABLES if name in os.environ and _is_writable(Path(os.environ[name]).absolute())}
    missing = _VARIABLES.keys() - sound
    if missing:
        folder = _own_folder() or _passing_folder()
        os.environ.update({name: str(folder / _VARIABLES[name]) for name in missing} if folder else {})


def data_folder() -> Path:
    """Where fetched data sets are kept: the user's folder for caches, or ours where that cannot be written."""
    import pooch

    folder = Path(pooch.os_cache("xfreqbench"))
    return folder if _is_writable(folder) else (_own_folder() or folder) / "data"


def _home_folders() -> list[Path]:
    """The user's folders for caches and for settings; relative ones where there is no home."""
    try:
        home = Path.home()
    except RuntimeError:
        home = Path()
    places = {"XDG_CACHE_HOME": ".cache", "XDG_CONFIG_HOME": ".config"}
    return [Path(os.environ.get(variable) or home / name) for variable, name in places.items()]


def _is_writable(folder: Path) -> bool:
    """Whether files can be put into a folder, or it can be made; no relative one. One is put there: systems may err."""
    if not folder.is_absolute():
        return False
    try:
        tempfile.TemporaryFile(dir=next(place for place in (folder, *folder.parents) if os.path.lexists(place))).close()
    except OSError:
        return False
    return True


def _own_folder() -> Path | None:
    """The folder that this user's processes share; None if it is, or may be, another's: code is loaded from it."""
    try:
        folder = Path(tempfile.gettempdir()) / f"xfreqbench-{os.getuid()}"
        if folder.parent == Path.cwd():  # if nothing else can be written
            return None
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    is_own = folder.is_dir() and not folder.is_symlink() and found.st_uid == os.getuid()
    return folder if is_own and not found.st_mode & 0o077 else None


def _passing_folder() -> Path | None:
    """A folder that goes with this process; None if there is no place for one."""
    import atexit
    import shutil

    advice = "Set NUMBA_CACHE_DIR and MPLCONFIGDIR to folders of your own."
    try:
        folder = Path(tempfile.mkdtemp(prefix="xfreqbench-"))
    except OSError as error:
        print(f"xfreqbench: there is no folder for compiled code: {error.strerror}. {advice}", file=sys.stderr)
        return None
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    print(f"xfreqbench: compiled code cannot be kept; it is compiled each time. {advice}", file=sys.stderr)
    return folder
