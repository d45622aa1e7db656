"""Resident memory of a process and its descendants, from the files of ``/proc``. Linux only."""

from __future__ import annotations

import contextlib
import os
import re
from pathlib import Path

__all__ = ["MIB", "forget_peak", "peak_memory", "resident_memory"]

KIB = 1 << 10
MIB = 1 << 20


def resident_memory(pid: int) -> float:
    """Resident memory of a process and its descendants at this moment.

    Parameters
    ----------
    pid : int
        Number of the process.

    Returns
    -------
    float
        MiB; 0 once the process has ended.
    """
    page = os.sysconf("SC_PAGE_SIZE")
    pages = 0
    for member in _tree(pid):
        with contextlib.suppress(OSError, IndexError):
            pages += int(Path(f"/proc/{member}/statm").read_text().split()[1])
    return pages * page / MIB


def forget_peak() -> None:
    """Reset the kernel's record of the largest resident memory of this process and its descendants."""
    for pid in _tree(os.getpid()):
        with contextlib.suppress(OSError):
            Path(f"/proc/{pid}/clear_refs").write_text("5")


def peak_memory() -> float:
    """Largest resident memory of this process and its descendants since `forget_peak`.

    Returns
    -------
    float
        Sum over the processes of the largest memory of each; MiB. NaN if the operating system does not record
        it.
    """
    kib = 0
    for pid in _tree(os.getpid()):
        with contextlib.suppress(OSError):
            found = re.search(r"VmHWM:\s*(\d+) kB", Path(f"/proc/{pid}/status").read_text())
            kib += int(found[1]) if found else 0
    return kib / KIB or float("nan")


def _tree(pid: int) -> list[int]:
    """A process and its descendants."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return [pid]
    return [pid, *(descendant for child in children for descendant in _tree(int(child)))]
