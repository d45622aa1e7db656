"""The end of a worker process when its parent process ends, and instead of its parent process."""

from __future__ import annotations

import ctypes
import signal
import sys
from contextlib import suppress
from pathlib import Path

__all__ = ["end_instead_of_parent", "end_with_parent"]

# <sys/prctl.h>
PR_SET_PDEATHSIG = 1


def end_with_parent() -> None:
    """Ask the kernel to kill this process when its parent ends, also during a computation.

    Linux only: on other systems the process continues until it next reads from or writes to the pipe of its
    parent. For the kernel, the parent is the thread that started this process.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


# What the kernel adds to the memory of a process before it compares processes; thousandths of all memory.
OOM_SCORE = 500


def end_instead_of_parent() -> None:
    """Ask the kernel to kill this process rather than its parent when the computer lacks memory.

    Linux only: other systems, and a Linux without ``/proc``, choose as they do.
    """
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(f"{OOM_SCORE}\n", encoding="ascii")
