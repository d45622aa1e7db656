"""What cannot be done: one clear message, the right exit code, and no file that was not there before."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import shapes
from benchmarks.simulation import write_ply
from packages import install

import pcretrieve as pr
from pcretrieve.cli.main import main
from pcretrieve.formats import write_mesh

# A reader of .vicious files, which does to its process what the file's name says.
VICIOUS = """
import ctypes, time
import numpy as np

def read(path):
    if path.stem == "crash":
        ctypes.string_at(0)
    return time.sleep(1000) if path.stem == "hang" else np.ones(1 << 29)
"""


def run(*arguments: str | Path) -> int:
    """Exit code of a command, run in this process with the messages that people read."""
    with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit) as ended:
        patch.setattr(sys, "argv", ["pcretrieve", *map(str, arguments)])
        main()
    return int(ended.value.code or 0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Two kept meshes and their catalogue, beside what is no scan and scans that end processes."""
    place = tmp_path_factory.mktemp("refusals")
    write_mesh(shapes.ellipsoid(), place / "egg.off")
    write_mesh(shapes.icosphere(3), place / "ball.off")
    assert (
        run("ingest", place / "egg.off", place / "ball.off", "-c", place / "good.sqlite")
        == 0
    )
    pr.write_matrix(pr.matrix(place / "good.sqlite"), place / "m.txt")
    (place / "value.toml").write_text("[surface]\npoisson_depth = 80\n")
    (place / "empty").mkdir()
    (place / "folder.ply").mkdir()
    write_ply(place / "ball.ply", shapes.points_on(shapes.icosphere(3), 500))
    write_ply(place / "few.ply", shapes.points_on(shapes.icosphere(3), 5))
    (place / "two.conf").write_text(
        "bmesh few.ply 0 0 0 0 0 0 1\nbmesh ball.ply 0 0 0 0 0 0 1\n"
    )
    (place / "no.conf").write_text("camera 0 0 0\n")
    for deed in ("crash", "hang", "fill"):
        (place / f"{deed}.vicious").write_text(deed)
    with pytest.MonkeyPatch.context() as patch:
        reader = "[pcretrieve.readers]\n.vicious = vicious:read\n"
        install(place / "site", "vicious", {"vicious": VICIOUS}, reader, patch)
        yield place


CASES = (
    ("query egg.off -c missing.sqlite", 1, "there is no catalogue"),
    (
        "ingest egg.off -c good.sqlite --surface keep",
        1,
        "surface.mode: 'auto' there, 'keep' here",
    ),
    ("ingest empty -c good.sqlite", 1, "no scans"),
    ("ingest egg.off -c new.sqlite --config value.toml", 2, "poisson_depth"),
    (
        "ingest egg.off -c new.sqlite --log-file no/night.log",
        1,
        "cannot write the log file",
    ),
    ("ingest -c good.sqlite", 2, "name at least one scan"),
    ("query egg.off", 2, "Missing option"),
    ("query good.sqlite egg", 2, "write -c before a catalogue: -c good.sqlite"),
    ("query egg -c good.sqlite -k 80x", 2, "'80x' is not a valid whole number"),
    ("report -c good.sqlite", 2, "Missing option '--output'"),
    (
        "query egg -c good.sqlite --method meshsift",
        2,
        "pr.write_matrix(pr.matrix(CATALOGUE, matcher='meshsift'), FILE)",
    ),
    ("evaluate -c good.sqlite", 1, "give --labels"),
    ("remove egg nobody -c good.sqlite", 1, "holds no shape 'nobody'"),
    (
        "lab signature --from-catalogue good.sqlite --surface keep",
        2,
        "own: leave out --surface",
    ),
    (
        "query egg -c good.sqlite --matrix m.txt --unit mm",
        2,
        "no scan is read: leave out --unit",
    ),
    ("reconstruct egg.off -o egg.doc", 1, ".ply .obj .off .stl .glb"),
    ("reconstruct egg.off -o nowhere/egg.ply", 1, "no folder nowhere"),
    ("reconstruct egg.off -o a.ply --suffix .ply", 2, "--suffix is for folders"),
    ("reconstruct *.off -o a.ply", 1, "names 2 scans: name one of them"),
    (
        "reconstruct . -o meshes",
        1,
        "whose files are read: name another folder with -o",
    ),
    ("inspect empty", 2, "name a folder for the pages of the scans"),
    ("inspect few.ply -o folder.ply", 1, "is a folder"),
    ("merge -o out.ply", 2, "name at least two views"),
    ("merge ball.ply few.ply -o out.obj", 1, "must end in one of .ply .pcd .xyzn"),
    ("merge ball.ply few.ply -o ball.ply", 1, "is one of the files to be read"),
    ("merge egg.off two.conf -o out.ply", 1, "names all views of its cloud, got 2 files"),
    ("merge no.conf -o out.ply", 1, "no.conf: a .conf file must name its views"),
)


# What a worker process refuses, or what ends it.
BY_WORKERS = (
    ("lab signature value.toml", 3, "no reader"),
    ("inspect few.ply --png few.ply", 1, "is one of the files to be read"),
    ("inspect value.toml", 1, "no reader"),
    ("inspect few.ply --rescans 1", 2, "at least 2 rescans, got 1"),
    ("merge ball.ply few.ply -o out.ply", 1, "view 1 must have more than 16"),
    (
        "lab signature crash.vicious",
        3,
        "the process that worked on it ended with SIGSEGV",
    ),
    (
        "query crash.vicious -c good.sqlite",
        1,
        "the process that worked on it ended with SIGSEGV",
    ),
    (
        "query hang.vicious -c good.sqlite --timeout 2",
        1,
        "not finished within 2 s: raise --timeout",
    ),
    (
        "lab signature fill.vicious --memory 1",
        3,
        "than --memory allows: raise that, or thin the scan",
    ),
)


@pytest.mark.parametrize(
    "cases", [CASES, pytest.param(BY_WORKERS, marks=pytest.mark.slow)], ids=["", "slow"]
)
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
        printed, said = capsys.readouterr()
        assert words in said and "Traceback" not in said and not printed, (
            arguments,
            said,
        )
        assert ended == code, (arguments, said)
        assert (
            sorted(path for path in folder.iterdir() if path.suffix != ".lock") == before
        ), arguments
    # After all of the above, the catalogue still answers.
    assert run("query", folder / "egg.off", "-c", folder / "good.sqlite", "-k", "1") == 0
    assert "egg" in capsys.readouterr().out
