"""What a store of shapes does, whatever holds its rows.

A store knows records, and bytes by name; `pcretrieve.catalogue.Catalogue` knows what they mean. Each
operation is one transaction: it happens as a whole or not at all, whatever other processes do at the time.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from pcretrieve.catalogue.record import Record

__all__ = ["OWN", "PAYLOADS", "Listed", "Payload", "Revision", "Rows", "Status"]

#: What is stored of a shape beside its record and its signatures, each of them read by itself.
Payload = Literal["spectra", "moments", "overlaps", "meshes"]
PAYLOADS: tuple[Payload, ...] = ("spectra", "moments", "overlaps", "meshes")

Status = Literal["done", "failed"]

#: The digest that the signatures by a catalogue's own options are kept under.
OWN = "own"


@dataclass(frozen=True, slots=True)
class Revision:
    """Names of a state of a store; a state that comes after another one never has the same names.

    Attributes
    ----------
    shapes : str
        Changes with every write that adds, replaces or removes a shape that did not fail.
    labels : str
        Changes with every write that labels shapes.
    """

    shapes: str
    labels: str

    def state(self, by_label: bool) -> str:
        """One name for the state of the shapes, or for that of the shapes and their labels."""
        return f"{self.shapes} {self.labels}" if by_label else self.shapes


@dataclass(frozen=True, slots=True, eq=False)
class Listed:
    """Signatures of all shapes that did not fail, as they stand in one state of the store.

    Attributes
    ----------
    revision : Revision
        Of that state.
    ids : list of str
        Ascending.
    labels : list of (str or None)
    packed : (N, b) uint8
        The bytes of each signature, in the order of the ids. The array is the caller's, to be overwritten.
    has : (N,) bool
        Whether there is a signature by these options; where there is none yet, its bytes are zero.
    """

    revision: Revision
    ids: list[str]
    labels: list[str | None]
    packed: NDArray[np.uint8]
    has: NDArray[np.bool_]


class Rows(Protocol):
    """The operations that a catalogue needs of a store.

    ``tests/catalogue/test_rows.py`` tests stores for what this protocol asks of them.
    """

    @property
    def location(self) -> str:
        """The path of a file, or a URL without a password, as messages name the store."""

    @property
    def folder(self) -> Path | None:
        """A folder for indexes, which can be made again; None where the user's cache folder must do."""

    @property
    def is_writable(self) -> bool:
        """Whether the store can be written to."""

    def close(self) -> None:
        """Release the store."""

    def settings(self) -> Mapping[str, str]:
        """What the store was made with: ``options``, as JSON, and ``numbers_version``."""

    def revision(self) -> Revision:
        """The state of the store now."""

    def count(self, status: Status) -> int:
        """The number of shapes of a status."""

    def areas(self) -> tuple[float, float] | None:
        """The smallest and the largest area of a shape that did not fail; None where there is none."""

    def page(
        self, *, after: str = "", offset: int = 0, limit: int, status: Status | None = None
    ) -> list[Record]:
        """Some records in ascending order of id.

        Parameters
        ----------
        after : str, default ""
            An id; records up to it are left out.
        offset : int, default 0
            Further records that are left out.
        limit : int
            Largest number of records.
        status : {"done", "failed"}, optional
            Only records of this status.

        Returns
        -------
        list of Record
            With their provenance.
        """

    def by_id(self, shape_ids: Collection[str]) -> list[Record]:
        """The records of some ids, in ascending order of id, without ids that the store does not hold."""

    def by_content(self, hashes: Collection[str]) -> list[Record]:
        """The records of some content hashes, by id; several files may have the same content."""

    def put(self, record: Record, signature: bytes | None, payloads: Mapping[Payload, bytes]) -> Record:
        """Store a shape under its path, in place of what the store holds of that path.

        A path that the store holds keeps its id; an id that belongs to another path is replaced by the next
        free number, as `pcretrieve.catalogue.free_id` finds it. A failure never replaces a finished shape.

        Parameters
        ----------
        record : Record
            The record.
        signature : bytes or None
            Kept under the digest `OWN`; None for a shape that failed.
        payloads : mapping of str to bytes
            Some of `PAYLOADS`; none for a shape that failed.

        Returns
        -------
        Record
            The record that the store holds of that path now.
        """

    def remove(self, shape_ids: Collection[str]) -> None:
        """Remove shapes; ids that the store does not hold are ignored."""

    def revise(
        self, *, moved: Mapping[str, str], removed: Collection[str], labels: Mapping[str, str]
    ) -> None:
        """Rename, remove and label shapes by path, in this order; paths that it does not hold are ignored.

        Parameters
        ----------
        moved : mapping of path to path
            New path by the old one. Where the store holds the new path, nothing is renamed.
        removed : collection of str
            Paths of shapes to remove.
        labels : mapping of path to class
            By the new path where a shape was renamed.
        """

    def read(self, shape_id: str, names: Collection[Payload]) -> tuple[Record, dict[Payload, bytes]] | None:
        """A record and some payloads, in one state of the store.

        Parameters
        ----------
        shape_id : str
            The id of the shape.
        names : collection of str
            Some of `PAYLOADS`.

        Returns
        -------
        (Record, dict of str to bytes) or None
            The payloads of these names that are stored; None where there is no such shape.
        """

    def sizes(self, shape_id: str) -> dict[str, int]:
        """Bytes of a shape's payloads by name, of its ``signatures``, and of its ``record``."""

    def signatures(self, digest: str) -> Listed:
        """The signatures that were kept under a digest; `OWN` for those that shapes were put with."""

    def keep(self, digest: str, signatures: Collection[tuple[Record, bytes]]) -> None:
        """Keep signatures, except those of shapes that were replaced or removed since.

        Parameters
        ----------
        digest : str
            What the signatures are kept under.
        signatures : collection of (Record, bytes)
            The bytes of each signature, and the record that it was computed by: a shape was replaced if its
            content hash is another one.
        """
