"""The licences of all dependencies are as permissive as the MIT licence of pcretrieve, and on one page."""

from __future__ import annotations

import re
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest
from licences import PROJECT, groups, kind, licence, page, required

PAGE = Path(__file__).parents[1] / "docs" / "licences.md"


def test_no_dependency_has_a_stricter_licence() -> None:
    packages = required(PROJECT["dependencies"])
    assert {"numpy", "open3d", "pyvista"} <= packages.keys()  # with the extra of pytetwild, too
    kinds = {name: kind(licence(package)) for name, package in packages.items()}
    assert {name: found for name, found in kinds.items() if found in ("copyleft", "unknown")} == {}


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("GNU General Public License v3 or later (GPLv3+)", "copyleft"),
        ("AGPL-3.0-only", "copyleft"),
        ("GPL-2.0-or-later", "copyleft"),
        ("GNU AFFERO GENERAL PUBLIC LICENSE", "copyleft"),
        ("MPL-2.0 AND GPL-2.0-only", "copyleft"),
        ("LGPL-2.1-or-later", "weak copyleft"),
        ("GNU Library or Lesser General Public License (LGPL)", "weak copyleft"),
        ("GNU Lesser General Public License v3 (LGPLv3)", "weak copyleft"),
        ("MPL-2.0 AND MIT", "weak copyleft"),
        ("MIT-CMU", "permissive"),
        ("3-Clause BSD License", "permissive"),
        ("Apache-2.0 WITH LLVM-exception", "permissive"),
        ("Other/Proprietary License", "unknown"),
        ("", "unknown"),
    ],
)
def test_licences_are_distinguished(words: str, found: str) -> None:
    assert kind(words) == found


def test_the_page_has_every_package_that_a_user_installs() -> None:
    """With the extras, all of which must be installed."""
    try:
        packages = {name: package for group in groups().values() for name, package in group.items()}
    except PackageNotFoundError as error:
        pytest.skip(f"not all extras are installed: {error}")
    rows = re.findall(
        r"^\| ([\w.-]+) \| (.*) \| ([a-z ]+) \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE
    )
    stated = {name: found for name, _, found in rows}
    missing = {name: kind(licence(package)) for name, package in packages.items()}.items() - stated.items()
    assert sorted(missing) == [], "run scripts/licences"
    assert not {"copyleft", "unknown"} & set(stated.values())
    assert all(kind(words) == found for _, words, found in rows)
    assert page().startswith("# Licences\n")
