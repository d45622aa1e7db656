"""Damage to files: at random, and by a loss of power; and how damaged files are read within limits."""

from __future__ import annotations

import random
import re
import resource
import signal
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import NamedTuple

import numpy as np

from pcretrieve.errors import PcretrieveError

# --- damage, as transfers, editors and exporters do it ----------------------------------------------------

MOST_DAMAGES = 4
MOST_BYTES = 64  # inserted, removed, or repeated at once
HEADER_BYTES = 640  # of the first lines, which hold counts and sizes

NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
# Numbers at which types, sizes and lists end.
NUMBERS = (
    *(
        b"0",
        b"-1",
        b"1",
        b"2",
        b"3",
        b"255",
        b"256",
        b"65536",
        b"2147483647",
        b"2147483648",
        b"4294967295",
    ),
    *(
        b"99999999999",
        b"1" + b"0" * 30,
        b"9" * 5000,
        b"0.5",
        b"1e30",
        b"-1e30",
        b"1e-320",
        b"1e400",
    ),
    *(b"nan", b"inf", b"-inf", b"0x10", b"1_000", b"", b"x", b"\xff", b"\xc2\xb2"),
)
LIMITS = [
    bytes.fromhex(word)
    for word in ("00000000", "ffffffff", "ffffff7f", "00000080", "0000a07f", "01000000")
]

# What a disk or a memory does, where nothing moves.
CHANGES = ("flip", "overwrite")
DAMAGES = (*CHANGES, "cut", "insert", "remove", "repeat", "renumber", "renumber header")


def damaged_once(data: bytes, damage: str, rng: np.random.Generator) -> bytes:
    at, n = int(rng.integers(len(data) + 1)), int(rng.integers(1, MOST_BYTES))
    match damage:
        case "flip":
            return (
                data[:at]
                + bytes(byte ^ 1 << n % 8 for byte in data[at : at + 1])
                + data[at + 1 :]
            )
        case "overwrite":
            return data[:at] + LIMITS[int(rng.integers(len(LIMITS)))] + data[at + 4 :]
        case "cut":
            return data[:at]
        case "insert":
            return data[:at] + rng.bytes(n) + data[at:]
        case "remove":
            return data[:at] + data[at + n :]
        case "repeat":
            return data[: at + n] + data[at:]
    start = at if damage == "renumber" else at % HEADER_BYTES
    place = NUMBER.search(data, start) or NUMBER.search(data)
    if place is None:
        return data
    number = NUMBERS[int(rng.integers(len(NUMBERS)))]
    return data[: place.start()] + number + data[place.end() :]


def damaged(data: bytes, seed: int, damages: Sequence[str] = DAMAGES) -> bytes:
    """A file with one to four damages; the same for the same file and seed."""
    rng, n_bytes = np.random.default_rng(seed), len(data)
    for _ in range(int(rng.integers(1, MOST_DAMAGES + 1))):
        data = damaged_once(data, damages[int(rng.integers(len(damages)))], rng)
    return data[:n_bytes] if damages is CHANGES else data


# --- limits -------------------------------------------------------------------------------------------------

MEMORY = 200 << 20  # what a file of a few kilobytes may take; bytes
SECONDS = 2.0  # of processor time


class HangError(BaseException):
    """Raised where a call exceeds its time. Code that handles every `Exception` does not handle it."""


class Clock:
    """The number of files that were tried."""

    n = 0


@contextmanager
def limited(n_bytes: int = MEMORY, seconds: float = SECONDS) -> Iterator[Clock]:
    """Let allocations of more than so many bytes in total raise a MemoryError, and long trials a HangError.

    A trial is stopped between once and twice these seconds, of processor time, which others do not take.
    """
    clock, last = Clock(), -1

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal last
        if last == clock.n:
            raise HangError(f"not finished within {seconds:g} s")
        last = clock.n

    used = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[5])
    most = used * resource.getpagesize() + n_bytes
    before = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (most, before[1]))
    handler = signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds, seconds)
    try:
        yield clock
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, handler)
        resource.setrlimit(resource.RLIMIT_DATA, before)


class Trial(NamedTuple):
    """What a file led to: it is read, refused, or else a fault, and what was said."""

    is_refused: bool
    fault: str = ""
    error: BaseException | None = None


def tried(path: Path, read: Callable[[Path], object], named: str, clock: Clock) -> Trial:
    """Read a file within the limits of a clock, and without a warning.

    named: what the message of an error must contain, unless the error names a shape of the file.
    """
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            clock.n += 1
            read(path)
            found = Trial(False)
        except PcretrieveError as error:
            is_named = named in error.message or error.shape_id is not None
            is_clear = is_named and "codec" not in error.message
            said = "" if is_clear else f"in other words: {error.message}"
            found = Trial(True, said, error)
        except BaseException as error:  # noqa: BLE001 — whatever a reader lets pass is a fault
            found = Trial(False, f"{type(error).__name__}: {error}", error)
    if warned and not found.fault:
        one = warned[0]
        said = (
            f"{one.category.__name__} in {one.filename}, line {one.lineno}: {one.message}"
        )
        return found._replace(fault=said)
    return found


def read_damaged(
    path: Path,
    contents: Callable[[int], bytes],
    read: Callable[[Path], object],
    n_seeds: int,
    named: str,
) -> tuple[int, list[str]]:
    """Read a file that is damaged anew from each seed: the number of errors, and each fault with its seed."""
    n_errors, faults = 0, []
    with limited() as clock:
        for seed in range(n_seeds):
            path.write_bytes(contents(seed))
            trial = tried(path, read, named, clock)
            n_errors += trial.is_refused
            if trial.fault:
                faults.append(f"seed {seed}, {trial.fault}")
    path.unlink(missing_ok=True)
    return n_errors, faults


# --- loss of power ------------------------------------------------------------------------------------------

SECTOR = 512  # bytes that a disk writes as a whole


class File:
    """What is on the disk, and the changes since that was certain: a size, or data at a position."""

    def __init__(self) -> None:
        self.disk = bytearray()
        self.pending: list[tuple[int, bytes | None]] = []

    def sync(self, is_kept: Callable[[], bool] = lambda: True) -> None:
        """Write the changes, or some of their sectors."""
        for at, data in self.pending:
            if data is None:
                if is_kept():
                    self.disk[at:] = bytes(max(0, at - len(self.disk)))
                continue
            # Sectors of the file, not of the data, which may begin within one.
            for sector in range(at - at % SECTOR, at + len(data), SECTOR):
                if is_kept():
                    place = max(at, sector)
                    piece = data[place - at : sector + SECTOR - at]
                    self.disk.extend(bytes(max(0, place - len(self.disk))))
                    self.disk[place : place + len(piece)] = piece
        self.pending.clear()


class Call(NamedTuple):
    """A call of the system, as `tests/ingestion/calls.c` records it: w, t, s or u, or m of a state."""

    kind: str
    file: str
    at: int
    data: bytes | None


def calls_of(trace: bytes) -> list[Call]:
    """The calls that change files of SQLite, without its shared memory, and their folder."""
    calls, place = [], 0
    while place < len(trace):
        end = trace.index(b"\n", place)
        kind, at, size, path = trace[place:end].decode().split(" ", 3)
        place = end + 1 + (int(size) if kind == "w" else 0)
        name = Path(path).name
        if "." not in name or name.endswith((".sqlite", "-wal", "-journal")):
            calls.append(
                Call(kind, name, int(at), trace[end + 1 : place] if kind == "w" else None)
            )
    return calls


def cut_power(calls: Sequence[Call], seed: int, folder: Path) -> int:
    """Write what is on the disk, of what was not certain a random part; the number of states before."""
    rng = random.Random(seed)
    there: dict[str, File] = {}  # as processes see the folder
    entries: dict[str, File] = {}  # as it is on the disk
    renamed: list[tuple[str, File | None]] = []
    n_states = 0

    def keep(changes: Sequence[tuple[str, File | None]]) -> None:
        for name, file in changes:
            entries.pop(name, None)
            if file is not None:
                entries[name] = file

    for kind, name, at, data in calls[: rng.randrange(len(calls) + 1)]:
        if kind == "m":
            n_states += 1
        elif "." not in name:  # the folder
            keep(renamed)
            renamed.clear()
        elif kind == "u":
            there.pop(name, None)
            renamed.append((name, None))
        else:
            if name not in there:
                there[name] = File()
                renamed.append((name, there[name]))
            there[name].pending += [] if kind == "s" else [(at, data)]
            if kind == "s":
                there[name].sync()
    keep(renamed[: rng.randrange(len(renamed) + 1)])
    share = rng.choice((0, 0.5, 0.9, 1))
    folder.mkdir()
    for name, file in entries.items():
        file.sync(lambda: rng.random() < share)
        (folder / name).write_bytes(file.disk)
    return n_states
