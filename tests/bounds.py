"""Damaged files are read within limits of memory and time, in the process of the tests."""

from __future__ import annotations

import resource
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

from pcretrieve.errors import PcretrieveError

__all__ = ["Findings", "limited_memory", "read_damaged"]

MEMORY = 1 << 30  # what a file of a few kilobytes may take; bytes
SECONDS = 5.0  # of processor time


class HangError(BaseException):
    """Raised where a call exceeds its time. Code that handles every `Exception` does not handle it."""


@dataclass
class Findings:
    """What reading damaged files has shown: the numbers of inputs and of named errors, and each fault."""

    n_inputs: int = 0
    n_errors: int = 0
    hangs: list[str] = field(default_factory=list)
    memory: list[str] = field(default_factory=list)
    others: list[str] = field(default_factory=list)

    @property
    def faults(self) -> list[str]:
        return self.hangs + self.memory + self.others

    def counts(self) -> tuple[int, ...]:
        return (self.n_inputs, self.n_errors, len(self.hangs), len(self.memory), len(self.others))


@contextmanager
def limited_memory(n_bytes: int = MEMORY) -> Iterator[None]:
    """Let further allocations of more than so many bytes in total raise a MemoryError."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    (used,) = (int(line.split()[1]) << 10 for line in status.splitlines() if line.startswith("VmData"))
    before = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (used + n_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


@contextmanager
def limited_time(seconds: float) -> Iterator[None]:
    """Raise a HangError after so many seconds of processor time, which other processes do not take."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise HangError(f"not finished within {seconds:g} s")

    before = signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, before)


def read_damaged(
    path: Path, contents: Callable[[int], bytes], read: Callable[[Path], object], n_seeds: int, *, named: str
) -> Findings:
    """Read a file that is damaged anew from each seed.

    Parameters
    ----------
    path : Path
        Where the damaged files are written, one after the other.
    contents : function of a seed that returns bytes
    read : function of a path
    n_seeds : int
    named : str
        What the message of each error must contain, unless the error names a shape of the file.

    Returns
    -------
    Findings
        Each fault has its seed, with which it can be reproduced.
    """
    findings = Findings()
    with limited_memory():
        for seed in range(n_seeds):
            path.write_bytes(contents(seed))
            findings.n_inputs += 1
            try:
                with limited_time(SECONDS):
                    read(path)
            except PcretrieveError as error:
                findings.n_errors += 1
                found = named in error.message or error.shape_id is not None
                if not found or "codec" in error.message:
                    findings.others.append(f"seed {seed}, in other words: {error}")
            except HangError as error:
                findings.hangs.append(f"seed {seed}: {error}")
            except MemoryError as error:
                findings.memory.append(f"seed {seed}: {error}")
            except BaseException as error:  # noqa: BLE001 — whatever a reader lets pass is a fault
                findings.others.append(f"seed {seed}: {type(error).__name__}: {error}")
    path.unlink(missing_ok=True)
    return findings
