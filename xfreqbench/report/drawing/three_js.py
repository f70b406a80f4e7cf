"""The script of three.js, which draws in 3D within a web page, as trimesh brings it for its own viewer."""

from __future__ import annotations

import re
from functools import cache
from importlib.resources import files
from io import BytesIO
from zipfile import BadZipFile, ZipFile

_LICENCE = """/*
three.js, {copyright}, as it comes with trimesh; the MIT License:

Permission is hereby granted, free of charge, to any person obtaining a copy of this software and associated
documentation files (the "Software"), to deal in the Software without restriction, including without limitation the
rights to use, copy, modify, merge, publish, distribute, sublicense, and/or sell copies of the Software, and to permit
persons to whom the Software is furnished to do so, subject to the following conditions:

The above copyright notice and this permission notice shall be included in all copies or substantial portions of the
Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR IMPLIED, INCLUDING BUT NOT LIMITED TO THE
WARRANTIES OF MERCHANTABILITY, FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE AUTHORS OR
COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR
OTHERWISE, ARISING FROM, OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE SOFTWARE.
*/
"""
_VIEWER = ("trimesh", "resources/templates/viewer.zip", "viewer.html.template")
_LIBRARY = re.compile(
    r"/\*\*\s+\* @license\s+\* (Copyright[^\n]+)\s+\* SPDX-License-Identifier: MIT"
    r'.*?"__esModule",\{value:!0\}\)\}\)\);',
    re.DOTALL,
)


@cache
def three_js() -> str | None:
    """The library, which defines the global `THREE`, under its licence: some 600 KB, to stand in a `script` element.

    None if the installed trimesh brings none that names its licence, as before 4.8.3: what shows it must do without.
    """
    package, archive, template = _VIEWER
    try:
        with ZipFile(BytesIO((files(package) / archive).read_bytes())) as opened:
            page = opened.read(template).decode()
    except (OSError, KeyError, BadZipFile):
        return None
    library = _LIBRARY.search(page)
    if library is None or "</script" in library.group():
        return None
    return _LICENCE.format(copyright=library.group(1).strip()) + library.group()
