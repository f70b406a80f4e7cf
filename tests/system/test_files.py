from __future__ import annotations

import errno
import fcntl
import multiprocessing
import os
import platform
import time
from pathlib import Path

import pytest

from tests.support.stored_records import make_record
from xfreqbench.errors import OutputExistsError, StorageError
from xfreqbench.runs.records import append
from xfreqbench.system.files import (
    atomic_folder,
    atomic_path,
    exclusive,
    read_bytes,
    read_text,
    require_empty,
    require_own,
    require_space,
    write_text,
)


def _count_up(folder: Path) -> None:
    counter = folder / "counter"
    for _ in range(50):
        with exclusive(folder / "lock"):
            counter.write_text(str(int(counter.read_text()) + 1))


def test_processes_take_turns(tmp_path: Path) -> None:
    (tmp_path / "counter").write_text("0")
    context = multiprocessing.get_context("fork")
    processes = [context.Process(target=_count_up, args=(tmp_path,)) for _ in range(3)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert (tmp_path / "counter").read_text() == "150"
    assert not (tmp_path / "lock").exists()


def test_a_lock_is_let_go_after_an_error(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="within"), exclusive(tmp_path / "lock"):
        raise ValueError("within")
    with exclusive(tmp_path / "lock"):
        pass


def test_a_lock_that_cannot_be_made_says_so(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="cannot be written"), exclusive(tmp_path / "file" / "lock"):
        pass


@pytest.mark.parametrize("number", [errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK])
def test_a_file_system_without_locks_is_refused_in_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def no_lock(descriptor: int, operation: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", no_lock)
    for write in (lambda: write_text(tmp_path / "output", "new"), lambda: append(tmp_path / "r.jsonl", make_record())):
        with pytest.raises(StorageError, match=rf"has no locks \(flock: {os.strerror(number)}\).* another one"):
            write()
    assert not [path for path in tmp_path.iterdir() if path.suffix != ".lock"]


def _write_for_ever(path: Path) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text("half")
        time.sleep(600)


def test_one_process_at_a_time_writes_a_file_and_after_its_kill_the_next(tmp_path: Path) -> None:
    path = tmp_path / "office[1].h5"
    process = multiprocessing.get_context("fork").Process(target=_write_for_ever, args=(path,))
    process.start()
    while not list(tmp_path.glob("*.partial")):
        time.sleep(0.01)
    with pytest.raises(StorageError, match=rf"office\[1\]\.h5 is being written by process {process.pid} on .*Wait"):
        write_text(path, "other")
    process.kill()
    process.join()
    write_text(path, "whole")
    assert [(left.name, left.read_text()) for left in tmp_path.iterdir()] == [(path.name, "whole")]


def test_what_others_write_in_the_meantime_stays(tmp_path: Path) -> None:
    path = tmp_path / "output"
    for before in (None, "ours"):
        if before:
            path.write_text(before)
        with pytest.raises(OutputExistsError, match="in the meantime"), atomic_path(path) as temporary:
            temporary.write_text("new")
            path.write_text("theirs")
        assert [(left.name, left.read_text()) for left in tmp_path.iterdir()] == [("output", "theirs")]
    require_own(path, lambda file: None)
    path.write_text("theirs, after the look")
    with pytest.raises(OutputExistsError, match="in the meantime"), atomic_path(path):
        pytest.fail("nothing is to be done in vain")
    write_text(path, "new caf\udce9.h5")  # the name of a file that is no UTF-8
    assert path.read_text() == "new caf\\udce9.h5"
    folder = tmp_path / "folder"
    with pytest.raises(OutputExistsError, match="is not an empty folder"), atomic_folder(folder) as temporary:
        (temporary / "file").write_text("new")
        folder.mkdir()
        (folder / "file").write_text("theirs")
    assert (folder / "file").read_text() == "theirs"


def test_a_name_that_is_too_long_is_refused_before_the_work(tmp_path: Path) -> None:
    limit = os.pathconf(tmp_path, "PC_NAME_MAX")
    path = tmp_path / ("é" * (limit // 2 - 6) + ".h5")
    with pytest.raises(StorageError, match=rf"é\.h5 has {len(os.fsencode(path.name))} bytes, \d+ too many"):
        require_own(path, lambda file: None)
    surplus = max(24, len(f"..{platform.node()}-{os.getpid()}.partial"))
    longest = tmp_path / ("n" * (limit - surplus))
    with pytest.raises(StorageError, match=", 1 too many"):
        require_own(longest.with_name(longest.name + "n"), lambda file: None)
    require_own(longest, lambda file: None)
    write_text(longest, "whole")
    deep = tmp_path.joinpath(*[200 * "d"] * (os.pathconf(tmp_path, "PC_PATH_MAX") // 201 - 2))
    for refuse in (require_empty, lambda path: require_space(path, 1)):
        with pytest.raises(StorageError, match=r"dd has \d+ bytes, \d+ too many|File name too long"):
            refuse(deep / (200 * "d"))


def test_nothing_may_be_written_over_but_what_is_known_to_be_ours(tmp_path: Path) -> None:
    path = tmp_path / "output"

    def fault_of(file: Path) -> str | None:
        return None if file.read_text(encoding="utf-8") == "ours" else "is not ours."

    assert not require_own(path, fault_of)
    path.write_text("ours")
    assert require_own(path, fault_of)
    path.write_text("theirs")
    with pytest.raises(OutputExistsError, match=r"output exists and is not ours\. Mend it\.$"):
        require_own(path, fault_of, "Mend it.")
    with pytest.raises(StorageError, match="is not a file"):
        require_own(tmp_path, fault_of)
    with pytest.raises(StorageError, match="output"):
        require_own(path, lambda file: (file / "no folder").read_text())


def test_only_what_ends_is_read(tmp_path: Path) -> None:
    (tmp_path / "text").write_bytes("λ/2 é".encode())
    assert read_text(tmp_path / "text") == read_bytes(tmp_path / "text").decode() == "λ/2 é"
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        for read in (read_text, read_bytes):
            with pytest.raises(OSError, match=f"a pipe or a device, not a file: '{path}'"):
                read(path)
    with pytest.raises(FileNotFoundError):
        read_text(tmp_path / "nothing")
