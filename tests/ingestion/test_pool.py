"""Functions in worker processes: each item has one outcome, whatever happens to its process."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes
from processes import PATIENCE, living, wait_for

from pcretrieve.errors import (
    InputError,
    MemoryExceeded,
    PcretrieveError,
    Stage,
    UnexpectedError,
    WorkerDied,
    in_stage,
)
from pcretrieve.formats import write_mesh
from pcretrieve.ingestion import pool

HERE = str(Path(__file__).parent)
HALF_THE_MEMORY = 1 << 29  # bytes, of 1 GiB
hoard: list[object] = []  # what a worker never gives back


def own_process(item: int) -> tuple[int, int]:
    return item, os.getpid()


own_process.prepare = lambda: logging.getLogger("pcretrieve").warning("ready soon")  # type: ignore[attr-defined]


def keep_half_the_memory(item: int) -> int:
    hoard.append(np.ones(HALF_THE_MEMORY * 3 // 4, dtype=np.uint8))
    return item


def half_way(item: int) -> int:
    pool.tell(("half", item))
    return 2 * item


def unready(item: int) -> int:
    return item


unready.prepare = lambda: 1 / 0  # type: ignore[attr-defined]


class Odd(InputError):
    """An exception of a plug-in, with arguments of its own."""

    def __init__(self, first: int, second: int) -> None:
        super().__init__(f"{first} and {second}", stage=Stage.CLEAN)

    def __reduce__(self) -> tuple[type[Odd], tuple[int, int]]:
        return Odd, (1, 2)


class Explosive:
    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        return divmod, (1, 0)


RAISED: dict[str, tuple[BaseException, type[PcretrieveError], Stage]] = {
    "exit": (SystemExit(0), UnexpectedError, Stage.SPECTRUM),
    "interrupt": (KeyboardInterrupt(), UnexpectedError, Stage.SPECTRUM),
    "fault": (KeyError("x"), UnexpectedError, Stage.SPECTRUM),
    "memory": (MemoryError(), MemoryExceeded, Stage.SPECTRUM),
    "odd": (Odd(1, 2), InputError, Stage.CLEAN),
}


def do(what: str) -> object:
    """Answer by the name of an item: raise, or give what cannot be sent, or not be received, or None."""
    if what in RAISED:
        with in_stage(Stage.SPECTRUM):
            raise RAISED[what][0]
    if what == "none":
        return None
    return threading.Lock() if what == "lock" else Explosive()


def test_what_a_function_tells_arrives_before_its_answer() -> None:
    heard: list[object] = []
    for number, (item, outcome) in enumerate(
        pool.in_processes(half_way, [3, 4], workers=1, told=heard.append), 1
    ):
        assert outcome == 2 * item
        assert len(heard) >= number
    assert heard == [("half", 3), ("half", 4)]
    # Nobody has to listen, and the parent process has nobody to tell.
    assert [outcome for _, outcome in pool.in_processes(half_way, [5], workers=1)] == [10]
    assert half_way(6) == 12


def test_every_item_has_its_outcome_and_no_process_is_left(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Workers are as many as there are items, and items are read as they are needed."""
    started, start = [], pool.Worker

    def counted(*given: Any) -> Any:
        started.append(start(*given))
        return started[-1]

    monkeypatch.setattr(pool, "Worker", counted)
    assert (
        len(list(pool.in_processes(own_process, range(2), workers=8, timeout=PATIENCE)))
        == 2
    )
    assert len(started) == 2
    assert caplog.messages.count("ready soon") == 1
    items = iter(range(1000))
    running = pool.in_processes(own_process, items, workers=2)
    for _ in range(6):
        item, outcome = next(running)
        assert isinstance(outcome, tuple) and outcome[0] == item
    assert next(items) < 12
    running.close()
    assert wait_for(lambda: not multiprocessing.active_children())


def test_every_exception_and_every_bad_answer_is_the_outcome_of_its_item() -> None:
    found: dict[str, Any] = dict(
        pool.in_processes(do, [*RAISED, "lock", "none", "explosive"], workers=1)
    )
    assert found["none"] is None
    for name, (_, kind, stage) in RAISED.items():
        outcome = found[name]
        assert (type(outcome), outcome.stage) == (kind, stage), name
    for name in ("lock", "explosive"):
        assert "a fault of pcretrieve, or of a package that it uses" in str(found[name])


@pytest.mark.slow
def test_what_lacks_memory_in_a_used_worker_is_tried_in_a_fresh_one() -> None:
    assert dict(
        pool.in_processes(keep_half_the_memory, range(3), workers=1, memory=1)
    ) == {
        0: 0,
        1: 1,
        2: 2,
    }
    with pytest.raises(
        PcretrieveError,
        match=r"could take a shape.* the last one printed: ZeroDivisionError",
    ):
        list(pool.in_processes(unready, [0]))


def die(place: Path) -> None:
    (place / str(os.getpid())).touch()
    os._exit(7)


def test_an_item_whose_process_ends_is_tried_twice(tmp_path: Path) -> None:
    ((_, outcome),) = pool.in_processes(die, [tmp_path], workers=1)
    assert isinstance(outcome, WorkerDied) and "ended with exit code 7" in str(outcome)
    assert len([*tmp_path.iterdir()]) == 2


# A main process with two workers: one computes without an end, the other waits for its next item.
MAIN = """
import os, sys
from pathlib import Path
from test_pool import compute
from pcretrieve.ingestion import pool

if __name__ == "__main__":
    items = iter(["done", "without an end", "without an end"])
    running = pool.in_processes(compute, [Path(sys.argv[1], name) for name in items], workers=2)
    print(next(running), flush=True)
    next(running)
"""


def compute(place: Path) -> None:
    """Note the process, and compute without an end in code that looks at no pipe."""
    (place.parent / f"{os.getpid()}").touch()
    if place.name != "done":
        while True:
            pass


@pytest.mark.skipif(sys.platform != "linux", reason="Linux ends workers that compute")
def test_workers_that_compute_end_with_a_killed_main_process(tmp_path: Path) -> None:
    known = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, [*sys.path, HERE]))}
    (tmp_path / "noted").mkdir()
    (tmp_path / "main.py").write_text(MAIN)
    with subprocess.Popen(
        [sys.executable, tmp_path / "main.py", tmp_path / "noted"],
        env=known,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    ) as main:
        assert main.stdout is not None and main.stdout.readline()
        assert wait_for(lambda: len([*(tmp_path / "noted").iterdir()]) == 2)
        workers = {int(path.name) for path in (tmp_path / "noted").iterdir()}
        assert workers <= {*living(main.pid)}
        main.kill()
    try:
        assert wait_for(lambda: not workers & {*living(main.pid)}, 5)
    finally:
        for worker in workers & {*living(main.pid)}:
            os.kill(worker, signal.SIGKILL)


def test_a_script_without_a_guard_is_told_so(tmp_path: Path) -> None:
    """Workers import the script, which starts workers: no advice to raise the memory alone."""
    shapes_file = tmp_path / "cube.off"
    write_mesh(shapes.cube(), shapes_file)
    script = tmp_path / "study.py"
    script.write_text(
        f"import pcretrieve as pr\npr.ingest({str(shapes_file)!r}, 'c.sqlite', workers=1)\n"
    )
    done = subprocess.run(
        [sys.executable, str(script)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert 'In a script, call this below `if __name__ == "__main__":`' in done.stderr
    assert "worker processes import the script" in done.stderr
