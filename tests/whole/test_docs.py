"""The documents say what is so: every block is run, every command can be given, every link leads somewhere."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Sequence
from html.parser import HTMLParser
from itertools import takewhile
from pathlib import Path
from urllib.parse import unquote, urlsplit

import h5py
import pytest
from markdown_it import MarkdownIt
from pydantic import BaseModel

import xfreqbench as xb
from tests.support.documents import INTERPRETERS, ROOT, blocks, follow
from tests.support.notebooks import NOTEBOOKS, read
from tests.support.plans import small_plan
from tests.support.synthetic import paper_dataset, write_dataset
from xfreqbench.cli.main import app
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.splits import make_splits
from xfreqbench.exchange.conventions import convention_rows
from xfreqbench.exchange.split_file import write_splits
from xfreqbench.report.leaderboard.maps import ShownMaps
from xfreqbench.runs.records import RunRecord
from xfreqbench.tracing.sionna.llvm import ensure_llvm

DOCUMENTS = sorted((ROOT / "docs").glob("*.md"))
RESULTS = sorted((ROOT / "docs" / "results").glob("*.md"))  # generated
TEMPLATES = sorted((ROOT / "examples").glob("*/README.md"))  # run by test_template.py
METHODS = ROOT / "baselines" / "README.md"
VIRTUAL_SOURCE = ROOT / "baselines" / "virtual_source" / "README.md"
README = ROOT / "README.md"
API, FORMATS, SIONNA = (ROOT / "docs" / name for name in ("api.md", "data-format.md", "sionna.md"))
RUN_HERE = [  # one has a test of its own
    path
    for path in [README, METHODS, *DOCUMENTS]
    if path != SIONNA and any(block.is_followed for block in blocks(path))
]
ALL = [README, ROOT / "BENCHMARK.md", METHODS, VIRTUAL_SOURCE, *DOCUMENTS, *RESULTS, *TEMPLATES]


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


every_document = pytest.mark.parametrize("document", ALL, ids=named)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("document", RUN_HERE, ids=named)
def test_every_block_of_a_document_does_what_it_says(document: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    work.mkdir()
    if document == METHODS:
        paper_dataset(work / "office.h5")
    reader = follow(document, work)
    if document == METHODS:
        assert "warn" not in reader.said("check-method my-method")
        blind, learned = (record.scores["psnr"].median for record in xb.read_records(work / "results")[:2])
        assert learned > blind
        assert "my-method" in reader.said("report results")
    if document == README:  # its commands stand in indented blocks, and use the data that its Python has made
        for command in command_lines(document, ("code_block",)):
            reader.shell(shlex.join(["xfreqbench", *command]))


@pytest.mark.slow
@pytest.mark.sionna
def test_sionna_rt_deviates_as_its_page_says(tmp_path: Path) -> None:
    """Where this fails with a later Sionna RT, a deviation has been mended: take it off the page."""
    ensure_llvm()
    follow(SIONNA, tmp_path / "work")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("```sh\nfalse\n```", "ended with code 1"),
        ("```sh\nfalse | true\n```", "ended with code 1"),
        ("```python\nint('one')\n```", "invalid literal"),
        ("```toml\na = \n```", "Invalid value"),
        ("`a.toml`:\n\n```toml\na = \n```", "Invalid value"),
        ("```sh\necho 1\n```\n\n```output\n2\n```", "Expected"),
        ("```python\nprint('one two')\n```\n\n```output\none\n```", "Expected"),
    ],
)
def test_a_reader_stumbles_over_what_is_not_so(text: str, why: str, tmp_path: Path) -> None:
    (tmp_path / "wrong.md").write_text(text)
    with pytest.raises((AssertionError, ValueError), match=why):
        follow(tmp_path / "wrong.md", tmp_path / "work")


@every_document
def test_what_is_not_run_says_so(document: Path) -> None:
    not_everywhere = [block for block in blocks(document) if block.language in INTERPRETERS or not block.is_followed]
    assert not [block.place for block in not_everywhere if not block.says_why_not]


@every_document
def test_no_block_is_overlooked(document: Path) -> None:
    """Fences as a plain search finds them are those that are followed."""
    fences = re.findall(r"^ *(```+)(\w*)$", document.read_text(encoding="utf-8"), re.MULTILINE)
    assert [language for _, language in fences[::2]] == [block.language for block in blocks(document)]


def test_every_document_of_the_project_is_read() -> None:
    tracked = {path for folder in ("baselines", "docs", "examples") for path in (ROOT / folder).rglob("*.md")}
    assert tracked - {path for path in tracked if ".pytest_cache" in path.parts} <= set(ALL)


def python_texts() -> Iterator[tuple[str, str]]:
    """Every program that readers are shown, with its place: in documents, in notebooks, and the template."""
    for document in ALL:
        for block in blocks(document):
            if block.language == "python":
                yield block.place, block.text
    for notebook in NOTEBOOKS:
        for number, cell in enumerate(read(notebook).cells):
            if cell.cell_type == "code":
                lines = [line for line in cell.source.splitlines() if not line.startswith("%")]
                yield f"{notebook.name}, cell {number}", "\n".join(lines)
    for path in (ROOT / "examples").glob("*-template/**/*.py"):
        yield named(path), path.read_text("utf-8")


def private_names(text: str) -> set[str]:
    """What a program imports of xfreqbench, or asks of `xb`, that is not public."""
    modules = re.findall(r"^\s*(?:from|import) (xfreqbench\.\S+)", text, re.MULTILINE)
    imported = re.findall(r"^\s*from xfreqbench import (\([^)]*\)|.*)", text, re.MULTILINE)
    names = {name for line in imported for name in re.findall(r"\w+", line)} | set(re.findall(r"\bxb\.(\w+)", text))
    return set(modules) | (names - set(xb.__all__))


def test_readers_are_shown_public_names_only() -> None:
    assert all(map(private_names, ("import xfreqbench.units", "    from xfreqbench import units", "xb.units")))
    texts = list(python_texts())
    assert len(texts) > 60
    assert not {place: names for place, text in texts if (names := private_names(text))}


@every_document
def test_every_command_line_can_be_given(document: Path) -> None:
    """Those of long runs too, which only stand there: in indented blocks, in `text` blocks and between backticks."""
    for command in command_lines(document):
        if any(word.startswith("-") for word in command):
            app.parse_args(command, exit_on_error=False, print_error=False, help_on_error=False)
        else:
            names, _, _ = app.parse_commands(command)
            assert names or not command, f"there is no command {command}"


def command_lines(document: Path, kinds: Sequence[str] = ("fence", "code_block", "code_inline")) -> list[list[str]]:
    """What follows the word xfreqbench in every line of code, up to where the shell begins something else."""
    tokens = MarkdownIt().parse(document.read_text(encoding="utf-8"))
    tokens += [child for token in tokens for child in token.children or []]
    texts = [token.content for token in tokens if token.type in kinds]
    lines = [line.strip() for text in texts for line in text.replace("\\\n", " ").splitlines()]
    words = [shlex.split(line, comments=True) for line in lines if line.startswith("xfreqbench ")]
    return [list(takewhile(lambda word: word not in SHELL, line[1:])) for line in words]


SHELL = ("|", "||", "&&", "&", ">", "2>&1", ";")


@every_document
def test_every_link_between_documents_leads_somewhere(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    targets = re.findall(r"\]\((?!https?://)([^)#\s]+)", text)
    assert not [target for target in targets if not (document.parent / target).exists()]


def table(document: Path, heading: str) -> list[list[str]]:
    """Cells of the first table below a heading, without its head; code marks taken off."""
    below = document.read_text(encoding="utf-8").split(f"\n{heading}\n", 1)[1]
    rows = re.findall(r"^\|(.*)\|$", below.split("\n#", 1)[0], re.MULTILINE)
    return [[cell.strip().replace("`", "") for cell in row.split("|")] for row in rows[2:]]


def variables(group: h5py.Group, within: str = "") -> list[list[str]]:
    """Name, axes, type and unit of every variable of an HDF5 group, as the file itself says."""
    return [
        [f"{within}{name}", axes(variable), str(variable.dtype), variable.attrs["units"].decode()]
        for name, variable in group.items()
        if isinstance(variable, h5py.Dataset)
    ]


def axes(variable: h5py.Dataset) -> str:
    scales = [variable] if variable.is_scale else [scales[0] for scales in variable.dims]
    return ", ".join(scale.name.strip("/") for scale in scales)


def test_the_tables_of_variables_and_attributes_are_those_of_the_files(tmp_path: Path) -> None:
    write_dataset(tmp_path / "data.h5", num_tx=2)
    with h5py.File(tmp_path / "data.h5") as file:
        assert sorted(row[:4] for row in table(FORMATS, "### Variables")) == sorted(variables(file))
        assert sorted(row[0] for row in table(FORMATS, "### Attributes")) == sorted(file.attrs)


def test_the_table_of_paths_is_that_of_the_files(tmp_path: Path) -> None:
    generate_planned(small_plan(num_transmitters=1, paths=True), tmp_path / "data.h5")
    with h5py.File(tmp_path / "data.h5") as file:
        assert sorted(row[:4] for row in table(FORMATS, "### Paths")) == sorted(variables(file["paths"], "paths/"))


def test_the_table_of_split_files_names_every_variable(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5", num_tx=2)
    splits = make_splits(dataset, "lofo", [10])
    write_splits(dataset, splits, tmp_path / "split.h5", maps=True)
    with h5py.File(tmp_path / "split.h5") as file:
        found = sorted(file[splits[0].name])
    described = table(FORMATS, "## Split files")
    assert sorted(name for row in described for name in row[0].split(", ")) == found


@pytest.mark.parametrize(("heading", "model"), [("## Records", RunRecord), ("## Maps to show", ShownMaps)])
def test_a_table_of_fields_names_every_one(heading: str, model: type[BaseModel]) -> None:
    fields = [name for row in table(FORMATS, heading) for name in row[0].split(", ")]
    assert sorted(fields) == sorted(model.model_fields)


def test_the_table_of_conventions_is_that_of_the_code() -> None:
    described = table(FORMATS, "## PNG folders")
    assert [tuple(row) for row in described] == convention_rows()


def test_the_interface_describes_every_public_name_and_no_other() -> None:
    names = [
        cells[0]
        for topic in ("Scenes and rays", "Data", "Maps and scores", "Methods", "Runs and results")
        for cells in table(API, f"### {topic}")
    ]
    assert sorted(names) == sorted(xb.__all__)


@pytest.mark.slow
def test_the_site_has_every_page_every_public_name_and_no_broken_link(tmp_path: Path) -> None:
    site = tmp_path / "site"
    command = [sys.executable, "-m", "sphinx", "-W", "-q", "-c", "docs", "-d", str(tmp_path / "read"), ".", str(site)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=280)
    assert built.returncode == 0, built.stderr  # -W: a broken link is an error
    assert all((site / path.relative_to(ROOT)).with_suffix(".html").exists() for path in ALL)
    reference = (site / "docs" / "reference.html").read_text("utf-8")
    described = set(re.findall(r'id="(?:module-)?xfreqbench\.(?:maps\.)?(\w+)"', reference))
    assert set(xb.__all__) - {"__version__", "methods", "scenes"} <= described  # two are packages that can be called
    index = (site / "searchindex.js").read_text("utf-8")  # a script, which a page on a disk may load, too
    assert all(word in index for word in ("docs/results/office", "spars", "bartlett"))
    assert not list(broken_links(site))


class Links(HTMLParser):
    """What a page names: its own places, addresses that it links to, and files that it needs to be shown."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.places, self.linked, self.needed = {""}, set[str](), set[str]()
        self.feed(page.read_text("utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        told = {name: value or "" for name, value in attrs}
        self.places |= {told[name] for name in ("id", "name") if name in told}
        needed = [told[name] for name in ("src", "data") if name in told and tag != "use"]
        needed += [told["href"]] if tag == "link" and "stylesheet" in told.get("rel", "") else []
        self.needed |= {address for address in needed if not address.startswith("data:")}
        self.linked |= {told["href"]} if tag == "a" and "href" in told else set()


def broken_links(site: Path) -> Iterator[str]:
    """Links of a site that lead nowhere within it, files that a page would fetch, and addresses of no valid form."""
    pages = {page: Links(page) for page in site.rglob("*.html") if page.parent.name != "_static"}
    for page, links in pages.items():
        for address in links.linked | links.needed:
            parts = urlsplit(address)
            if parts.scheme == "mailto":
                continue
            if parts.scheme or parts.netloc:
                is_whole = parts.scheme == "https" and "." in parts.netloc and not set(address) & set(' <>"`')
                if address in links.needed or not is_whole:
                    yield f"{page.relative_to(site)}: {address}"
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            if not target.is_file() or (target in pages and unquote(parts.fragment) not in pages[target].places):
                yield f"{page.relative_to(site)}: {address}"
