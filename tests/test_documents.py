"""The documents agree with the code: links have ends, names are in the reference, commands and Python run."""

from __future__ import annotations

import importlib
import re
import shlex
from pathlib import Path

from commands import NAMES, run

import pcretrieve

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
DOCUMENTS = sorted([*ROOT.glob("*.md"), ROOT / "scans" / "README.md", *(ROOT / "docs").rglob("*.md")])
ALL = "".join(path.read_text(encoding="utf-8") for path in DOCUMENTS if path.name != "CHANGELOG.md")


def prose(document: Path) -> str:
    """The text of a document without its blocks of code."""
    return re.sub(r"^```.*?^```$", "", document.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)


def anchors(document: Path) -> set[str]:
    """The anchors that GitHub and Sphinx give to headings."""
    headings = re.findall(r"^#+ (.+)$", prose(document), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_no_link_is_dead() -> None:
    seen = 0
    for document in DOCUMENTS:
        text = re.sub(r"`[^`\n]*`", "", prose(document))
        for link in re.findall(r"\]\(([^)\s]+)\)", text):
            if "://" in link:
                continue
            name, _, anchor = link.partition("#")
            end = document.parent / name if name else document
            assert end.exists(), (document, link)
            assert not anchor or anchor in anchors(end), (document, link)
            seen += 1
    assert seen > 20


def test_every_page_is_in_a_table_of_contents() -> None:
    for index in ("index.md", "reference/index.md"):
        folder = (ROOT / "docs" / index).parent
        text = (ROOT / "docs" / index).read_text("utf-8")
        blocks = re.findall(r"^```\{toctree\}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
        lines = [line for block in blocks for line in block.splitlines() if line and line[0] != ":"]
        named = {(folder / name).resolve() for name in lines}
        pages = {page.with_suffix("") for page in folder.iterdir() if page.suffix in (".md", ".rst")}
        assert pages - {folder / "index"} <= named
        for name in named - {folder / "gallery" / "index"}:  # which sphinx-gallery writes
            assert name.with_suffix(".md").exists() or name.with_suffix(".rst").exists(), name


def test_every_public_name_is_in_the_reference() -> None:
    names = set(pcretrieve.__all__) - {"__version__"}
    for page in (ROOT / "docs" / "reference").glob("*.rst"):
        for module in re.findall(r"^\.\. automodule:: (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE):
            found = importlib.import_module(module)
            names -= set(getattr(found, "__all__", vars(found)))
    assert names == set()


def test_commands_of_the_documents_exist() -> None:
    """Every option that a document shows is one that the command has, and every help has an example."""
    text = re.sub(r"^```.*?^```$", "", ALL, flags=re.MULTILINE | re.DOTALL)
    lines = [
        shlex.split(line, comments=True) for line in re.findall(r"^ {4}(pcretrieve .*)$", text, re.MULTILINE)
    ]
    assert len(lines) > 40
    helps: dict[tuple[str, ...], str] = {}
    for words in lines:
        command = tuple(words[1:3] if words[1] in ("catalogue", "lab") else words[1:2])
        if command not in helps:
            helps[command] = "".join(
                run(*command, flag, code=None).output for flag in ("--help", "--help-all")
            )
        for word in words[2:]:
            if word.startswith("-"):
                assert re.search(rf"(^|[\s,]){re.escape(word)}\b", helps[command]), words
    for name in NAMES:
        assert f"  pcretrieve {name}" in run(*name.split(), "--help").output, name


def test_the_readme_is_short_and_documents_name_every_command_and_script() -> None:
    assert README.count("\n") <= 90
    assert [name for name in NAMES if f"`{name.removeprefix('lab ')}" not in ALL] == []
    scripts = {path.name for path in (ROOT / "scripts").iterdir() if path.is_file()} - {"setup"}
    assert [name for name in sorted(scripts) if f"scripts/{name}" not in ALL] == []
