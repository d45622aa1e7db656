"""The licences of what pcretrieve depends on, as installed packages state them."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable
from importlib.metadata import Distribution, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]

# Extras that no user needs.
FOR_DEVELOPERS = ("benchmark", "docs", "dev")

# Licences that leave a program free which imports the library; files of the library itself stay under them.
WEAK = re.compile(
    r"\bLGPL[\w.+-]*|GNU (Library or )?Lesser General Public[\w ]*|\bMPL[\w.-]*|"
    r"Mozilla Public License[\w. ]*",
    re.IGNORECASE,
)
# Copyleft licences that apply to programs that are distributed with the library.
STRONG = re.compile(r"\bA?GPL|GNU (Affero )?General Public", re.IGNORECASE)
PERMISSIVE = re.compile(r"\b(MIT|0?BSD|Apache|ISC|PSF|Python Software Foundation|Zlib|CC0)\b", re.IGNORECASE)

HEAD = """# Licences

`scripts/licences` writes this page from what the packages say that are installed on Linux with all extras.
Packages that are not needed to run pcretrieve are left out: those of the extras {left_out}.
pcretrieve itself has the MIT licence.

- *permissive*: the package may be used in and distributed with any program, with its notice.
- *weak copyleft* (MPL, LGPL): the same; but who distributes a changed version of the package itself must
  publish the changes, and users must be able to replace an LGPL library by another version, as they can with
  packages of Python.
- *copyleft* (GPL, AGPL): a program that is distributed with the package must have its licence. No package
  that is listed here has one, which a test checks.

Wheels contain further libraries, whose licences are in the packages. This page is no legal advice.
"""


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
        name = canonicalize_name(needed.name)
        for own in ("", *needed.extras):
            if (name, own) not in seen:
                seen.add((name, own))
                found[name] = distribution(name)
                waiting += [(further, own) for further in found[name].requires or ()]
    return found


def licence(package: Distribution) -> str:
    """What a package says of its licence: an expression, or classifiers, or the first line of a text."""
    said = {
        field: package.metadata.get_all(field, [])
        for field in ("License-Expression", "Classifier", "License")
    }
    classifiers = [line.split(" :: ")[-1] for line in said["Classifier"] if line.startswith("License ::")]
    text = [line for text in said["License"] for line in text.strip().splitlines()[:1]]
    return "; ".join(said["License-Expression"] or classifiers or text)


def kind(words: str) -> str:
    """Permissive, weak copyleft, copyleft, or unknown."""
    if STRONG.search(WEAK.sub("", words)):
        return "copyleft"
    if WEAK.search(words):
        return "weak copyleft"
    return "permissive" if PERMISSIVE.search(words) else "unknown"


def groups() -> dict[str, dict[str, Distribution]]:
    """The packages that each extra adds to those of no extra, which have the name ''."""
    base = required(PROJECT["dependencies"])
    found = {"": base}
    for extra, requirements in PROJECT["optional-dependencies"].items():
        if extra not in FOR_DEVELOPERS:
            needed = required(requirements)
            found[extra] = {name: package for name, package in needed.items() if name not in base}
    return found


def page() -> str:
    """The page of all licences, in Markdown."""
    lines = [HEAD.format(left_out=", ".join(f"`{name}`" for name in FOR_DEVELOPERS))]
    for extra, packages in groups().items():
        if packages:
            lines += ["", f"## Extra `{extra}`" if extra else "## Always installed", ""]
            lines += ["| Package | Licence | |", "|---|---|---|"]
        for name in sorted(packages):
            words = licence(packages[name])
            lines.append(f"| {name} | {words} | {kind(words)} |")
    return "\n".join(lines).replace("\n\n\n", "\n\n") + "\n"


if __name__ == "__main__":
    sys.stdout.write(page())
