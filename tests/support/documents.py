"""Documents that can be run: fenced blocks of Markdown, one after the other, in a folder of their own.

`sh` blocks are given to bash, `python` blocks share one namespace, `toml` blocks are parsed. A block below a
line that holds only `` `name`: `` becomes that file instead of being run. An `output` block is what the block
before it has printed, `...` standing for anything. Blocks of `INTERPRETERS` are run where the interpreter is
installed, and the paragraph above them says so, in the words of `RUN_SOMEWHERE`. Blocks of other languages are not
run; the paragraph above them says that, in the words of `NOT_RUN`.
"""

from __future__ import annotations

import contextlib
import doctest
import functools
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from dataclasses import dataclass, field
from pathlib import Path

from markdown_it import MarkdownIt

from tests.support.forked import ONE_THREAD, command_line
from tests.support.places import ROOT

RUNNABLE = ("sh", "python", "toml", "output")
NOT_RUN, RUN_SOMEWHERE = "not run by our tests", "run by our tests where"
INTERPRETERS = {  # by language: how a text is run, and a text that runs only where all that is needed is there
    "r": (["Rscript", "-e"], "library(rhdf5)"),
    "matlab": (["matlab", "-batch"], "version"),
    "octave": (["octave", "--no-gui", "--quiet", "--eval"], "version"),
}
_FILE_NAME = re.compile(r"^`([\w./-]+)`:$", re.MULTILINE)
_LENIENT = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
_OFFLINE_PIP = {  # pip as the documents call it, but without a network and into a folder beside the document
    "PIP_NO_INDEX": "1",
    "PIP_NO_DEPS": "1",
    "PIP_NO_BUILD_ISOLATION": "0",  # pip reads this one backwards: 0 is "no isolation"
    "PIP_DISABLE_PIP_VERSION_CHECK": "1",
}


@dataclass(frozen=True)
class Block:
    """One fenced block: what it is written in, where it stands, and the paragraph above it."""

    document: Path
    line: int
    language: str
    text: str
    above: str

    @property
    def file_name(self) -> str | None:
        """The file that the block is, if it is one."""
        named = _FILE_NAME.search(self.above)
        return named[1] if named else None

    @property
    def is_followed(self) -> bool:
        """Whether a reader does something with it."""
        return self.language in RUNNABLE or self.file_name is not None or is_installed(self.language)

    @property
    def says_why_not(self) -> bool:
        """Whether the text above tells the reader that our tests do not run it, or not everywhere."""
        return (RUN_SOMEWHERE if self.language in INTERPRETERS else NOT_RUN) in self.above

    @property
    def place(self) -> str:
        """As an editor opens it."""
        return f"{self.document}:{self.line}"


@functools.cache
def is_installed(language: str) -> bool:
    """Whether there is an interpreter of a language here, and the library that the documents use."""
    command, probe = INTERPRETERS.get(language, ([""], ""))
    if not shutil.which(command[0]):
        return False
    return subprocess.run([*command, probe], capture_output=True).returncode == 0


def blocks(document: Path) -> list[Block]:
    """Every fenced block of a document, as CommonMark sees it."""
    above, found = "", []
    for token in MarkdownIt().parse(document.read_text(encoding="utf-8")):
        if token.type == "inline":
            above = token.content
        if token.type == "fence":
            assert token.map is not None
            found.append(Block(document, token.map[0] + 1, token.info.strip(), token.content, above))
            above = ""
    return found


@dataclass
class Reader:
    """Somebody who follows a document word for word, in a folder; `printed` is what each block has said."""

    folder: Path
    printed: dict[str, str] = field(default_factory=dict)
    namespace: dict[str, object] = field(default_factory=lambda: {"__name__": "__main__"})
    _last: str = ""

    def follow(self, block: Block) -> None:
        """Do what a block of a runnable language says; raises where that fails."""
        if block.language == "toml":
            tomllib.loads(block.text)
        if block.file_name:
            path = self.folder / block.file_name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.text)
        elif block.language == "output":
            _compare(block, self._last)
        elif block.language in ("sh", "python"):
            self._last = self.shell(block.text, block.place) if block.language == "sh" else self._python(block)
            self.printed[block.text] = self._last
        elif block.language in INTERPRETERS:
            command, _ = INTERPRETERS[block.language]
            self._last = self.shell(shlex.join([*command, block.text]), block.place)

    def said(self, part: str) -> str:
        """What the first block that contains a text has printed."""
        return next(printed for text, printed in self.printed.items() if part in text)

    def shell(self, command: str, place: str = "") -> str:
        """What commands print, both streams; they must succeed."""
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", command],
            cwd=self.folder,
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        assert done.returncode == 0, f"{place or command} ended with code {done.returncode}:\n{done.stdout}"
        return done.stdout

    def _python(self, block: Block) -> str:
        padding = "\n" * block.line  # so that a traceback names the document's own line
        code = compile(padding + block.text, str(block.document), "exec")
        with contextlib.chdir(self.folder), contextlib.redirect_stdout(io.StringIO()) as printed:
            exec(code, self.namespace)
        return printed.getvalue()

    @property
    def _environment(self) -> dict[str, str]:
        site = self.folder.parent / "site"
        programs = [Path(command_line()).parent, Path(sys.executable).parent, os.environ["PATH"]]
        return {
            **os.environ,
            **_OFFLINE_PIP,
            **ONE_THREAD,  # tests run side by side
            "PATH": os.pathsep.join(map(str, programs)),
            "PIP_TARGET": str(site),
            "PYTHONPATH": str(site),
            "COLUMNS": "120",
        }


def _compare(block: Block, printed: str) -> None:
    checker = doctest.OutputChecker()
    example = doctest.Example("", block.text)
    difference = checker.output_difference(example, printed, _LENIENT)
    assert checker.check_output(example.want, printed, _LENIENT), f"{block.place}\n{difference}"


def follow(document: Path, folder: Path) -> Reader:
    """A reader who has followed every runnable block of a document, in a new folder or one that is there.

    The toolkit's own checkout lies beside that folder, as `../xfreqbench`.
    """
    folder.mkdir(exist_ok=True)
    (folder.parent / "xfreqbench").symlink_to(ROOT, target_is_directory=True)
    reader = Reader(folder)
    for block in blocks(document):
        if block.is_followed:
            reader.follow(block)
    return reader
