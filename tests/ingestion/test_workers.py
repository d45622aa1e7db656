"""Worker processes that are killed, stopped or replaced affect at most one outcome."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from processes import all_workers_ended

from pcretrieve.errors import (
    InputError,
    MemoryExceeded,
    PcretrieveError,
    Stage,
    StageTimeout,
    UnexpectedError,
    WorkerDied,
    in_stage,
)
from pcretrieve.ingestion import serving, worker, workers
from pcretrieve.ingestion.isolation import Isolation
from pcretrieve.ingestion.workers import outcomes

N_ITEMS = 6
OOM_SCORE = Path("/proc/self/oom_score_adj")
HALF_THE_MEMORY = 1 << 29  # bytes, of 1 GiB
hoard: list[object] = []  # what a worker never gives back


def nothing() -> None:
    pass


def own_process(item: int) -> tuple[int, int]:
    return item, os.getpid()


def bytes_of(item: int) -> bytes:
    return bytes(item)


def die_once(folder: Path, item: int) -> int:
    try:
        (folder / str(item)).touch(exist_ok=False)
    except FileExistsError:
        return item
    os.kill(os.getpid(), signal.SIGKILL)
    return -1


def send_half(number: int, item: int) -> int:
    """An odd item is killed, or stopped, while it sends."""

    def half(answers: object, message: bytes) -> None:
        os.write(answers.fileno(), serving.LENGTH.pack(len(message)) + message[:1])  # type: ignore[attr-defined]
        os.kill(os.getpid(), number)

    if item % 2:
        serving._send = half
    return item


def fork_at_first(item: int) -> int:
    """The child of the first item returns too, while the next item is worked on."""
    if item == 0:
        time.sleep(0.5 if os.fork() == 0 else 0)
    else:
        time.sleep(1.5)
    return item


def oom_score(item: int) -> int:
    return int(OOM_SCORE.read_text())


def keep_half_the_memory(item: int) -> int:
    hoard.append(np.ones(HALF_THE_MEMORY * 3 // 4, dtype=np.uint8))
    return item


def take_all_the_memory(item: int) -> int:
    return len(np.ones(HALF_THE_MEMORY * 3, dtype=np.uint8))


def answer_with_what_cannot_be_sent(item: int) -> object:
    return threading.Lock() if item % 2 else item


class Odd(InputError):
    """An exception of a plug-in, with arguments of its own."""

    def __init__(self, first: int, second: int) -> None:
        super().__init__(f"{first} and {second}", stage=Stage.CLEAN)

    def __reduce__(self) -> tuple[type[Odd], tuple[int, int]]:
        return Odd, (1, 2)


def raise_one(error: BaseException, item: int) -> int:
    if item % 2:
        with in_stage(Stage.SPECTRUM):
            raise error
    return item


class Explosive:
    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        return divmod, (1, 0)


def answer_with_what_cannot_be_received(item: int) -> object:
    return Explosive() if item % 2 else item


# --- all goes well ----------------------------------------------------------------------------------------


def test_every_item_has_its_outcome_and_no_process_is_left() -> None:
    found = dict(outcomes(own_process, range(N_ITEMS), prepare=nothing, workers=2, timeout=60))
    assert [found[item][0] for item in range(N_ITEMS)] == list(range(N_ITEMS))  # type: ignore[index]
    assert 1 <= len({process for _, process in found.values()}) <= 2  # type: ignore[misc]
    assert all_workers_ended()


def test_no_more_workers_are_started_than_there_are_items(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[object] = []

    class Counted(worker.Worker[int, object]):
        def __init__(self, function: Callable[[int], object], prepare: Callable[[], object]) -> None:
            super().__init__(function, prepare)
            started.append(self)

    monkeypatch.setattr(workers, "Worker", Counted)
    assert len(dict(outcomes(own_process, range(2), prepare=nothing, workers=8, timeout=60))) == 2
    assert len(started) == 2


def test_items_are_read_as_they_are_asked_for() -> None:
    n_read = 0

    def items() -> Iterator[int]:
        nonlocal n_read
        for item in range(1000):
            n_read += 1
            yield item

    running = outcomes(own_process, items(), prepare=nothing, workers=1, timeout=60)
    next(running)
    assert n_read <= 4
    running.close()
    assert all_workers_ended()


def test_a_worker_is_replaced_after_so_many_items(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "MAX_ITEMS", 2)
    found = list(outcomes(own_process, range(N_ITEMS), prepare=nothing, workers=1, timeout=60))
    processes = [process for _, (_, process) in found]  # type: ignore[misc]
    assert len(set(processes)) == N_ITEMS / 2
    assert processes[0::2] == processes[1::2]


def test_an_answer_that_had_to_wait_is_not_late() -> None:
    """Answers larger than a pipe holds, while this process has been busy for longer than the time limit."""
    sizes = range(3_000_000, 3_000_004)
    for size, answer in outcomes(bytes_of, sizes, prepare=nothing, workers=2, timeout=2):
        assert isinstance(answer, bytes), str(answer)
        assert len(answer) == size
        time.sleep(3)


# --- workers end ----------------------------------------------------------------------------------------


def test_an_item_whose_worker_died_is_tried_again(tmp_path: Path) -> None:
    found = dict(
        outcomes(partial(die_once, tmp_path), range(N_ITEMS), prepare=nothing, workers=2, timeout=60)
    )
    assert found == {item: item for item in range(N_ITEMS)}


@pytest.mark.parametrize(("number", "error"), [(signal.SIGKILL, WorkerDied), (signal.SIGSTOP, StageTimeout)])
def test_a_worker_that_ends_while_it_sends_costs_its_item_alone(
    number: int, error: type[PcretrieveError]
) -> None:
    found = dict(outcomes(partial(send_half, number), range(4), prepare=nothing, workers=2, timeout=10))
    assert (found[0], found[2]) == (0, 2)
    assert (type(found[1]), type(found[3])) == (error, error)


def test_a_worker_that_is_killed_before_its_first_item_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """But not for ever, where not one gets as far as an item."""
    monkeypatch.setattr(workers, "MAX_ITEMS", 1)
    prepare: Callable[[], object] = partial(die_once, tmp_path, 0)
    found = dict(outcomes(own_process, range(3), prepare=prepare, workers=1, timeout=60))
    assert found.keys() == {0, 1, 2}
    with pytest.raises(
        PcretrieveError, match="5 worker processes in a row ended, or hung, before they could take"
    ):
        list(outcomes(own_process, range(3), prepare=partial(os._exit, 1), workers=2, timeout=60))
    assert all_workers_ended()


@pytest.mark.parametrize(
    ("raised", "recorded"),
    [
        (SystemExit(0), UnexpectedError),
        (KeyboardInterrupt(), UnexpectedError),
        (GeneratorExit(), UnexpectedError),
        (InputError("no such thing", stage=Stage.CLEAN), InputError),
        (Odd(1, 2), InputError),
        (MemoryError(), MemoryExceeded),
    ],
    ids=lambda value: type(value).__name__,
)
def test_every_exception_is_the_outcome_of_its_item(
    raised: BaseException, recorded: type[PcretrieveError]
) -> None:
    found = dict(outcomes(partial(raise_one, raised), range(4), prepare=nothing, workers=1, timeout=60))
    assert (found[0], found[2]) == (0, 2)
    for item in (1, 3):
        outcome = found[item]
        assert type(outcome) is recorded
        assert outcome.stage == (Stage.CLEAN if recorded is InputError else Stage.SPECTRUM)


def test_a_child_that_a_function_forks_answers_for_no_other_item() -> None:
    found = dict(outcomes(fork_at_first, range(3), prepare=nothing, workers=1, timeout=60))
    assert found == {item: item for item in range(3)}


# --- memory ---------------------------------------------------------------------------------------------


def test_what_lacks_memory_in_a_used_worker_is_tried_in_a_fresh_one() -> None:
    limited = Isolation(memory=1)
    assert dict(limited.each(keep_half_the_memory, range(3))) == {0: 0, 1: 1, 2: 2}
    ((_, outcome),) = limited.each(take_all_the_memory, [0])
    assert isinstance(outcome, MemoryExceeded)


@pytest.mark.skipif(not OOM_SCORE.exists(), reason="needs Linux, which says what it kills first")
def test_a_worker_is_killed_before_its_parent_when_memory_ends() -> None:
    ((_, score),) = outcomes(oom_score, [0], prepare=nothing, workers=1, timeout=60)
    assert isinstance(score, int)
    assert score > oom_score(0)


# --- answers --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("answer", [answer_with_what_cannot_be_sent, answer_with_what_cannot_be_received])
def test_an_answer_that_cannot_be_pickled_is_that_items_failure(answer: Callable[[int], object]) -> None:
    found = dict(outcomes(answer, range(4), prepare=nothing, workers=1, timeout=60))
    assert (found[0], found[2]) == (0, 2)
    for item in (1, 3):
        assert "a fault of pcretrieve, or of a package that it uses" in str(found[item])
