"""Damage to files, as transfers, editors and exporters do it, from a seed; read within limits."""

from __future__ import annotations

import re
import resource
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import numpy as np

from pcretrieve.errors import PcretrieveError

MOST_MUTATIONS = 4
MOST_BYTES = 64  # inserted, removed, or repeated at once

NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
# Numbers at which types, sizes and lists end.
NUMBERS = (
    *(b"0", b"-1", b"1", b"2", b"3", b"255", b"256", b"65536", b"2147483647", b"2147483648", b"4294967295"),
    *(b"99999999999", b"1" + b"0" * 30, b"9" * 5000, b"0.5", b"1e30", b"-1e30", b"1e-320", b"1e400"),
    *(b"nan", b"inf", b"-inf", b"0x10", b"1_000", b"", b"x", b"\xff", b"\xc2\xb2"),
)
WORDS = tuple(
    bytes.fromhex(word) for word in ("00000000", "ffffffff", "ffffff7f", "00000080", "0000a07f", "01000000")
)

Mutation = Callable[[bytes, np.random.Generator], bytes]


def flipped(data: bytes, rng: np.random.Generator) -> bytes:
    """One bit another."""
    if not data:
        return data
    at = int(rng.integers(len(data)))
    return data[:at] + bytes([data[at] ^ 1 << int(rng.integers(8))]) + data[at + 1 :]


def cut(data: bytes, rng: np.random.Generator) -> bytes:
    """The end missing."""
    return data[: int(rng.integers(len(data) + 1))]


def inserted(data: bytes, rng: np.random.Generator) -> bytes:
    """Random bytes somewhere."""
    at = int(rng.integers(len(data) + 1))
    return data[:at] + rng.bytes(int(rng.integers(1, MOST_BYTES))) + data[at:]


def removed(data: bytes, rng: np.random.Generator) -> bytes:
    """Some bytes missing."""
    at = int(rng.integers(len(data) + 1))
    return data[:at] + data[at + int(rng.integers(1, MOST_BYTES)) :]


def repeated(data: bytes, rng: np.random.Generator) -> bytes:
    """Some bytes twice."""
    at = int(rng.integers(len(data) + 1))
    return data[:at] + data[at : at + int(rng.integers(1, MOST_BYTES))] + data[at:]


def renumbered(data: bytes, rng: np.random.Generator) -> bytes:
    """One written number another."""
    places = [place.span() for place in NUMBER.finditer(data)]
    if not places:
        return data
    start, stop = places[int(rng.integers(len(places)))]
    return data[:start] + NUMBERS[int(rng.integers(len(NUMBERS)))] + data[stop:]


def renumbered_header(data: bytes, rng: np.random.Generator) -> bytes:
    """One number of the first lines another: counts and sizes."""
    size = min(len(data), 10 * MOST_BYTES)
    return renumbered(data[:size], rng) + data[size:]


def overwritten(data: bytes, rng: np.random.Generator) -> bytes:
    """Four bytes the limit of a type."""
    at = int(rng.integers(len(data) + 1))
    return data[:at] + WORDS[int(rng.integers(len(WORDS)))] + data[at + 4 :]


MUTATIONS: tuple[Mutation, ...] = (
    *(flipped, cut, inserted, removed, repeated),
    *(renumbered, renumbered_header, overwritten),
)


def mutated(data: bytes, seed: int) -> bytes:
    """A file with one to four damages; the same for the same file and seed."""
    rng = np.random.default_rng(seed)
    for _ in range(int(rng.integers(1, MOST_MUTATIONS + 1))):
        data = MUTATIONS[int(rng.integers(len(MUTATIONS)))](data, rng)
    return data


def altered(data: bytes, seed: int) -> bytes:
    """A file with one to four bits or words changed, as a disk or a memory does it: nothing moves."""
    rng = np.random.default_rng(seed)
    for _ in range(int(rng.integers(1, MOST_MUTATIONS + 1))):
        data = (flipped, overwritten)[int(rng.integers(2))](data, rng)[: len(data)]
    return data


# --- limits -------------------------------------------------------------------------------------------------

MEMORY = 1 << 30  # what a file of a few kilobytes may take; bytes
SECONDS = 5.0  # of processor time


class HangError(BaseException):
    """Raised where a call exceeds its time. Code that handles every `Exception` does not handle it."""


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
) -> tuple[int, list[str]]:
    """Read a file that is damaged anew from each seed: the number of errors, and each fault with its seed.

    named: what the message of each error must contain, unless the error names a shape of the file.
    """
    n_errors, faults = 0, []
    with limited_memory():
        for seed in range(n_seeds):
            path.write_bytes(contents(seed))
            try:
                with limited_time(SECONDS):
                    read(path)
            except PcretrieveError as error:
                n_errors += 1
                found = named in error.message or error.shape_id is not None
                if not found or "codec" in error.message:
                    faults.append(f"seed {seed}, in other words: {error}")
            except BaseException as error:  # noqa: BLE001 — whatever a reader lets pass is a fault
                faults.append(f"seed {seed}: {type(error).__name__}: {error}")
    path.unlink(missing_ok=True)
    return n_errors, faults
