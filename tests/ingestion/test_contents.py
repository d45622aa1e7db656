"""Hashes of files, some of which cannot be read in time."""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import shapes
from scene_files import write_gltf

from pcretrieve import Catalogue, ingest
from pcretrieve.errors import StageTimeout
from pcretrieve.formats import write_mesh
from pcretrieve.ingestion.discover import content_hash, discover
from pcretrieve.ingestion.plan import Contents


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for number in range(4):
        write_mesh(shapes.ellipsoid((1, 1, 1.5 + number), subdivisions=3), tmp_path / f"{number}.off")
    return tmp_path


@pytest.fixture
def hanging(folder: Path) -> Iterator[list[Path]]:
    """Block the first two files: other processes cannot open them while this process has a lease."""
    paths = [folder / "0.off", folder / "1.off"]
    held = [os.open(path, os.O_RDWR) for path in paths]
    try:
        for file in held:
            # Another process that opens the file is announced by a signal, whose default ends this process.
            fcntl.fcntl(file, fcntl.F_SETSIG, signal.SIGURG)
            fcntl.fcntl(file, fcntl.F_SETLEASE, fcntl.F_WRLCK)
    except OSError as error:
        pytest.skip(f"the file system has no leases: {error}")
    yield paths
    for file in held:
        os.close(file)


def test_contents_are_those_of_the_files(folder: Path) -> None:
    files = {path.name: path for path in sorted(folder.iterdir())}
    contents = Contents(files, 2, 60)
    contents.expect(["3.off", "0.off"])
    assert {name: contents.of(name) for name in files} == {
        name: content_hash(path) for name, path in files.items()
    }


def test_a_file_of_several_scans_is_read_once(tmp_path: Path) -> None:
    """Its second scan is hashed after the file is gone."""
    file = tmp_path / "two.gltf"
    write_gltf(file, shapes.icosphere(1), [{"mesh": 0}, {"mesh": 0, "translation": [5, 0, 0]}])
    scans = {path.name: path for path in discover([tmp_path])}
    expected = {name: content_hash(path) for name, path in scans.items()}
    contents = Contents(scans, 1, 60)
    first, second = scans
    assert contents.of(first) == expected[first]
    file.unlink()
    assert contents.of(second) == expected[second] != expected[first]


def test_a_file_that_cannot_be_read_holds_up_no_other(folder: Path, hanging: list[Path]) -> None:
    """Though it is asked for last, and every thread hangs."""
    files = {path.name: path for path in sorted(folder.iterdir())}
    contents = Contents(files, 1, 1)
    contents.expect(files)
    assert contents.of("3.off") == content_hash(files["3.off"])
    for path in hanging:
        late = contents.of(path.name)
        assert isinstance(late, StageTimeout)
        assert str(late) == f"[read] {path} was not read within 1 s: raise --timeout"


def test_a_file_that_cannot_be_read_is_a_failed_row(folder: Path, hanging: list[Path]) -> None:
    with Catalogue(folder / "c.sqlite", create=True) as catalogue:
        summary = ingest(discover([folder]), catalogue, timeout=10)
        assert sorted(record.id for record in summary.done) == ["2", "3"]
        assert [(record.id, record.error, record.stage) for record in summary.failed] == [
            (path.stem, "StageTimeout", "read") for path in hanging
        ]


@pytest.mark.usefixtures("hanging")
def test_a_file_that_cannot_be_read_does_not_keep_the_program_from_ending(folder: Path) -> None:
    script = (
        "from pathlib import Path; from pcretrieve.ingestion.plan import Contents; "
        f"print(Contents({{'x': Path({str(folder / '0.off')!r})}}, 1, 1).of('x'))"
    )
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=20)
    assert ended.stdout == f"[read] {folder / '0.off'} was not read within 1 s: raise --timeout\n"
