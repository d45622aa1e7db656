"""Many strings as two arrays, which can be stored and mapped into memory."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import NDArray

__all__ = ["Names"]


@dataclass(frozen=True, slots=True, eq=False)
class Names(Sequence[str]):
    """Strings in ascending order, each of which is decoded when it is asked for.

    text: (b,) uint8, all strings in UTF-8, one after the other.
    ends: (n,) int64, the position behind the last byte of each string.
    """

    text: NDArray[np.uint8]
    ends: NDArray[np.int64]

    @classmethod
    def of(cls, names: Iterable[str]) -> Names:
        """The arrays of some strings.

        names: the strings, ascending.
        """
        encoded = [name.encode() for name in names]
        text = np.frombuffer(b"".join(encoded), np.uint8)
        return cls(text, np.cumsum(np.fromiter(map(len, encoded), np.int64, len(encoded))))

    def __len__(self) -> int:
        return len(self.ends)

    @overload
    def __getitem__(self, position: int) -> str: ...
    @overload
    def __getitem__(self, position: slice) -> list[str]: ...
    def __getitem__(self, position: int | slice) -> str | list[str]:
        if isinstance(position, slice):
            return [self[number] for number in range(*position.indices(len(self)))]
        number = range(len(self.ends))[position]
        start = self.ends[number - 1] if number else 0
        return str(self.text[start : self.ends[number]].data, "utf-8")

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and self[(row := bisect_left(self, name)) : row + 1] == [name]

    def index(self, name: str, start: int = 0, stop: int | None = None) -> int:
        """The position of a string."""
        first, last, _ = slice(start, stop).indices(len(self))
        row = bisect_left(self, name, first, last)
        if row >= last or self[row] != name:
            raise ValueError(f"{name!r} is not among the names")
        return row

    def inserted(self, names: Names, places: NDArray[np.intp]) -> Names:
        """The strings with further ones among them.

        names: the further strings, ascending.
        places: (n,) intp, the position before which each of them comes.
        Returns Names: all strings, ascending if the places are the right ones.
        """
        lengths, further = (np.diff(some.ends, prepend=0) for some in (self, names))
        starts = self.ends - lengths
        before = np.append(starts, len(self.text))[places]
        text = np.insert(self.text, np.repeat(before, further), names.text)
        return Names(text, np.cumsum(np.insert(lengths, places, further)))

    def kept(self, keep: NDArray[np.bool_]) -> Names:
        """Some of the strings.

        keep: (n,) bool, which ones.
        """
        lengths = np.diff(self.ends, prepend=0)
        return Names(self.text[np.repeat(keep, lengths)], np.cumsum(lengths[keep]))
