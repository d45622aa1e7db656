"""What the kernel does for a child process when its parent dies."""

from __future__ import annotations

import ctypes
import signal
import sys

__all__ = ["end_with_parent"]

# <sys/prctl.h>
PR_SET_PDEATHSIG = 1


def end_with_parent() -> None:
    """Have the kernel kill this process when its parent dies, whatever it computes then.

    The parent is, strictly, the thread that started this process. Linux only: elsewhere a process goes on
    until it next reads from its parent's pipe, or writes to it.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
