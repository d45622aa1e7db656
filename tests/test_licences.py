"""The licences of all hard dependencies are as permissive as the MIT licence of pcretrieve."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable
from importlib.metadata import Distribution, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PROJECT = Path(__file__).parents[1] / "pyproject.toml"

# Copyleft licences that apply to programs that are distributed with the library.
STRONG = re.compile(r"\bA?GPL|GNU (Affero )?General Public", re.IGNORECASE)
# The lesser licence leaves a program free that imports the library.
LESSER = re.compile(r"\bLGPL[\w.+-]*|GNU (Library or )?Lesser General Public[\w ]*", re.IGNORECASE)


def required(requirements: Iterable[str]) -> dict[str, Distribution]:
    """What pip installs for these requirements, by name."""
    found: dict[str, Distribution] = {}
    waiting = [(text, "") for text in requirements]
    seen = set()
    while waiting:
        text, extra = waiting.pop()
        needed = Requirement(text)
        if needed.marker is not None and not needed.marker.evaluate({"extra": extra}):
            continue
        for own in ("", *needed.extras):
            if (needed.name, own) not in seen:
                seen.add((needed.name, own))
                found[needed.name] = distribution(needed.name)
                waiting += [(further, own) for further in found[needed.name].requires or ()]
    return found


def licence(package: Distribution) -> str:
    """What a package says of its licence: an expression, or classifiers and the first line of a text."""
    said = {
        field: package.metadata.get_all(field, [])
        for field in ("License-Expression", "Classifier", "License")
    }
    classifiers = [line for line in said["Classifier"] if line.startswith("License ::")]
    text = [line for text in said["License"] for line in text.strip().splitlines()[:1]]
    return "; ".join(said["License-Expression"] or [*classifiers, *text])


def is_strong(words: str) -> bool:
    return STRONG.search(LESSER.sub("", words)) is not None


def test_no_dependency_has_a_stricter_licence() -> None:
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    packages = required(project["dependencies"])
    assert {"numpy", "open3d", "pyvista"} <= packages.keys()  # with the extra of pytetwild, too
    licences = {name: licence(package) for name, package in packages.items()}
    assert [name for name, words in licences.items() if not words] == []
    assert {name: words for name, words in licences.items() if is_strong(words)} == {}


@pytest.mark.parametrize(
    ("words", "strong"),
    [
        ("License :: OSI Approved :: GNU General Public License v3 or later (GPLv3+)", True),
        ("AGPL-3.0-only", True),
        ("GPL-2.0-or-later", True),
        ("GNU AFFERO GENERAL PUBLIC LICENSE", True),
        ("LGPL-2.1-or-later", False),
        ("License :: OSI Approved :: GNU Library or Lesser General Public License (LGPL)", False),
        ("GNU Lesser General Public License v3 (LGPLv3)", False),
        ("MPL-2.0 AND MIT", False),
    ],
)
def test_licences_are_distinguished(words: str, strong: bool) -> None:
    assert is_strong(words) == strong
