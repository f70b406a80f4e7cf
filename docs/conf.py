"""How Sphinx makes the site of these pages, of the tables of all boards and of every public name's docstring.

Sphinx, because its search needs no server, and because it finds broken links in pages and docstrings alike.
"""

import xfreqbench

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
