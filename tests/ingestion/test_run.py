"""What ingests say of other ingests, and what is left of them; see also `test_orders`."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import shapes
from benchmarks.simulation import write_ply
from processes import PATIENCE, in_this_process, living, wait_for

import pcretrieve as pr
from pcretrieve.formats import write_mesh

ingest = partial(pr.ingest, executor=in_this_process)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """An egg, twice: a closed mesh, kept as it is, so quickly done."""
    (tmp_path / "eggs").mkdir()
    for name in ("a", "copy"):
        write_mesh(
            shapes.ellipsoid((1, 1, 1.5), subdivisions=3),
            tmp_path / "eggs" / f"{name}.off",
        )
    return tmp_path / "eggs"


def test_an_id_stands_for_its_shape_still_where_the_file_has_another_name(
    folder: Path, tmp_path: Path
) -> None:
    ingest(folder, tmp_path / "c.sqlite")
    (folder / "a.off").rename(folder / "moved.off")
    summary = ingest(
        folder, tmp_path / "c.sqlite", labels={"a": "large", "nobody": "small"}
    )
    assert [(record.id, record.label) for record in summary.held] == [("a", "large")]
    assert summary.unknown_labels == ["nobody"]


def test_a_label_file_that_names_no_scan_is_an_error_before_the_work(
    folder: Path, tmp_path: Path
) -> None:
    (tmp_path / "labels.csv").write_text("file,class\nA.OFF,large\nother.off,small\n")
    with pytest.raises(
        pr.BenchmarkError,
        match=r"its 2 names are not among them, such as 'A\.OFF'; did you mean 'a\.off'",
    ):
        ingest(folder, tmp_path / "c.sqlite", labels=tmp_path / "labels.csv")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["eggs", "labels.csv"]


def test_one_class_for_all_shapes_is_said(
    folder: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_mesh(shapes.ellipsoid((1, 1, 2), subdivisions=3), folder / "b.off")
    ingest(folder, tmp_path / "c.sqlite", labels={"a": "egg", "b": "egg"})
    assert caplog.text.count("all labelled shapes are of one class, egg") == 1
    caplog.clear()
    ingest(folder, tmp_path / "c.sqlite", labels={"a": "egg", "b": "ball"})
    assert "one class" not in caplog.text


def test_a_scan_of_two_runs(
    folder: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    def late(function: Any, items: Any, /, **limits: Any) -> Any:
        ingest(folder / "copy.off", tmp_path / "c.sqlite")
        yield from in_this_process(function, items, **limits)

    ingest(folder / "a.off", tmp_path / "c.sqlite", executor=late)
    assert (
        f"{folder}/a.off and {folder}/copy.off, of another ingest, are the same scan"
        in caplog.messages
    )


def runs_tetwild(pid: int) -> bool:
    try:
        return b"tetwild" in Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False


@pytest.mark.slow
@pytest.mark.skipif(
    not Path("/proc/self/stat").exists(), reason="needs /proc to see other processes"
)
@pytest.mark.parametrize(
    ("send", "code"),
    [
        (
            lambda pid: os.killpg(pid, signal.SIGINT),
            130,
        ),  # Ctrl-C reaches every process of the terminal
        (lambda pid: os.kill(pid, signal.SIGTERM), 143),
        (lambda pid: os.kill(pid, signal.SIGKILL), -signal.SIGKILL),
    ],
    ids=["Ctrl-C", "SIGTERM", "SIGKILL"],
)
def test_no_process_outlives_an_ingest(
    send: Callable[[int], None], code: int, tmp_path: Path
) -> None:
    for number in range(4):
        write_ply(
            tmp_path / f"{number}.ply",
            shapes.points_on(shapes.body(3), 3000, seed=number),
        )
    (tmp_path / "options.toml").write_text("[remesh]\nmethod = 'tetwild'\n")
    command = [
        sys.executable,
        "-m",
        "pcretrieve",
        "ingest",
        tmp_path,
        "-c",
        tmp_path / "c.sqlite",
    ]
    with subprocess.Popen(
        [
            *map(str, command),
            "--workers",
            "2",
            "--config",
            str(tmp_path / "options.toml"),
        ],
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
