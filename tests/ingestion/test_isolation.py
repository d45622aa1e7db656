"""A function in another process: its answer is returned, and the end of the process is an error."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import time

import numpy as np
import pytest
import shapes
from processes import all_workers_ended

from pcretrieve.errors import (
    InputError,
    MemoryExceeded,
    PcretrieveError,
    ReconstructionError,
    StageTimeout,
    UnexpectedError,
    WorkerDied,
)
from pcretrieve.ingestion.isolation import Isolation

GIB = 1 << 30


def doubled(values: np.ndarray, *, times: int) -> tuple[int, np.ndarray]:
    return os.getpid(), 2 * times * values


def crash() -> None:
    ctypes.string_at(0)


def refuse(what: str) -> None:
    raise {"input": InputError, "shape": ReconstructionError, "fault": ValueError}[what](f"no {what}")


def leave() -> None:
    raise SystemExit(0)


def fill(gibibytes: int) -> int:
    return len(np.ones(gibibytes * GIB, dtype=np.uint8))


def odd_half(number: int) -> int:
    if number % 2:
        raise ReconstructionError(f"{number} is odd")
    return number // 2


def test_what_a_function_returns_comes_from_another_process() -> None:
    process, values = Isolation().call(doubled, np.arange(3), times=5)
    assert process != os.getpid()
    np.testing.assert_array_equal(values, [0, 10, 20])
    assert all_workers_ended()


def test_a_crash_of_native_code_is_an_error() -> None:
    with pytest.raises(WorkerDied, match="ended with SIGSEGV"):
        Isolation().call(crash)
    assert all_workers_ended()


@pytest.mark.parametrize(
    ("what", "kind"), [("input", InputError), ("shape", ReconstructionError), ("fault", UnexpectedError)]
)
def test_what_a_function_raises_is_raised(what: str, kind: type[PcretrieveError]) -> None:
    with pytest.raises(kind, match=f"no {what}"):
        Isolation().call(refuse, what)


def test_a_function_cannot_end_the_program() -> None:
    with pytest.raises(UnexpectedError, match="SystemExit: 0"):
        Isolation().call(leave)


def test_limits_hold() -> None:
    with pytest.raises(StageTimeout, match="not finished within 1 s: raise --timeout"):
        Isolation(timeout=1).call(time.sleep, 1000)
    with pytest.raises(MemoryExceeded, match="--memory"):
        Isolation(memory=1).call(fill, 2)
    assert all_workers_ended()


def test_items_are_answered_in_their_order() -> None:
    outcomes = list(Isolation().each(odd_half, [4, 3, 8]))
    assert [item for item, _ in outcomes] == [4, 3, 8]
    assert [outcome for _, outcome in outcomes if isinstance(outcome, int)] == [2, 4]
    assert isinstance(outcomes[1][1], ReconstructionError)


def test_values_of_a_scan_survive_the_way_back() -> None:
    body = shapes.body(2)
    assert Isolation().call(shapes.body, 2) == body


def test_commands_on_one_scan_import_no_stage_and_no_open3d_themselves() -> None:
    """The worker does, and doing both one after the other would take a second more."""
    modules = (
        "import sys; import pcretrieve.cli.scans, pcretrieve.cli.inspection; "
        "import pcretrieve.ingestion.isolation, pcretrieve.ingestion.discover, pcretrieve.options; "
        "print({'open3d', 'numba', 'scipy.sparse', 'pcretrieve.pipeline.process'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", modules], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
