"""The documents are held together: each link has an end, and each public name is in the reference."""

from __future__ import annotations

import importlib
import inspect
import re
from pathlib import Path

import pytest

import pcretrieve

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted(
    [*ROOT.glob("*.md"), ROOT / "scans" / "README.md", *(ROOT / "docs").rglob("*.md")],
)
REFERENCE = sorted((ROOT / "docs" / "reference").glob("*.rst"))


def prose(document: Path) -> str:
    """The text of a document without its blocks of code."""
    return re.sub(r"^```.*?^```$", "", document.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)


def anchors(document: Path) -> set[str]:
    """The anchors that GitHub and Sphinx give to headings."""
    headings = re.findall(r"^#+ (.+)$", prose(document), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def links(document: Path) -> list[str]:
    """The ends of the links and of the pictures of a document that are in the repository."""
    text = re.sub(r"`[^`\n]*`", "", prose(document))
    return [link for link in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in link]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_link_is_dead(document: Path) -> None:
    for link in links(document):
        name, _, anchor = link.partition("#")
        end = document.parent / name if name else document
        assert end.exists(), link
        if anchor:
            assert anchor in anchors(end), link


def test_there_are_links() -> None:
    assert sum(map(len, map(links, DOCUMENTS))) > 20


def listed(document: Path) -> list[str]:
    """The pages that the tables of contents of a document name."""
    blocks = re.findall(r"^```\{toctree\}\n(.*?)^```$", document.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    return [line for block in blocks for line in block.splitlines() if line and line[0] != ":"]


@pytest.mark.parametrize("index", ["index.md", "reference/index.md"])
def test_every_page_is_in_a_table_of_contents(index: str) -> None:
    """And each page that a table of contents names is there."""
    folder = (ROOT / "docs" / index).parent
    named = {(folder / name).resolve() for name in listed(ROOT / "docs" / index)}
    pages = {page.with_suffix("") for page in folder.iterdir() if page.suffix in (".md", ".rst")}
    assert pages - {folder / "index"} <= named
    for name in named - {folder / "gallery" / "index"}:  # which sphinx-gallery writes
        assert name.with_suffix(".md").exists() or name.with_suffix(".rst").exists(), name


def test_every_public_name_is_in_the_reference() -> None:
    names = set(pcretrieve.__all__) - {"__version__"}
    for page in REFERENCE:
        (module,) = re.findall(r"^\.\. automodule:: (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
        names -= set(importlib.import_module(module).__all__)
    assert names == set()


def test_docstrings_have_no_bars_that_sphinx_takes_for_substitutions() -> None:
    """Absolute values are between double backquotes: ``|x|``."""
    for page in REFERENCE:
        (name,) = re.findall(r"^\.\. automodule:: (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
        module = importlib.import_module(name)
        for member in module.__all__:
            text = re.sub(r"``.*?``", "", inspect.getdoc(getattr(module, member)) or "", flags=re.DOTALL)
            sections = text.split("Parameters\n---", 1)[-1]  # before them, formulas are blocks of their own
            assert not re.search(r"(?<!\w)\|[^\s|](\S| )*?\|", sections), member
