"""The script of three.js that trimesh brings."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from zipfile import ZipFile

import pytest

from xfreqbench.report.drawing import three_js as module
from xfreqbench.report.drawing.three_js import three_js

VIEWER = "trimesh", "resources/templates/viewer.zip"


def test_the_library_comes_alone_and_under_its_licence() -> None:
    script = three_js()
    assert script and script.startswith("/*\nthree.js, Copyright 2010-")
    assert "Permission is hereby granted, free of charge" in script.partition("*/")[0]
    assert "TrackballControls" not in script and "B64GLTF" not in script  # trimesh's own page is left out
    assert 500_000 < len(script.encode()) < 700_000


@pytest.mark.parametrize(
    "page", [None, b"<script>new THREE.Scene()</script>"], ids=["no archive", "no licence"]
)
def test_a_trimesh_without_it_is_no_error(
    page: bytes | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if page is not None:
        content = BytesIO()
        with ZipFile(content, "w") as archive:
            archive.writestr("viewer.html.template", page)
        (tmp_path / "resources" / "templates").mkdir(parents=True)
        (tmp_path / VIEWER[1]).write_bytes(content.getvalue())
    monkeypatch.setattr(module, "files", lambda package: tmp_path)
    assert three_js.__wrapped__() is None
