"""Installed packages of others, without pip."""

from __future__ import annotations

from pathlib import Path


def install(folder: Path, package: str, group: str, **entries: str) -> None:
    """What pip leaves in a folder of an editable package: its name, and its entry points of one group."""
    information = folder / f"{package.replace('-', '_')}-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    lines = [f"{name} = {value}" for name, value in entries.items()]
    (information / "entry_points.txt").write_text("\n".join([f"[{group}]", *lines, ""]))
