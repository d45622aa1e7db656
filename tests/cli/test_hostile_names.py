"""Names and classes that mean something to a page, a terminal, a shell or a database are printed as text."""

from __future__ import annotations

import csv
import json
import os
import sqlite3
import subprocess
import sys
import unicodedata
from contextlib import closing
from html.parser import HTMLParser
from pathlib import Path

import commands
import pytest
import shapes

from pcretrieve.catalogue.records import checksum
from pcretrieve.formats import write_mesh

# Names of files without their suffix. With the suffix .off, the longest has 255 bytes.
NAMES = (
    *("<script>alert(1)<!--", "\"><img src=x onerror='alert(1)'>", "<td><style>*{display:none}"),
    *("two\nfailed: [lines", "tab\tand\rreturn", "\x1b[31mred\x1b]0;title\x07", "\x9b31m\x7f"),
    *("reversed\u202egnp.exe", "separated\u2028lines", "'; DROP TABLE shapes; --", "-rf", "--help"),
    *("=HYPERLINK(1)", "{{7*7}}%s%d\\", "cat#1", "n" * 251, "\u00e4" * 125, os.fsdecode(b"latin-\xe9")),
)
# The ids of the shapes: bytes that are not UTF-8 are escaped.
IDS = {name: os.fsencode(name).decode("utf-8", "backslashreplace") for name in NAMES}


def run(folder: Path, *arguments: str | Path, code: int = 0) -> str:
    """What a command prints, in which a terminal finds nothing to act on."""
    command = [sys.executable, "-m", "pcretrieve", *map(str, arguments)]
    done = subprocess.run(command, cwd=folder, capture_output=True, check=False, timeout=300)
    assert done.returncode == code, done.stderr.decode(errors="replace")
    printed, said = done.stdout.decode(), done.stderr.decode()
    if "--csv" not in arguments:
        for sign in printed + said:
            signature = arguments[0] == "signature" and sign == "\t"
            assert sign == "\n" or signature or unicodedata.category(sign) not in {"Cc", "Zl", "Zp"}, said
            assert sign != "\u202e"
    assert "Traceback" not in said
    return printed


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A catalogue with two shapes of each name, the class of which is the id of the first."""
    place = tmp_path_factory.mktemp("hostile")
    for start, part in enumerate(("one", "two")):
        (place / part).mkdir()
        for number, name in enumerate(NAMES):
            egg = shapes.ellipsoid((1, 1 + number / 40, 1.3 + start / 100), subdivisions=2)
            write_mesh(egg, place / part / f"{name}.off")
    (place / "one" / "flat\x1b[31m\n.xyz").write_text("1 2 3\n" * 200)
    with (place / "labels.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["id", "class"])
        writer.writerows((shape_id + end, shape_id) for shape_id in IDS.values() for end in ("", "-2"))
    command = ("ingest", "one", "two", "-c", "c.sqlite", "--labels", "labels.csv", "--json")
    answer = json.loads(run(place, *command, code=3))["result"]
    assert sorted(answer["done"]) == sorted(ids())
    assert [failure["id"] for failure in answer["failed"]] == ["flat\x1b[31m\n"]
    assert answer["unknown_labels"] == []
    with (
        closing(sqlite3.connect(place / "c.sqlite")) as whole,
        closing(sqlite3.connect(place / "tame.sqlite")) as tame,
    ):
        whole.backup(tame)
        tame.execute("UPDATE shapes SET id = 'tame' || number, path = '/tame' || number || '.off'")
        tame.execute("UPDATE shapes SET label = 'class ' || length(label) WHERE label IS NOT NULL")
        tame.execute("UPDATE shapes SET message = 'no body' WHERE status = 'failed'")
        seal(tame)
    return place


def seal(catalogue: sqlite3.Connection) -> None:
    """Write the checksums of changed rows, as who changes rows on purpose would, and commit."""
    catalogue.row_factory = sqlite3.Row
    for row in catalogue.execute("SELECT * FROM shapes JOIN provenance ON shape = number").fetchall():
        values = (checksum(dict(row)), row["number"])
        catalogue.execute("UPDATE shapes SET checksum = ? WHERE number = ?", values)
    catalogue.commit()


def ids() -> list[str]:
    return [shape_id + end for shape_id in IDS.values() for end in ("", "-2")]


def test_a_list_has_one_line_for_each_shape(folder: Path) -> None:
    assert len(run(folder, "list", "-c", "c.sqlite").splitlines()) == 1 + len(ids()) + 1
    (_, line) = run(folder, "list", "-c", "c.sqlite", "--failed").splitlines()
    assert line.startswith("flat\\u001b[31m\\n ")


class Page(HTMLParser):
    """The elements of a page with their attributes, and its text."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.elements: set[str] = set()
        self.attributes: set[str] = set()
        self.text = ""
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.add(tag)
        self.attributes.update(name for name, _ in attrs)
        self.text += " ".join(value or "" for _, value in attrs)

    def handle_data(self, data: str) -> None:
        self.text += data


def test_a_page_has_no_element_that_a_name_made(folder: Path) -> None:
    for command in ("report", "map"):
        pages = []
        for catalogue in ("tame.sqlite", "c.sqlite"):
            page = folder / f"{command}-{catalogue}.html"
            commands.run(command, "-c", folder / catalogue, "--whitening", "none", "-o", page)
            pages.append(Page(page))
        expected, found = pages
        assert found.elements <= expected.elements
        assert found.attributes <= expected.attributes
        text = " ".join(found.text.split())
        assert all(name in text for name in NAMES[:3])


def test_meshes_are_written_into_their_folder_alone(folder: Path) -> None:
    """Also if a catalogue from elsewhere has ids with slashes."""
    source, copy = (folder / name for name in ("c.sqlite", "copy.sqlite"))
    with closing(sqlite3.connect(source)) as whole, closing(sqlite3.connect(copy)) as other:
        whole.backup(other)
        other.execute("UPDATE shapes SET id = '../../outside' WHERE id = '-rf'")
        other.execute("UPDATE shapes SET id = '/absolute/outside' WHERE id = '--help'")
        seal(other)
    before = sorted(folder.rglob("*outside*"))
    printed = run(
        folder, "export", "-c", copy, "-o", "meshes/inside", "--", "../../outside", "/absolute/outside"
    )
    assert printed.splitlines() == [
        "meshes/inside/..%2F..%2Foutside.ply",
        "meshes/inside/%2Fabsolute%2Foutside.ply",
    ]
    written = sorted(path for path in folder.rglob("*outside*") if path not in before)
    assert {path.parent for path in written} == {folder / "meshes" / "inside"}
