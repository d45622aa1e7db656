"""The write-ahead log of an SQLite file → what is wrong with it, before SQLite reads it.

SQLite uses a log up to its first wrong frame and drops the rest in silence [1]_. Such a rest is normal if it
belongs to an older log, or is the last transaction of a process that was killed or lost its power. Only one
transaction can be unfinished, because each is synced before the next begins.

References
----------
.. [1] https://sqlite.org/walformat.html
"""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from pcretrieve.values.files import lock

Words = NDArray[np.uint32]

# Bytes of the header of a log, and of that of a frame, which a page follows.
HEADER = 32
FRAME_HEADER = 24

# The first bytes of a log, and the order of the bytes in the words of its checksums.
ORDERS = {b"7\x7f\x06\x82": "<u4", b"7\x7f\x06\x83": ">u4"}

# Sizes of pages that SQLite has.
PAGES = {2**power for power in range(9, 17)}

# Bytes that a disk writes as a whole.
SECTOR = 512

# Bytes that are read at once.
READ_AT_ONCE = 1 << 22


def log_fault(log: Path) -> str | None:
    """What is wrong with a log; None also while a process writes it, which has looked at it before."""
    with suppress(OSError), log.open("rb") as file:
        lock(file, shared=True, waits=False)
        before = os.fstat(file.fileno())
        fault = _fault(file, before.st_size) if before.st_size else None
        # Other programs write without the lock.
        after = os.fstat(file.fileno())
        if (after.st_size, after.st_mtime_ns) == (before.st_size, before.st_mtime_ns):
            return fault
    return None


@dataclass(slots=True)
class _Frames:
    """What is found in the frames of a log, which are looked at from the first to the last.

    order, salts: the order of the bytes in the words of the log, and the two salts of its frames.
    n_bytes: bytes of a frame.
    before: the checksum of the frame before the next one.
    wrong: number of the first wrong frame, from 0.
    n_lost: number of transactions that end there or behind, which SQLite drops.
    is_changed: whether one word of the first wrong frame explains what is wrong with it.
    """

    order: str
    salts: Words
    n_bytes: int
    before: Words
    n_seen: int = 0
    wrong: int | None = None
    n_lost: int = 0
    is_changed: bool = False

    @classmethod
    def behind(cls, header: bytes) -> _Frames | None:
        """The frames behind the header of a log; None if the header is wrong."""
        order, page = ORDERS.get(header[:4]), int.from_bytes(header[8:12], "big")
        if len(header) < HEADER or order is None or page not in PAGES:
            return None
        numbers = np.frombuffer(header, ">u4").astype(np.uint32)
        words = np.frombuffer(header[:24], order)
        if (_checksums(words[None], np.zeros((1, 2), np.uint32)) != numbers[6:]).any():
            return None
        return cls(order, numbers[4:6], FRAME_HEADER + page, numbers[6:])

    def look(self, data: bytes) -> None:
        """Look at the next frames."""
        n_words = self.n_bytes // 4
        # Page, size of the file if a transaction ends here, two salts, two checksums.
        heads = np.frombuffer(data, ">u4").reshape(-1, n_words)[:, :6].astype(np.uint32)
        is_ours = (heads[:, 2:4] == self.salts).all(axis=1)
        is_commit = heads[:, 1] > 0
        first = 0
        if self.wrong is None:
            words = np.frombuffer(data, self.order).reshape(-1, n_words)
            given = np.concatenate([self.before[None], heads[:-1, 4:]])
            differences = heads[:, 4:] - _checksums(words, given)  # (n, 2)
            is_wrong = ~is_ours | differences.any(axis=1)
            self.before, first = heads[-1, 4:], len(heads)
            if is_wrong.any():
                first = int(is_wrong.argmax())
                self.wrong = self.n_seen + first
                self.is_changed = _is_one_word(differences[first], n_words)
                # Changed salts say that the frame is of another log.
                is_lost = is_commit[first] and not is_ours[first] and self.is_changed
                self.n_lost += int(is_lost)
        self.n_lost += int((is_ours & is_commit)[first:].sum())
        self.n_seen += len(heads)


def _fault(file: IO[bytes], size: int) -> str | None:
    header = file.read(HEADER)
    frames = _Frames.behind(header)
    if frames is None:
        return "its header is wrong"
    at_once = max(1, READ_AT_ONCE // frames.n_bytes)
    n_frames, n_rest = divmod(size - HEADER, frames.n_bytes)
    for start in range(0, n_frames, at_once):
        frames.look(file.read(min(at_once, n_frames - start) * frames.n_bytes))
    if frames.wrong is not None and frames.n_lost > (0 if frames.is_changed else 1):
        return f"frame {frames.wrong + 1} of {n_frames} is wrong"
    rest = file.read()
    is_ours_too = rest[8:16] == header[16:24] if len(rest) >= 16 else frames.wrong is None
    # Where a process is killed, a write has ended; where power fails, a sector.
    if n_rest not in (0, FRAME_HEADER) and size % SECTOR and is_ours_too:
        return "its end is cut off"
    return None


def _checksums(words: Words, before: Words) -> Words:
    """The checksums (n, 2) of n headers of logs, or frames, each after another checksum (n, 2).

    They are the last two of u(k) = u(k-1) + u(k-2) + x(k), and so sums of x by Fibonacci numbers.
    """
    weights = _weights(words.shape[1])
    x = np.stack([before[:, 0], before[:, 1] - before[:, 0]], axis=1)
    summed = x @ weights[:2] + np.stack([words @ each for each in weights[2:].T], axis=1)
    return np.asarray(summed, np.uint32)


@cache
def _weights(n_words: int) -> Words:
    """Weights (2 + n, 2) of the checksum before, and of the words of a frame, or of the header of a log."""
    # The salts and the checksum of the frame.
    n_left_out = 0 if n_words < HEADER // 4 else 4
    n_summed = 2 + n_words - n_left_out
    numbers = [0, 1]
    while len(numbers) <= n_summed:
        numbers.append((numbers[-1] + numbers[-2]) % 2**32)
    fibonacci = np.array(numbers[::-1], np.uint32)
    weights = np.stack([fibonacci[1:], fibonacci[:-1]], axis=1)
    gap = np.zeros((n_left_out, 2), np.uint32)
    return np.asfortranarray(np.concatenate([weights[:4], gap, weights[4:]]))


def _is_one_word(difference: Words, n_words: int) -> bool:
    """Whether a change of one word explains the difference of a checksum, which a lost sector hardly has."""
    weights = _weights(n_words)[2:]
    in_data = difference[0] * weights[:, 1] == difference[1] * weights[:, 0]
    return bool(in_data[weights.any(axis=1)].any() or not difference.all())
