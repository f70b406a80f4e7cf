from __future__ import annotations

import _ctypes
import importlib.metadata
import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from xfreqbench.errors import MissingLLVMError
from xfreqbench.tracing.sionna import llvm


class ListedFile:
    """What `importlib.metadata.files` lists: a name, and where it was installed."""

    def __init__(self, path: Path) -> None:
        self.name = path.name
        self._path = path

    def locate(self) -> Path:
        return self._path


@pytest.fixture(autouse=True)
def nothing_is_set_or_installed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def not_installed(package: str) -> list[ListedFile]:
        raise importlib.metadata.PackageNotFoundError(package)

    monkeypatch.setenv(llvm.VARIABLE, "")  # empty counts as unset; what a test sets is undone after it
    monkeypatch.setattr(importlib.metadata, "files", not_installed)
    monkeypatch.setattr(llvm, "SYSTEM_FOLDERS", (str(tmp_path / "system"),))
    monkeypatch.setattr("ctypes.util.find_library", lambda name: None)


def install(monkeypatch: pytest.MonkeyPatch, *paths: Path) -> None:
    monkeypatch.setattr(importlib.metadata, "files", lambda package: [ListedFile(path) for path in paths])


def let_any_file_load(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(llvm.ctypes, "CDLL", lambda path: SimpleNamespace(LLVMContextCreate=None))


def system_library(tmp_path: Path, name: str) -> Path:
    (tmp_path / "system").mkdir(exist_ok=True)
    path = tmp_path / "system" / name
    path.touch()
    return path


def test_the_packages_real_file_is_taken_and_not_its_symlink(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    let_any_file_load(monkeypatch)
    real = tmp_path / "libLLVM.so.23.1"
    real.touch()
    link = tmp_path / "libLLVM.so.23"
    link.symlink_to(real)
    install(monkeypatch, link, tmp_path / "libLLVM.so", real)
    assert llvm.ensure_llvm() == os.environ[llvm.VARIABLE] == str(real)
    assert llvm.llvm_version() == "23.1"


def test_a_library_that_the_user_set_is_left_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    let_any_file_load(monkeypatch)
    chosen = tmp_path / "libLLVM-19.so.1"
    chosen.touch()
    packaged = tmp_path / "libLLVM.so.23.1"
    packaged.touch()
    install(monkeypatch, packaged)
    monkeypatch.setenv(llvm.VARIABLE, str(chosen))
    assert llvm.ensure_llvm() == str(chosen)
    assert llvm.llvm_version() == "19.1"


def test_a_path_of_the_users_without_a_file_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(llvm.VARIABLE, "/nowhere/libLLVM.so")
    with pytest.raises(MissingLLVMError, match=r"/nowhere/libLLVM\.so.*pip install karellen-llvm-core"):
        llvm.ensure_llvm()


def test_a_file_of_the_users_that_is_not_llvm_is_an_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "libLLVM.so").write_bytes(b"no library")
    libraries = {str(tmp_path / "libLLVM.so"): "not a library that can be loaded", _ctypes.__file__: "without LLVM"}
    for path, fault in libraries.items():
        monkeypatch.setenv(llvm.VARIABLE, path)
        with pytest.raises(MissingLLVMError, match=fault):
            llvm.ensure_llvm()


def test_without_the_package_the_newest_usable_system_library_is_taken(tmp_path: Path) -> None:
    for name in ("libLLVM-14.so.1", "libLLVM-17.so.1", "libLLVM.so.19.1"):
        newest = system_library(tmp_path, name)
    assert llvm.ensure_llvm() == str(newest)


@pytest.mark.parametrize("name", ["libLLVM-14.so.1", "libLLVM-15.so", "libLLVM.so.16.0", "libLLVM.so"])
def test_system_libraries_that_abort_the_process_are_never_taken(tmp_path: Path, name: str) -> None:
    system_library(tmp_path, name)
    with pytest.raises(MissingLLVMError, match="Run `pip install karellen-llvm-core`"):
        llvm.ensure_llvm()
