"""The command line, timed from outside."""

from __future__ import annotations

import subprocess
import sys
import threading
import time

from pcretrieve.benchmarks.memory import resident_memory
from pcretrieve.errors import BenchmarkError

__all__ = ["run_command"]

# Interval at which the memory of a running command is read; seconds.
POLL_SECONDS = 0.02


def run_command(*arguments: str) -> tuple[float, float]:
    """Run ``pcretrieve`` in a process of its own, and discard its standard output.

    Parameters
    ----------
    *arguments : str
        Arguments of the command line.

    Returns
    -------
    seconds : float
        Wall-clock time from the start of the process to its end.
    peak : float
        Largest resident memory of the process and its descendants together, polled every 0.02 s; MiB.

    Raises
    ------
    BenchmarkError
        If the exit code is not 0.
    """
    started = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-m", "pcretrieve", *arguments], stdout=subprocess.DEVNULL)
    peak = 0.0
    finished = threading.Event()

    def watch() -> None:
        nonlocal peak
        while not finished.wait(POLL_SECONDS):
            peak = max(peak, resident_memory(process.pid))

    watcher = threading.Thread(target=watch)
    watcher.start()
    code = process.wait()
    seconds = time.perf_counter() - started
    finished.set()
    watcher.join()
    if code:
        raise BenchmarkError(f"pcretrieve {' '.join(arguments)} ended with exit code {code}, not 0")
    return seconds, peak
