"""Packages that are installed for a test: modules and metadata in a folder on the path."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


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


# --- the package of CONTRIBUTING.md ---------------------------------------------------------------------

CONTRIBUTING = (Path(__file__).parents[1] / "CONTRIBUTING.md").read_text(encoding="utf-8")
PYTHON_BLOCKS = re.findall(r"```python\n(.*?)```", CONTRIBUTING, re.DOTALL)
(TOML_BLOCK,) = re.findall(r"```toml\n(.*?)```", CONTRIBUTING, re.DOTALL)

# Blocks that begin with this line make up the module of the package; the others are scripts that use it.
MODULE = "# other_package.py\n"
SCRIPTS = [block for block in PYTHON_BLOCKS if not block.startswith(MODULE)]


def install_contributed(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install the package that the examples of CONTRIBUTING.md make up."""
    lines = []
    for group, points in tomllib.loads(TOML_BLOCK)["project"]["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in points.items())]
    module = "".join(block for block in PYTHON_BLOCKS if block.startswith(MODULE))
    install(site, "other_package", {"other_package": module}, "\n".join(lines), monkeypatch)
