"""Packages that are installed for a test: modules and metadata in a folder on the path."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

# One of every kind that a package can add to pcretrieve.
ADDITION = Path(__file__).with_name("addition")


def install(
    site: Path, name: str, modules: Mapping[str, str], entry_points: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Install a package into a folder, and put the folder on the path until the test ends."""
    metadata = site / f"{name}-1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(entry_points)
    for module, text in modules.items():
        (site / f"{module}.py").write_text(text, encoding="utf-8")
        monkeypatch.delitem(sys.modules, module, raising=False)
    monkeypatch.syspath_prepend(site)


def install_addition(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install the package that adds one of every kind."""
    text = (ADDITION / "addition.py").read_text(encoding="utf-8")
    entry_points = (ADDITION / "entry_points.txt").read_text(encoding="utf-8")
    install(site, "addition", {"addition": text}, entry_points, monkeypatch)
