"""Hashes of files, some of which cannot be read in time."""

from __future__ import annotations

import fcntl
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
import shapes

from pcretrieve.errors import StageTimeout
from pcretrieve.formats import write_mesh
from pcretrieve.ingestion.discover import content_hash
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
