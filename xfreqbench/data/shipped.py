"""Data sets by name or address: those that ship with the toolkit, and those that are downloaded and kept."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from functools import partial
from math import inf
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import pooch
import requests
from pydantic import Field

from xfreqbench.data.dataset import PasDataset, open_dataset, verify
from xfreqbench.errors import DataError, UnknownNameError
from xfreqbench.scene.toml_files import shipped_folder, shipped_scenes
from xfreqbench.system.arguments import Word, checked
from xfreqbench.system.caches import data_folder
from xfreqbench.system.files import sole_writer, storage_errors


class Registered(NamedTuple):
    """A data set of the registry; `url` is None if it ships with the toolkit."""

    file: str
    sha256: str
    url: str | None


def registered(registry: Path | None = None, ending: str = ".h5") -> Mapping[str, Registered]:
    """The files of a registry by their names; without `registry`, the data sets."""
    book = _book({}, {})
    # each line has a file, its sha256 and, unless it ships, its address
    book.load_registry(registry or shipped_folder() / "registry.txt")
    return {
        file.removesuffix(ending): Registered(file, sha256, book.urls.get(file))
        for file, sha256 in book.registry.items()
    }


@checked
def load(name: Word) -> PasDataset:
    """Open a data set by its name, which ships with the toolkit or was downloaded before; no network is used.

    Data that ship have channels, and their maps are derived when they are read. Raises `UnknownNameError` for an
    unknown name, and `DataError` for data that do not ship and were not downloaded yet, and for a file's path.
    """
    known = registered()
    if name not in known:
        if name.endswith(".h5") or Path(name).is_file():
            raise DataError(f"load takes the name of a data set. Open a file with xfreqbench.open_dataset({name!r}).")
        if name in shipped_scenes():
            raise DataError(
                f"The data of scene {name!r} do not ship; those of {', '.join(sorted(known))} do. Generate them, "
                f"which takes minutes: xfreqbench generate {name} --no-maps -o {name}.h5"
            )
        raise UnknownNameError("data set", name, known)
    found = known[name]
    path = shipped_folder() / found.file if found.url is None else data_folder() / found.file
    if found.url is not None and not path.exists():
        raise DataError(f"{name!r} was not downloaded yet. Download it: xfreqbench.fetch({name!r})")
    return open_dataset(path)


@checked
def fetch(name_or_url: Word, sha256: Annotated[str, Field(pattern="^[0-9a-fA-F]{64}$")] | None = None) -> PasDataset:
    """Download a data set by its name or its address (http, https) once, keep it, and open it.

    It is downloaded only once, and a broken download continues where it stopped. The file is kept only if it has the
    `sha256` that is given, or that is registered for its name. Without one, its bytes are compared with the hash that
    every data set contains. It is kept in the user's folder for caches, which is `$XDG_CACHE_HOME/xfreqbench` or
    `~/.cache/xfreqbench`.

    Raises `UnknownNameError` for an unknown name, `DataError` if there is no answer, or if the answer is not a data
    set or has another hash, and `StorageError`.
    """
    url, file = name_or_url, ""
    if not url.startswith(("http://", "https://")):
        known = registered()
        if name_or_url not in known:
            raise UnknownNameError("data set", name_or_url, [*known, "https://…"])
        file, registered_sha256, address = known[name_or_url]
        if address is None:
            return load(name_or_url)
        url, sha256 = address, sha256 or registered_sha256
    return open_dataset(fetch_file(url, verify, sha256, file))


def fetch_file(
    url: str,
    check: Callable[[Path], object],
    sha256: str | None = None,
    file: str = "",
    fresh: bool = False,
    most_bytes: float = inf,
) -> Path:
    """Download a file into the user's folder for caches, once, or each time if `fresh`.

    Raises `DataError` if there is no answer, if the file has another `sha256` or more than `most_bytes`, or if `check`
    raises it; then the file is not kept. Raises `StorageError` too.
    """
    file = file or pooch.utils.unique_file_name(url)
    path, book = data_folder() / file, _book({file: sha256 and sha256.lower()}, {file: url})
    with sole_writer(path), storage_errors(path):
        if fresh:
            _remove(path)
        try:
            book.fetch(file, downloader=partial(_go_on, most_bytes))
            check(path)
        except DataError:
            _remove(path)
            raise
        except requests.RequestException as error:
            raise DataError(
                f"{url} cannot be downloaded: {error}. The same call continues from where this one stopped."
            ) from error
        except ValueError as error:  # what pooch raises for another hash
            raise DataError(f"{url} is not the expected file, and is not kept: {error}") from error
    return path


def _book(registry: dict[str, Any], urls: dict[str, str]) -> Any:
    """The registry with which pooch downloads into our folder; it tries a broken download again, once."""
    return pooch.create(data_folder(), base_url="", registry=registry, urls=urls, retry_if_failed=1)


def _partial(path: Path) -> Path:
    """The part of a file that has arrived so far."""
    return path.with_name(f".{path.name}.partial")


def _remove(path: Path) -> None:
    for part in (path, _partial(path)):
        part.unlink(missing_ok=True)


def _go_on(most_bytes: float, url: str, output: str, book: Any) -> None:
    """Download into `output`, continuing an earlier part, which is kept next to it by the file's name."""
    (file,) = book.registry
    arrived = _partial(Path(output).with_name(file))
    with arrived.open("ab") as stored:
        start = stored.tell()
        asked = {"Accept-Encoding": "identity"} | ({"Range": f"bytes={start}-"} if start else {})
        with requests.get(url, headers=asked, stream=True, timeout=30.0) as answer:
            if answer.status_code != requests.codes.requested_range_not_satisfiable:  # that is: nothing is missing
                answer.raise_for_status()
                if answer.status_code != requests.codes.partial_content:  # the server sends all of it
                    stored.truncate(0)
                for block in answer.iter_content(1 << 16):
                    stored.write(block)
                    if stored.tell() > most_bytes:
                        advice = "Download it yourself, check it, and give its path"
                        raise DataError(f"{url} holds more than {most_bytes / 1e6:,.0f} MB. {advice}.")
    shutil.move(arrived, output)
