"""Catalogues, options and paths that cannot be used: one clear message and the right exit code."""

from __future__ import annotations

import shutil
import sqlite3
import sys
from contextlib import closing
from pathlib import Path

import pytest
import shapes

from pcretrieve.cli.main import main
from pcretrieve.formats import write_mesh


def run(*arguments: str | Path) -> int:
    """Exit code of a command, run in this process."""
    with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit) as ended:
        patch.setattr(sys, "argv", ["pcretrieve", *map(str, arguments)])
        main()
    return int(ended.value.code or 0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two kept meshes and their catalogue, beside everything that is no catalogue."""
    place = tmp_path_factory.mktemp("catalogues")
    write_mesh(shapes.ellipsoid(), place / "egg.off")
    write_mesh(shapes.icosphere(3), place / "ball.off")
    assert run("ingest", place / "egg.off", place / "ball.off", "-c", place / "good.sqlite") == 0
    (place / "text.sqlite").write_text("no catalogue\n" * 100)
    with closing(sqlite3.connect(place / "other.sqlite")) as other, other:
        other.execute("CREATE TABLE cats (name TEXT)")
    shutil.copy(place / "good.sqlite", place / "newer.sqlite")
    with closing(sqlite3.connect(place / "newer.sqlite")) as newer, newer:
        newer.execute("UPDATE meta SET value = '99' WHERE key = 'schema_version'")
    (place / "unknown.toml").write_text("[surface]\npoisson_deep = 8\n")
    (place / "value.toml").write_text("[surface]\npoisson_depth = 80\n")
    (place / "other.toml").write_text("[surface]\npoisson_depth = 8\n")
    (place / "broken.toml").write_text("[surface\n")
    (place / "empty").mkdir()
    return place


CASES = (
    ("query egg.off -c .", 1, "is a folder"),
    ("query egg.off -c missing.sqlite", 1, "there is no catalogue"),
    ("query egg.off -c text.sqlite", 1, "not a catalogue"),
    ("query egg.off -c other.sqlite", 1, "no catalogue"),
    ("query egg.off -c newer.sqlite", 1, "newer pcretrieve"),
    ("ingest egg.off -c newer.sqlite", 1, "newer pcretrieve"),
    ("ingest egg.off -c good.sqlite --config other.toml", 1, "surface.poisson_depth: 7 there, 8 here"),
    ("ingest egg.off -c good.sqlite --surface keep", 1, "surface.mode: 'auto' there, 'keep' here"),
    ("ingest nowhere -c good.sqlite", 1, "there is no file or folder"),
    ("ingest empty -c good.sqlite", 1, "no scans"),
    ("ingest *.nothing -c good.sqlite", 1, "names no scans"),
    ("ingest egg.off -c new.sqlite --config unknown.toml", 2, "poisson_deep"),
    ("ingest egg.off -c new.sqlite --config value.toml", 2, "poisson_depth"),
    ("ingest egg.off -c new.sqlite --config broken.toml", 2, "not valid TOML"),
    ("ingest egg.off -c new.sqlite --config nowhere.toml", 2, "cannot read"),
    ("ingest -c good.sqlite", 2, "name at least one scan"),
    ("query egg.off", 2, "Missing option"),
    ("evaluate -c good.sqlite", 1, "give --labels"),
    ("show nobody -c good.sqlite", 1, "holds no shape 'nobody'"),
    ("remove egg nobody -c good.sqlite", 1, "holds no shape 'nobody'"),
    ("reconstruct egg.off -o egg.doc", 1, ".ply .obj .off .stl .glb"),
    ("reconstruct egg.off -o nowhere/egg.ply", 1, "no folder nowhere"),
    ("report -c good.sqlite -o nowhere/page.html", 1, "nowhere"),
    ("signature unknown.toml", 3, "no reader"),
)


def test_one_message_and_the_right_exit_code(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    for arguments, code, words in CASES:
        ended = run(*arguments.split())
        said = capsys.readouterr().err
        assert words in said, arguments
        assert ended == code, (arguments, said)
    # After all of the above, the catalogue still answers.
    assert run("query", folder / "egg.off", "-c", folder / "good.sqlite", "-k", "1") == 0
    assert "egg" in capsys.readouterr().out
