"""How Sphinx makes the site of these pages, of the tables of all boards and of every public name's docstring.

Sphinx, because its search needs no server, and because it finds broken links in pages and docstrings alike. Beside the
pages stand those that the toolkit writes: the reference boards, and the office with its maps and rays.
"""

from pathlib import Path

import xfreqbench
from xfreqbench.report.leaderboard.page import write_page
from xfreqbench.report.view.plan import plan_view
from xfreqbench.report.view.write import write_view

project, author, release = "xfreqbench", "the authors of xfreqbench", xfreqbench.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "docs/index"
include_patterns = ["*.md", "docs/*.md", "docs/*.rst", "docs/results/*.md", "baselines/**.md", "examples/*/README.md"]
html_theme = "furo"
html_extra_path = ["index.html"]
html_copy_source = False
default_role = "code"
myst_heading_anchors = 4
myst_enable_extensions = ["tasklist"]
suppress_warnings = ["misc.highlighting_failure"]  # a diagram is shown as its text


def setup(app):
    """Have the toolkit's own pages written at the end."""
    app.connect("build-finished", write_pages)


def write_pages(app, error):
    """Write `docs/boards.html` with its tables, and the folder `docs/office`."""
    if error is None and app.builder.format == "html":
        folder = Path(app.outdir) / "docs"
        write_page([Path(app.srcdir) / "baselines" / "reference_results.parquet"], folder / "boards.html")
        write_view(plan_view(str(xfreqbench.load("office").path)).with_rays(), folder / "office")
