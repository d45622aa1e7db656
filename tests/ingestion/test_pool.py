"""Functions in worker processes: each item has one outcome, whatever happens to its process."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import shapes
from processes import all_workers_ended, wait_for

from pcretrieve.errors import (
    InputError,
    MemoryExceeded,
    PcretrieveError,
    ReconstructionError,
    Stage,
    StageTimeout,
    UnexpectedError,
    WorkerDied,
    in_stage,
)
from pcretrieve.ingestion import Isolation, in_processes, pool, worker

OOM_SCORE = Path("/proc/self/oom_score_adj")
HALF_THE_MEMORY = 1 << 29  # bytes, of 1 GiB
PATIENCE = 60  # seconds
hoard: list[object] = []  # what a worker never gives back


def own_process(item: int) -> tuple[int, int]:
    return item, os.getpid()


def die_once(folder: Path, item: int) -> int:
    try:
        (folder / str(item)).touch(exist_ok=False)
    except FileExistsError:
        return item
    os.kill(os.getpid(), signal.SIGKILL)
    return -1


class Fragile:
    """A function whose process dies before it takes an item: once, or always."""

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder

    def __setstate__(self, state: dict[str, Path | None]) -> None:
        self.__dict__ = state
        if self.folder is None:
            os._exit(1)
        die_once(self.folder, 0)

    def __call__(self, item: int) -> int:
        return item


def send_half(number: int, item: int) -> int:
    """An odd item is killed, or stopped, while it sends."""

    def half(answers: object, message: bytes) -> None:
        os.write(answers.fileno(), worker.LENGTH.pack(len(message)) + message[:1])  # type: ignore[attr-defined]
        os.kill(os.getpid(), number)

    if item % 2:
        worker._send = half
    return item


def fork_at_first(item: int) -> int:
    """The child of the first item returns too, while the next item is worked on."""
    if item == 0:
        time.sleep(0.5 if os.fork() == 0 else 0)
    else:
        time.sleep(1.5)
    return item


def keep_half_the_memory(item: int) -> int:
    hoard.append(np.ones(HALF_THE_MEMORY * 3 // 4, dtype=np.uint8))
    return item


def take_all_the_memory(item: int) -> int:
    return len(np.ones(HALF_THE_MEMORY * 3, dtype=np.uint8))


class Odd(InputError):
    """An exception of a plug-in, with arguments of its own."""

    def __init__(self, first: int, second: int) -> None:
        super().__init__(f"{first} and {second}", stage=Stage.CLEAN)

    def __reduce__(self) -> tuple[type[Odd], tuple[int, int]]:
        return Odd, (1, 2)


class Explosive:
    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        return divmod, (1, 0)


RAISED: dict[str, tuple[BaseException, type[PcretrieveError]]] = {
    "exit": (SystemExit(0), UnexpectedError),
    "interrupt": (KeyboardInterrupt(), UnexpectedError),
    "generator": (GeneratorExit(), UnexpectedError),
    "shape": (ReconstructionError("no body", stage=Stage.CLEAN), ReconstructionError),
    "odd": (Odd(1, 2), InputError),
    "memory": (MemoryError(), MemoryExceeded),
    "fault": (KeyError("x"), UnexpectedError),
}


def do(what: str) -> object:
    """Answer by the name of an item: raise, or give what cannot be sent, or not be received, or None."""
    if what in RAISED:
        with in_stage(Stage.SPECTRUM):
            raise RAISED[what][0]
    if what == "none":
        return None
    return threading.Lock() if what == "lock" else Explosive()


def crash() -> None:
    ctypes.string_at(0)


def write_and_die(folder: Path) -> None:
    tempfile.mkstemp()
    (folder / "written").write_text(os.environ["TMPDIR"])
    os.kill(os.getpid(), signal.SIGKILL)


# --- all goes well ----------------------------------------------------------------------------------------


def test_every_item_has_its_outcome_and_no_process_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers are as many as there are items, and items are read as they are needed."""
    started: list[object] = []

    class Counted(worker.Worker[int, tuple[int, int]]):
        def __init__(self, function: Callable[[int], tuple[int, int]], memory: float | None) -> None:
            super().__init__(function, memory)
            started.append(self)

    monkeypatch.setattr(pool, "Worker", Counted)
    assert len(list(in_processes(own_process, range(2), workers=8, timeout=PATIENCE, memory=None))) == 2
    assert len(started) == 2
    read: list[int] = []

    def items() -> Iterator[int]:
        for item in range(1000):
            read.append(item)
            yield item

    with pytest.raises(InputError, match="no reader"):
        for item, outcome in (running := Isolation().each(own_process, items(), workers=2)):
            assert isinstance(outcome, tuple)
            assert outcome[0] == item
            if item == 5:
                break
        raise InputError("no reader")
    assert len(read) < 12
    running.close()
    assert all_workers_ended()


def test_values_survive_the_way_to_another_process_and_back() -> None:
    body = shapes.body(2)
    assert Isolation().call(shapes.body, 2) == body
    assert Isolation().call(own_process, 1)[1] != os.getpid()


def test_a_worker_is_replaced_after_so_many_items(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "MAX_ITEMS", 2)
    found = list(Isolation().each(own_process, range(6)))
    processes = [process for _, (_, process) in found]  # type: ignore[misc]
    assert len(set(processes)) == 3
    assert processes[0::2] == processes[1::2]


@pytest.mark.slow
def test_an_answer_that_had_to_wait_is_not_late() -> None:
    """Answers larger than a pipe holds, while this process has been busy for longer than the time limit."""
    for size, answer in Isolation(timeout=2).each(bytes, range(3_000_000, 3_000_004), workers=2):
        assert isinstance(answer, bytes), str(answer)
        assert len(answer) == size
        time.sleep(3)


def test_commands_on_one_scan_import_no_stage_and_no_open3d_themselves() -> None:
    """The worker does, and doing both one after the other would take a second more."""
    modules = (
        "import sys; import pcretrieve.cli.scans, pcretrieve.cli.inspection; "
        "import pcretrieve.ingestion.pool, pcretrieve.ingestion.discover, pcretrieve.options; "
        "print({'open3d', 'numba', 'scipy.sparse', 'pcretrieve.pipeline'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", modules], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


# --- workers end ----------------------------------------------------------------------------------------


def test_an_item_whose_worker_died_is_tried_again(tmp_path: Path) -> None:
    found = dict(Isolation().each(partial(die_once, tmp_path), range(3), workers=2))
    assert found == {item: item for item in range(3)}


def test_crashes_and_limits_are_errors() -> None:
    with pytest.raises(WorkerDied, match="ended with SIGSEGV"):
        Isolation().call(crash)
    with pytest.raises(StageTimeout, match="not finished within 1 s: raise --timeout"):
        Isolation(timeout=1).call(time.sleep, 1000)
    assert all_workers_ended()


@pytest.mark.slow
@pytest.mark.parametrize(("number", "error"), [(signal.SIGKILL, WorkerDied), (signal.SIGSTOP, StageTimeout)])
def test_a_worker_that_ends_while_it_sends_costs_its_item_alone(
    number: int, error: type[PcretrieveError]
) -> None:
    found = dict(Isolation(timeout=10).each(partial(send_half, number), range(4), workers=2))
    assert (found[0], found[2]) == (0, 2)
    assert (type(found[1]), type(found[3])) == (error, error)


def test_a_worker_that_is_killed_before_its_first_item_is_replaced(tmp_path: Path) -> None:
    """But not for ever, where not one gets as far as an item."""
    assert dict(Isolation().each(Fragile(tmp_path), range(3))) == {0: 0, 1: 1, 2: 2}
    with pytest.raises(
        PcretrieveError, match="5 worker processes in a row ended, or hung, before they could"
    ):
        list(Isolation().each(Fragile(None), range(3), workers=2))
    assert all_workers_ended()


def test_every_exception_and_every_bad_answer_is_the_outcome_of_its_item() -> None:
    found = dict(Isolation().each(do, [*RAISED, "lock", "none", "explosive"]))
    assert found["none"] is None
    for name, (_, kind) in RAISED.items():
        outcome = found[name]
        assert type(outcome) is kind, name
        assert outcome.stage == (Stage.CLEAN if name in ("shape", "odd") else Stage.SPECTRUM), name
    for name in ("lock", "explosive"):
        assert "a fault of pcretrieve, or of a package that it uses" in str(found[name])


@pytest.mark.slow
def test_a_child_that_a_function_forks_answers_for_no_other_item() -> None:
    assert dict(Isolation().each(fork_at_first, range(3))) == {0: 0, 1: 1, 2: 2}


# --- memory and temporary files -------------------------------------------------------------------------


def test_what_lacks_memory_in_a_used_worker_is_tried_in_a_fresh_one() -> None:
    limited = Isolation(memory=1)
    assert dict(limited.each(keep_half_the_memory, range(3))) == {0: 0, 1: 1, 2: 2}
    ((_, outcome),) = limited.each(take_all_the_memory, [0])
    assert isinstance(outcome, MemoryExceeded)
    assert "--memory" in outcome.message


@pytest.mark.skipif(not OOM_SCORE.exists(), reason="needs Linux, which says what it kills first")
def test_a_worker_is_killed_before_its_parent_when_memory_ends() -> None:
    assert int(Isolation().call(OOM_SCORE.read_text)) > int(OOM_SCORE.read_text())


def test_a_worker_that_is_killed_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(WorkerDied):
        Isolation().call(write_and_die, tmp_path)
    assert (tmp_path / "written").read_text().startswith(f"{tmp_path}/pcretrieve-worker-")
    assert [path.name for path in tmp_path.iterdir()] == ["written"]


# A program whose worker writes a temporary file, from a child process too, and then sleeps.
SLEEPER = """
import subprocess, tempfile, time
from pathlib import Path
from pcretrieve.ingestion.pool import Isolation

def write_and_sleep(seconds):
    tempfile.mkstemp()
    subprocess.run(["mktemp"], check=True)
    Path({mark!r}).touch()
    time.sleep(seconds)

if __name__ == "__main__":
    Isolation().call(write_and_sleep, {seconds})
"""


def sleeper(folder: Path, name: str, seconds: float) -> subprocess.Popen[bytes]:
    """A running program of its own process group, whose worker has written its files."""
    mark = folder / f"{name}.mark"
    (folder / f"{name}.py").write_text(SLEEPER.format(mark=str(mark), seconds=seconds))
    path = os.pathsep.join(filter(None, sys.path))
    running = subprocess.Popen(
        [sys.executable, str(folder / f"{name}.py")],
        env={**os.environ, "TMPDIR": str(folder / "tmp"), "PYTHONPATH": path},
        start_new_session=True,
    )
    assert wait_for(mark.exists)
    return running


@pytest.mark.slow
def test_what_a_killed_process_group_left_is_removed_by_the_next_start(tmp_path: Path) -> None:
    """And what a running one has written is not."""
    (tmp_path / "tmp").mkdir()
    killed = sleeper(tmp_path, "killed", 1000)
    (left,) = (tmp_path / "tmp").iterdir()
    os.killpg(killed.pid, signal.SIGKILL)
    killed.wait(PATIENCE)
    assert len([*left.iterdir()]) == 2
    running = sleeper(tmp_path, "running", 1000)
    try:
        assert not left.exists()
        (present,) = (tmp_path / "tmp").iterdir()
        assert sleeper(tmp_path, "next", 0).wait(PATIENCE) == 0
        assert len([*present.iterdir()]) == 2
    finally:
        os.killpg(running.pid, signal.SIGKILL)
        running.wait(PATIENCE)
