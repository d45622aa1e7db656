"""Ingests of new, removed, changed and damaged files: the catalogue has each present content once."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes
from processes import PATIENCE, in_this_process, living, wait_for

import pcretrieve as pr
from pcretrieve import Catalogue, Record
from pcretrieve.formats import write_mesh
from pcretrieve.simulation import write_ply

ingest = partial(pr.ingest, executor=in_this_process)


def egg(path: Path, length: float) -> bytes:
    """A closed mesh, kept as it is, so quickly done; its bytes."""
    write_mesh(shapes.ellipsoid((1, 1, length), subdivisions=3), path)
    return path.read_bytes()


def ids(records: list[Record]) -> list[str]:
    return sorted(record.id for record in records)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two eggs; the first one twice."""
    (tmp_path / "eggs").mkdir()
    egg(tmp_path / "eggs" / "a.off", 1.5)
    egg(tmp_path / "eggs" / "b.off", 2)
    (tmp_path / "eggs" / "copy.off").write_bytes((tmp_path / "eggs" / "a.off").read_bytes())
    return tmp_path / "eggs"


@pytest.fixture
def catalogue(tmp_path: Path) -> Iterator[Catalogue]:
    with Catalogue(tmp_path / "c.sqlite", create=True) as store:
        yield store


@pytest.fixture
def filled(folder: Path, catalogue: Catalogue) -> Catalogue:
    ingest(folder, catalogue, labels={"a": "short", "b": "long"})
    return catalogue


# --- files that stay, change, move ----------------------------------------------------------------------


def test_one_content_is_processed_once(folder: Path, catalogue: Catalogue) -> None:
    whole = (folder / "copy.off").read_bytes()
    (folder / "copy.off").write_bytes(whole[:1000])  # half copied
    assert ids(ingest(folder / "copy.off", catalogue).failed) == ["copy"]
    (folder / "copy.off").write_bytes(whole)
    seen: list[str] = []
    first = ingest(folder, catalogue, on_shape=lambda record: seen.append(record.id))
    assert ids(first.done) == ["a", "b"]
    assert [(Path(path).name, original.id) for path, original in first.duplicates] == [("copy.off", "a")]
    assert ids(catalogue.records()) == ["a", "b"]
    second = ingest(folder, catalogue)
    assert (ids(second.held), second.done, len(second.duplicates)) == (["a", "b"], [], 1)
    assert sorted(seen) == ["a", "a", "b"]  # once for each file


def test_a_file_that_changed_is_processed_again(folder: Path, filled: Catalogue) -> None:
    """A duplicate of the old content of the file is then processed."""
    before = filled.signatures()
    egg(folder / "a.off", 3)
    summary = ingest(folder, filled)
    assert (ids(summary.done), ids(summary.held), summary.duplicates) == (["a", "copy"], ["b"], [])
    after = filled.signatures()
    assert after.ids == ("a", "b", "copy")
    np.testing.assert_array_equal(after.values[2], before.values[0])
    assert not np.allclose(after.values[0], before.values[0])
    assert filled.record("a").label == "short"


def test_a_folder_that_moves_takes_its_shapes_along(folder: Path, filled: Catalogue) -> None:
    before = filled.record("b")
    moved = folder.rename(folder.parent / "nest")
    summary = ingest(moved, filled)
    assert (summary.done, ids(summary.held)) == ([], ["a", "b"])
    after = filled.record("b")
    assert after.path == str(moved / "b.off")
    assert (after.added, after.label) == (before.added, "long")


def test_labels_reach_shapes_that_are_held_already(folder: Path, filled: Catalogue) -> None:
    summary = ingest(folder, filled, labels={"a.off": "small", "nobody": "small"})
    assert [record.label for record in filled.records()] == ["small", "long"]
    assert summary.unknown_labels == ["nobody"]
    # An id stands for its shape still where the file has another name by now.
    (folder / "b.off").rename(folder / "c.off")
    summary = ingest(folder, filled, labels={"b": "large", "nobody": "small"})
    assert filled.record("b").label == "large"
    assert summary.unknown_labels == ["nobody"]


def test_a_file_out_of_reach_keeps_what_was_made_of_it(folder: Path, filled: Catalogue) -> None:
    """Its copy stays a copy, and the next run that reaches the file finds all as it was."""
    before, signatures = filled.records(), filled.signatures().values
    content = (folder / "a.off").read_bytes()
    (folder / "a.off").unlink()
    (folder / "a.off").symlink_to("away")
    (folder / "b.off").write_bytes((folder / "b.off").read_bytes()[:1000])  # half copied
    summary = ingest(folder, filled)
    assert ids(summary.failed) == ["a", "b"]
    for record in summary.failed:
        assert "; the catalogue keeps what was made of this file on" in str(record.message)
    assert [Path(path).name for path, _ in summary.duplicates] == ["copy.off"]
    assert filled.records() == before
    np.testing.assert_array_equal(filled.signatures().values, signatures)
    (folder / "a.off").unlink()
    (folder / "a.off").write_bytes(content)
    assert ids(ingest(folder, filled).held) == ["a"]


# --- several ingests at once ----------------------------------------------------------------------------


def test_a_scan_of_two_runs(folder: Path, catalogue: Catalogue, caplog: pytest.LogCaptureFixture) -> None:
    def late(function: Any, items: Any, /, **limits: Any) -> Any:
        ingest(folder / "copy.off", catalogue)
        yield from in_this_process(function, items, **limits)

    ingest(folder / "a.off", catalogue, executor=late)
    assert f"{folder}/a.off and {folder}/copy.off, of another ingest, are the same scan" in caplog.messages


@pytest.mark.slow
@pytest.mark.parametrize("same", [False, True], ids=["other files of the same names", "the same files"])
def test_two_processes_that_ingest_at_once_store_every_shape_once(
    same: bool, new_location: str, tmp_path: Path
) -> None:
    folders = [tmp_path / name for name in ("one", "two")]
    for start, folder in enumerate(folders):
        folder.mkdir()
        for number in range(4):
            egg(folder / f"{number}.off", 1 + (start + 2 * number) / 8)
    command = [sys.executable, "-m", "pcretrieve", "ingest", "-c", new_location, "--workers", "1", "--json"]
    given = [folders[0], folders[0 if same else 1]]
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    running = [subprocess.Popen([*command, str(folder)], **pipes) for folder in given]
    for process in running:
        said, errors = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, errors.decode()
        answer = json.loads(said)["result"]
        assert len(answer["done"]) + len(answer["held"]) == 4
    with Catalogue(new_location) as catalogue:
        records = catalogue.records()
        assert len(catalogue.signatures().ids) == len(records)
    expected = {str(folder / f"{number}.off") for folder in given for number in range(4)}
    assert sorted(record.path for record in records) == sorted(expected)


# --- processes ------------------------------------------------------------------------------------------


def runs_tetwild(pid: int) -> bool:
    try:
        return b"tetwild" in Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc to see other processes")
@pytest.mark.parametrize(
    ("send", "code"),
    [
        (lambda pid: os.killpg(pid, signal.SIGINT), 130),  # Ctrl-C reaches every process of the terminal
        (lambda pid: os.kill(pid, signal.SIGTERM), 143),
        (lambda pid: os.kill(pid, signal.SIGKILL), -signal.SIGKILL),
    ],
    ids=["Ctrl-C", "SIGTERM", "SIGKILL"],
)
def test_no_process_outlives_an_ingest(send: Callable[[int], None], code: int, tmp_path: Path) -> None:
    for number in range(4):
        write_ply(tmp_path / f"{number}.ply", shapes.points_on(shapes.body(3), 3000, seed=number))
    (tmp_path / "options.toml").write_text("[remesh]\nmethod = 'tetwild'\n")
    command = [sys.executable, "-m", "pcretrieve", "ingest", tmp_path, "-c", tmp_path / "c.sqlite"]
    with subprocess.Popen(
        [*map(str, command), "--workers", "2", "--config", str(tmp_path / "options.toml")],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as running:
        assert wait_for(lambda: any(runs_tetwild(pid) for pid in living(running.pid)))
        send(running.pid)
        _, said = running.communicate(timeout=PATIENCE)
    assert running.returncode == code
    # A worker that is still starting may find the pool gone, and say so from within multiprocessing.
    assert "pcretrieve/" not in said.replace(str(tmp_path), "")
    if code > 0:
        assert "the same command goes on from there" in said
    assert wait_for(lambda: not living(running.pid))
