"""What benchmarks measure is what was run: turns, memory of whole process trees, and commands."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from pcretrieve.benchmarks.commands import run_command
from pcretrieve.benchmarks.memory import resident_memory
from pcretrieve.benchmarks.timing import Timing, timed_by_turns
from pcretrieve.errors import BenchmarkError

linux_only = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is read from /proc")


def test_functions_take_turns_and_the_first_result_counts() -> None:
    calls: list[str] = []

    def run(name: str) -> int:
        calls.append(name)
        return len(calls)

    (one, first), (other, second) = timed_by_turns([lambda: run("a"), lambda: run("b")], 3)
    assert calls == ["a", "b"] * 3
    assert (first, second) == (1, 2)
    assert len(one.seconds) == len(other.seconds) == 3


def test_median_and_best() -> None:
    timing = Timing([3.0, 1.0, 10.0])
    assert (timing.median, timing.best) == (3.0, 1.0)


@linux_only
def test_the_peak_is_kept_after_memory_is_freed_and_can_be_reset() -> None:
    """In a process of its own, whose kernel record no other test has touched."""
    program = """
import numpy as np
from pcretrieve.benchmarks.memory import forget_peak, peak_memory
before = peak_memory()
np.ones(25_000_000)  # 191 MiB, gone at once
held = peak_memory()
forget_peak()
print(held - before, held - peak_memory())
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    risen, fallen = map(float, ended.stdout.split())
    assert risen > 150
    assert fallen > 150


@linux_only
def test_memory_is_that_of_the_whole_tree() -> None:
    program = "import numpy as np, sys; a = np.ones(25_000_000); print(flush=True); sys.stdin.read()"
    before = resident_memory(os.getpid())
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as child:
        assert child.stdout is not None
        child.stdout.readline()
        with_child = resident_memory(os.getpid())
        child.communicate()
    assert with_child - before > 150


def test_a_command_is_timed_and_its_failure_is_said() -> None:
    seconds, peak = run_command("--version")
    assert seconds > 0
    assert peak >= 0
    with pytest.raises(BenchmarkError, match="pcretrieve list --catalogue nowhere ended with exit code"):
        run_command("list", "--catalogue", "nowhere")
