"""Names and classes that mean something to a terminal, a shell or a database are printed as text.

That they are text on pages too is tested with the pages.
"""

from __future__ import annotations

import csv
import json
import os
import unicodedata
from pathlib import Path

import shapes
from commands import program, run
from search_server import NASTY

from pcretrieve.formats import write_mesh

# Names of files without their suffix. With the suffix .off, the longest has 255 bytes.
NAMES = (
    *(
        "<script>alert(1)<!--",
        "\"><img src=x onerror='alert(1)'>",
        "<td><style>*{display:none}",
    ),
    *(
        "two\nfailed: [lines",
        "tab\tand\rreturn",
        "\x1b[31mred\x1b]0;title\x07",
        "\x9b31m\x7f",
    ),
    *(
        "reversed\u202egnp.exe",
        "separated\u2028lines",
        "'; DROP TABLE shapes; --",
        "-rf",
        "--help",
    ),
    *(
        "=HYPERLINK(1)",
        "{{7*7}}%s%d\\",
        "cat#1",
        "n" * 251,
        "\u00e4" * 125,
        os.fsdecode(b"latin-\xe9"),
    ),
)
# The ids of the shapes: bytes that are not UTF-8 are escaped.
IDS = [os.fsencode(name).decode("utf-8", "backslashreplace") for name in NAMES]


def test_a_terminal_finds_nothing_to_act_on_and_each_shape_has_one_line(
    tmp_path: Path,
) -> None:
    """Two shapes of each name, the class of which is the id of the first, and one that fails."""
    for start, part in enumerate(("one", "two")):
        (tmp_path / part).mkdir()
        for number, name in enumerate(NAMES):
            egg = shapes.ellipsoid(
                (1, 1 + number / 40, 1.3 + start / 100), subdivisions=2
            )
            write_mesh(egg, tmp_path / part / f"{name}.off")
    (tmp_path / "one" / "flat\x1b[31m\n.xyz").write_text("1 2 3\n" * 200)
    ids = {shape_id + end: shape_id for shape_id in IDS for end in ("", "-2")}
    with (tmp_path / "labels.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([("id", "class"), *ids.items()])
    asked = ("ingest", "one", "two", "-c", "c.sqlite", "--labels", "labels.csv", "--json")
    ingested = program(*asked, cwd=tmp_path, code=3)
    answer = json.loads(ingested.stdout)["result"]
    assert sorted(answer["done"]) == sorted(ids)
    assert [failure["id"] for failure in answer["failed"]] == ["flat\x1b[31m\n"]
    assert answer["unknown_labels"] == []
    listed = program("list", "-c", "c.sqlite", cwd=tmp_path)
    assert len(listed.stdout.splitlines()) == 1 + len(ids) + 1
    failed = program("list", "-c", "c.sqlite", "--failed", cwd=tmp_path)
    (_, line) = failed.stdout.splitlines()
    assert line.startswith("flat\\u001b[31m\\n ")
    for sign in "".join(done.stdout + done.stderr for done in (ingested, listed, failed)):
        assert sign == "\n" or unicodedata.category(sign) not in {"Cc", "Zl", "Zp"}
        assert sign != "\u202e"


def test_meshes_are_written_into_their_folder_alone(eggs: Path, tmp_path: Path) -> None:
    """Also if a catalogue from elsewhere has ids with slashes."""
    assert "/" in NASTY
    run(
        "catalogue", "export", "-c", eggs, "-o", tmp_path / "inside", "--", NASTY, "Egg00"
    )
    written = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.ply")}
    assert written == {f"inside/{NASTY.replace('/', '%2F')}.ply", "inside/Egg00.ply"}
