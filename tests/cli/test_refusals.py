"""What cannot be done: one clear message, the right exit code, and no file that was not there before."""

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
from pcretrieve.simulation import write_ply


def run(*arguments: str | Path) -> int:
    """Exit code of a command, run in this process with the messages that people read."""
    with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit) as ended:
        patch.setattr(sys, "argv", ["pcretrieve", *map(str, arguments)])
        main()
    return int(ended.value.code or 0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two kept meshes and their catalogue, beside everything that is no catalogue and no scan."""
    place = tmp_path_factory.mktemp("refusals")
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
    (place / "folder.ply").mkdir()
    write_ply(place / "ball.ply", shapes.points_on(shapes.icosphere(3), 500))
    write_ply(place / "few.ply", shapes.points_on(shapes.icosphere(3), 5))
    (place / "nowhere.conf").write_text("bmesh missing.ply 0 0 0 0 0 0 1\nbmesh ball.ply 0 0 0 0 0 0 1\n")
    (place / "two.conf").write_text("bmesh few.ply 0 0 0 0 0 0 1\nbmesh ball.ply 0 0 0 0 0 0 1\n")
    (place / "no.conf").write_text("camera 0 0 0\n")
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
    ("ingest egg.off -c new.sqlite --log-file no/night.log", 1, "cannot write the log file"),
    ("ingest -c good.sqlite", 2, "name at least one scan"),
    ("query egg.off", 2, "Missing option"),
    ("evaluate -c good.sqlite", 1, "give --labels"),
    ("show nobody -c good.sqlite", 1, "holds no shape 'nobody'"),
    ("remove egg nobody -c good.sqlite", 1, "holds no shape 'nobody'"),
    ("report -c good.sqlite -o nowhere/page.html", 1, "nowhere"),
    ("signature", 2, "name at least one scan"),
    ("signature --from-catalogue good.sqlite ogre", 1, "holds no shape 'ogre'; `pcretrieve list` names them"),
    ("signature --from-catalogue good.sqlite --surface keep", 2, "own: leave out --surface"),
    ("reconstruct egg.off -o egg.doc", 1, ".ply .obj .off .stl .glb"),
    ("reconstruct egg.off -o nowhere/egg.ply", 1, "no folder nowhere"),
    ("reconstruct egg.off -o a.ply --suffix .ply", 2, "--suffix is for folders"),
    ("reconstruct *.off -o a.ply", 1, "names 2 scans: name one of them"),
    ("reconstruct . -o meshes", 1, "whose files are read: name another folder with -o"),
    ("inspect . -o pages", 1, "whose files are read: name another folder with -o"),
    ("inspect empty", 2, "name a folder for the pages of the scans"),
    ("inspect nowhere.ply", 1, "there is no file or folder nowhere.ply"),
    ("inspect few.ply -o nowhere/page.html", 1, "there is no folder nowhere"),
    ("inspect few.ply -o folder.ply", 1, "is a folder"),
    ("inspect few.ply --rescans -1", 2, "--rescans"),
    ("inspect few.ply --config nowhere.toml", 2, "nowhere.toml"),
    ("merge -o out.ply", 2, "name at least two views"),
    ("merge ball.ply", 2, "--output"),
    ("merge ball.ply few.ply -o out.ply --sensor behind", 2, "'behind' is not one of"),
    ("merge ball.ply few.ply -o out.obj", 1, "must end in one of .ply .pcd .xyzn"),
    ("merge ball.ply few.ply -o nowhere/out.ply", 1, "there is no folder nowhere"),
    ("merge ball.ply few.ply -o folder.ply/", 1, "is a folder"),
    ("merge ball.ply few.ply -o ball.ply", 1, "is one of the files to be read"),
    ("merge egg.off two.conf -o out.ply", 1, "names all views of its cloud, got 2 files"),
    ("merge no.conf -o out.ply", 1, "no.conf: a .conf file must name its views"),
    ("merge empty -o out.ply", 1, "names no scans"),
)


# What a worker process refuses.
BY_WORKERS = (
    ("signature unknown.toml", 3, "no reader"),
    ("inspect few.ply --png few.ply", 1, "is one of the files to be read"),
    ("inspect few.ply --rescans 1", 2, "at least 2 rescans, got 1"),
    ("merge ball.ply -o out.ply", 1, "at least two views, got 1"),
    ("merge ball.ply few.ply -o out.ply", 1, "view 1 must have more than 16"),
    ("merge nowhere.conf -o out.ply", 1, "missing.ply"),
    ("merge ball.ply egg.off -o out.ply --max-range 3", 1, "view 0 does not say where that is"),
)


@pytest.mark.parametrize("cases", [CASES, pytest.param(BY_WORKERS, marks=pytest.mark.slow)], ids=["", "slow"])
def test_one_message_and_the_right_exit_code(
    cases: tuple[tuple[str, int, str], ...],
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(folder)
    before = sorted(folder.iterdir())
    for arguments, code, words in cases:
        ended = run(*arguments.split())
        said = capsys.readouterr().err
        assert words in said and "Traceback" not in said, (arguments, said)
        assert ended == code, (arguments, said)
        assert sorted(path for path in folder.iterdir() if path.suffix != ".lock") == before, arguments
    # After all of the above, the catalogue still answers.
    assert run("query", folder / "egg.off", "-c", folder / "good.sqlite", "-k", "1") == 0
    assert "egg" in capsys.readouterr().out
