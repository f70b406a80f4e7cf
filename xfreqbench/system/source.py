"""Which source files a module depends on, found by reading import statements. Nothing is imported for that.

A module depends on what its import statements name, wherever in the file they stand, and on what those modules
depend on in turn. Statements are followed within `xfreqbench`, within the package of the first module asked for,
and into every other file that is not part of an installed library. An `__init__` counts if it holds code; names
that it only offers lazily, by `lazy_loader`, are looked up where it, or the `.pyi` file beside it, imports them.

Not seen are modules that are imported by a name made at run time, and files that are not Python. Grimp, which finds the
imports of packages too, would be one more library that a user has to install.
"""

from __future__ import annotations

import ast
import hashlib
import sys
import sysconfig
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.machinery import ModuleSpec
from itertools import accumulate
from pathlib import Path
from threading import Lock
from typing import NamedTuple

PACKAGE = "xfreqbench"
_DATA = ("examples", "scenes")  # in an editable install not within the package's folder either
_BASELINES = f"{PACKAGE}.baselines"  # in an editable install their folder is not within the package's
_LIBRARY_FOLDERS = {"site-packages", "dist-packages"}
_TYPE_CHECKING = ("TYPE_CHECKING", "typing.TYPE_CHECKING")
_STANDARD_LIBRARY = tuple(Path(sysconfig.get_path(name)) for name in ("stdlib", "platstdlib"))
_parsing = Lock()  # Python 3.11 fails where two threads parse and, as with Dask, garbage collection calls Python


class _Import(NamedTuple):
    """What an import statement asks for: a module, or with `name` something in it. The module's name is absolute."""

    module: str
    name: str | None = None


def package_sha256() -> str:
    """Hash of all Python files of this package, those of the built-in methods included, with their names."""
    digest = hashlib.sha256()
    for name, path in sorted(_package_files().items()):
        digest.update(name.encode() + path.read_bytes())
    return digest.hexdigest()


def _package_files() -> dict[str, Path]:
    """Python files by their paths within the package, the same however it is installed."""
    found: dict[str, Path] = {}
    for package in (PACKAGE, _BASELINES):
        spec = _spec(package, tuple(sys.path))
        for folder in map(Path, (spec.submodule_search_locations or []) if spec else []):
            prefix = package.replace(".", "/")
            paths = (path for path in folder.rglob("*.py") if path.relative_to(folder).parts[0] not in _DATA)
            found |= {f"{prefix}/{path.relative_to(folder).as_posix()}": path for path in paths}
    return found


def reachable_sha256(modules: Iterable[str]) -> str:
    """Hash of the source files that `reachable_sources` returns, with the names of their modules."""
    digest = hashlib.sha256()
    for module, source in sorted(reachable_sources(modules).items()):
        digest.update(module.encode() + hashlib.sha256(source).digest())
    return digest.hexdigest()


def reachable_sources(modules: Iterable[str]) -> dict[str, bytes]:
    """Contents of the source files of `modules` and of all that they depend on, by the name of the module.

    Modules without a file, and those of the standard library, are left out. The answer is kept for the next
    time, and made anew if one of the files has changed since.
    """
    asked = tuple(modules), tuple(sys.path)
    if asked not in _known or not all(map(_is_there, _known[asked].items())):
        _known[asked] = _reachable(asked[0])
    return {module: source for module, (_, source) in _known[asked].items()}


Known = dict[tuple[tuple[str, ...], ...], dict[str, tuple[Path, bytes]]]
_known: Known = {}  # by modules and search path
_contents: dict[bytes, bytes] = {}


def known_sources() -> Known:
    """What `reachable_sources` has found, for another process of this machine, which need not read imports again."""
    return dict(_known)


def remember_sources(known: Known) -> None:
    """Let `reachable_sources` know what another process has found; it looks whether files are the same here."""
    _known.update(known)


def _is_there(known: tuple[str, tuple[Path, bytes]]) -> bool:
    """Whether a module has the file that it had, with the same contents."""
    module, (path, source) = known
    return _file(module) == path and _read(path) == source


def _reachable(modules: tuple[str, ...]) -> dict[str, tuple[Path, bytes]]:
    own = {PACKAGE, modules[0].partition(".")[0]}
    found: dict[str, tuple[Path, bytes]] = {}
    waiting = [module for module in modules if not _is_standard(_file(module))]
    while waiting:
        module = waiting.pop()
        path = _file(module)
        if module in found or path is None:
            continue
        source = _read(path) or b""
        source = _contents.setdefault(source, source)  # those of another search are pickled once with it
        found[module] = path, source
        if _is_idle(path, source) or not _is_followed(module, own):
            continue
        waiting += accumulate(module.split(".")[:-1], "{}.{}".format)
        for asked in _imports(source, module, path.name == "__init__.py") if path.suffix == ".py" else ():
            if _is_followed(asked.module, own):
                waiting += _modules_of(asked)
    return {module: (path, source) for module, (path, source) in found.items() if not _is_idle(path, source)}


def _is_followed(module: str, own: set[str]) -> bool:
    """Whether what a module imports is looked into."""
    top = module.partition(".")[0]
    path = _file(top)
    return top in own or not (path is None or _is_library_folder(path) or _is_standard(path))


def _modules_of(asked: _Import) -> list[str]:
    """The modules that an import is answered from: a submodule, or a module and where its lazy names come from."""
    if asked.name is None:
        return [asked.module]
    if _file(f"{asked.module}.{asked.name}"):
        return [f"{asked.module}.{asked.name}"]
    offered = _offered(asked.module)
    wanted = offered.values() if asked.name == "*" else filter(None, [offered.get(asked.name)])
    return [asked.module, *(module for name in wanted for module in _modules_of(name))]


def _offered(package: str) -> dict[str, _Import]:
    """Names that a package's `__init__`, if it only offers names lazily, imports for a type checker to see."""
    init = _file(package)
    if init is None or init.name != "__init__.py" or not _is_idle(init, _read(init) or b""):
        return {}
    stub = init.with_suffix(".pyi")
    return {
        alias.asname or alias.name: _Import(_absolute(node, package, is_init=True), alias.name)
        for node in ast.walk(_parsed(_read(stub if stub.exists() else init) or b""))
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }


@cache
def _imports(source: bytes, module: str, is_init: bool) -> tuple[_Import, ...]:
    """What a file imports, and which names it takes from what it has imported, as in `import a; a.b.c()`."""
    nodes = list(_executed(_parsed(source)))
    found: list[_Import] = []
    modules: dict[str, str] = {}  # by the names that they have in this file
    for node in nodes:
        if isinstance(node, ast.Import):
            found += [_Import(alias.name) for alias in node.names]
            for alias in node.names:
                top = alias.name.partition(".")[0]
                modules[alias.asname or top] = alias.name if alias.asname else top
        elif isinstance(node, ast.ImportFrom):
            origin = _absolute(node, module, is_init)
            found += [_Import(origin, alias.name) for alias in node.names]
            modules |= {alias.asname or alias.name: f"{origin}.{alias.name}" for alias in node.names}
    for node in nodes:
        if isinstance(node, ast.Attribute):
            root, *names = _dotted(node)
            if root in modules:
                found.append(_Import(".".join([modules[root], *names[:-1]]), names[-1]))
    standard = sys.stdlib_module_names
    return tuple(asked for asked in dict.fromkeys(found) if asked.module.partition(".")[0] not in standard)


def _executed(tree: ast.Module) -> Iterator[ast.AST]:
    """All nodes of a tree but the blocks that only a type checker reads."""
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        if isinstance(node, ast.If) and ast.unparse(node.test) in _TYPE_CHECKING:
            waiting += node.orelse
        else:
            waiting += ast.iter_child_nodes(node)


def _absolute(node: ast.ImportFrom, module: str, is_init: bool) -> str:
    """The module that a `from` statement within `module` names, in full."""
    if not node.level:
        return node.module or ""
    above = module.split(".")[: None if is_init else -1]
    return ".".join([*above[: len(above) - node.level + 1], *filter(None, [node.module])])


def _dotted(node: ast.expr) -> list[str]:
    """The names in `a.b.c`; the first is empty where an attribute is taken of anything but a name."""
    names: list[str] = []
    while isinstance(node, ast.Attribute):
        names.append(node.attr)
        node = node.value
    return [node.id if isinstance(node, ast.Name) else "", *reversed(names)]


def _is_idle(path: Path, source: bytes) -> bool:
    """Whether a file is an `__init__` that computes nothing: docstring, version, and names offered lazily."""
    return path.name == "__init__.py" and all(map(_is_idle_statement, _parsed(source).body))


_IDLE_BEGINNINGS = (
    "from __future__ ",
    "from pathlib ",
    "from typing ",
    "import lazy_loader",
    "import os",
    "import sys",
    "import typing",
    "os.environ.setdefault(",  # how threads wait, and where is kept what was compiled, changes no result
    "from xfreqbench.system.caches ",
    "from xfreqbench.system.callable_package ",
    "settle_caches()",
)


def _is_idle_statement(node: ast.stmt) -> bool:
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return True
    if isinstance(node, ast.Assign):
        value = node.value
        is_lazy = isinstance(value, ast.Call) and _dotted(value.func)[-1] in ("attach", "attach_stub")
        return is_lazy or ast.unparse(node.targets[0]).startswith("__")
    if isinstance(node, ast.If):
        refuses = all(isinstance(statement, ast.Raise) for statement in node.body)
        return (refuses or ast.unparse(node.test) in _TYPE_CHECKING) and not node.orelse
    return ast.unparse(node).startswith(_IDLE_BEGINNINGS)


@cache
def _parsed(source: bytes) -> ast.Module:
    with _parsing:
        try:
            return ast.parse(source)
        except (SyntaxError, ValueError):  # a file that cannot be run either
            return ast.Module([], [])


def _read(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except OSError:
        return None


def _file(module: str) -> Path | None:
    """The file of a module, whether it is imported or not; None where it has none, or is not there."""
    loaded = getattr(sys.modules.get(module), "__file__", None)
    spec = None if loaded else _spec(module, tuple(sys.path))
    path = Path(loaded or (spec.origin if spec and spec.origin else ""))
    return path if path.is_file() else None


@cache
def _spec(module: str, search_path: tuple[str, ...]) -> ModuleSpec | None:
    """What the import system would load for a name; unlike `find_spec`, this imports no parent package."""
    parent, _, name = module.rpartition(".")
    folders = None
    if parent:
        above = _spec(parent, search_path)  # once it is imported, it may have added to its folders
        own = above.submodule_search_locations if above else None
        found = getattr(sys.modules.get(parent), "__path__", own)
        if found is None:
            return None
        folders = list(found)
    for finder in sys.meta_path:
        try:
            spec = finder.find_spec(module, folders) if hasattr(finder, "find_spec") else None
        except KeyError:  # Python describes a folder without `__init__` by the package around it, if that is imported
            spec = ModuleSpec(module, None, is_package=True)
            spec.submodule_search_locations = [str(Path(folder, name)) for folder in folders or []]
        if spec:
            return spec
    return None


def _is_standard(path: Path | None) -> bool:
    return path is not None and not _is_library_folder(path) and any(map(path.is_relative_to, _STANDARD_LIBRARY))


def _is_library_folder(path: Path) -> bool:
    return not _LIBRARY_FOLDERS.isdisjoint(path.parts)
