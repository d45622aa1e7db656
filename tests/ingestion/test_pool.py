"""Functions in worker processes: each item has one outcome, whatever happens to its process."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from processes import all_workers_ended

from pcretrieve.errors import (
    InputError,
    MemoryExceeded,
    PcretrieveError,
    ReconstructionError,
    Stage,
    UnexpectedError,
    in_stage,
)
from pcretrieve.ingestion import in_processes, pool

HALF_THE_MEMORY = 1 << 29  # bytes, of 1 GiB
PATIENCE = 60  # seconds
hoard: list[object] = []  # what a worker never gives back


def own_process(item: int) -> tuple[int, int]:
    return item, os.getpid()


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


# --- all goes well ----------------------------------------------------------------------------------------


def test_every_item_has_its_outcome_and_no_process_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers are as many as there are items, and items are read as they are needed."""
    started, start = [], pool.Worker

    def counted(*given: Any) -> Any:
        started.append(start(*given))
        return started[-1]

    monkeypatch.setattr(pool, "Worker", counted)
    assert len(list(in_processes(own_process, range(2), workers=8, timeout=PATIENCE))) == 2
    assert len(started) == 2
    read: list[int] = []

    def items() -> Iterator[int]:
        for item in range(1000):
            read.append(item)
            yield item

    with pytest.raises(InputError, match="no reader"):
        for item, outcome in (running := in_processes(own_process, items(), workers=2)):
            assert isinstance(outcome, tuple)
            assert outcome[0] == item
            if item == 5:
                break
        raise InputError("no reader")
    assert len(read) < 12
    running.close()
    assert all_workers_ended()


# --- workers end ----------------------------------------------------------------------------------------


def test_every_exception_and_every_bad_answer_is_the_outcome_of_its_item() -> None:
    found = dict(in_processes(do, [*RAISED, "lock", "none", "explosive"], workers=1))
    assert found["none"] is None
    for name, (_, kind) in RAISED.items():
        outcome = found[name]
        assert type(outcome) is kind, name
        assert outcome.stage == (Stage.CLEAN if name in ("shape", "odd") else Stage.SPECTRUM), name
    for name in ("lock", "explosive"):
        assert "a fault of pcretrieve, or of a package that it uses" in str(found[name])


# --- memory and temporary files -------------------------------------------------------------------------


def test_what_lacks_memory_in_a_used_worker_is_tried_in_a_fresh_one() -> None:
    assert dict(in_processes(keep_half_the_memory, range(3), workers=1, memory=1)) == {0: 0, 1: 1, 2: 2}
    ((_, outcome),) = in_processes(take_all_the_memory, [0], memory=1)
    assert isinstance(outcome, MemoryExceeded)
    assert "--memory" in outcome.message
