"""The protocol of stores, which hold the rows of a catalogue.

A store has records, and bytes by name, whose meaning only `pcretrieve.catalogue.Catalogue` knows. Each
operation is one transaction: it is atomic, and isolated from operations of other processes.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from pcretrieve.catalogue.defects import Defect
from pcretrieve.catalogue.record import Record

__all__ = ["OWN", "PAYLOADS", "Entry", "Listed", "Origin", "Payload", "Revision", "Rows", "Status"]

#: The parts that are stored of a shape besides its record and its signatures; each can be read separately.
Payload = Literal["spectra", "moments", "overlaps", "meshes", "thumbnails"]
PAYLOADS: tuple[Payload, ...] = ("spectra", "moments", "overlaps", "meshes", "thumbnails")

Status = Literal["done", "failed"]

#: The digest under which the signatures by the options of the catalogue are stored.
OWN = "own"


@dataclass(frozen=True, slots=True)
class Revision:
    """Names of a state of a store. Two states have the same names only if they have the same shapes."""

    shapes: str
    labels: str

    def state(self) -> str:
        """A name of the state of the shapes and their labels."""
        return f"{self.shapes} {self.labels}"


@dataclass(frozen=True, slots=True, eq=False)
class Listed:
    """Signatures of all shapes that did not fail, in one state of the store.

    ids: identifiers of the shapes, in ascending order.
    packed: (N, b) uint8, the bytes of each signature, in the order of the ids. The caller may overwrite the
        array.
    has: (N,) bool, whether a signature by these options is stored. The bytes of signatures that are not
        stored are zero.
    """

    revision: Revision
    ids: list[str]
    labels: list[str | None]
    packed: NDArray[np.uint8]
    has: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Origin:
    """Of which file a row is, without its provenance."""

    id: str
    path: str
    content_hash: str
    label: str | None
    status: Status
    stamp: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """Everything that a store has of one shape."""

    record: Record
    signatures: Mapping[str, bytes]
    payloads: Mapping[Payload, bytes]


class Rows(Protocol):
    """The operations of a store.

    ``tests/catalogue/test_rows.py`` tests that stores satisfy this protocol.
    """

    @property
    def location(self) -> str:
        """The path of a file, or a URL without a password, as messages name the store."""

    @property
    def folder(self) -> Path | None:
        """A folder for indexes; None if they must be stored in the cache folder of the user."""

    @property
    def is_writable(self) -> bool:
        """Whether the store can be written to."""

    def close(self) -> None:
        """Release the store."""

    def defects(self, *, repair: bool) -> list[Defect]:
        """Defects of the database and rows of no shape; not those of single shapes."""

    def settings(self) -> Mapping[str, str]:
        """The settings with which the store was created: ``options``, as JSON, and ``numbers_version``."""

    def revision(self) -> Revision:
        """The present state of the store."""

    def count(self, status: Status) -> int:
        """The number of shapes with a status."""

    def failures(self) -> dict[tuple[str, str], int]:
        """The number of failed shapes by stage and kind of error: `Record.stage` and `Record.error`."""

    def areas(self) -> dict[float | None, tuple[float, float]]:
        """The smallest and the largest area of the shapes that did not fail, by `Record.metres_per_unit`."""

    def page(
        self,
        *,
        after: str = "",
        offset: int = 0,
        limit: int,
        status: Status | None = None,
        doubtful: bool = False,
    ) -> list[Record]:
        """Some records in ascending order of id."""

    def by_id(self, shape_ids: Collection[str]) -> list[Record]:
        """The records of some ids, in ascending order of id; ids that the store does not have are ignored."""

    def by_content(self, hashes: Collection[str]) -> list[Record]:
        """The records of some content hashes, by id; several files may have the same content."""

    def origins(self) -> list[Origin]:
        """The origins of all shapes, including failed ones, in ascending order of id."""

    def times(self) -> dict[str, str]:
        """When each shape, or its failure, was stored, by id: UTC, as 2026-01-31T12:00:00+00:00."""

    def labelled(self, labels: Collection[str]) -> list[str]:
        """The ids of the shapes of some classes that did not fail, in ascending order."""

    def put(self, record: Record, signature: bytes | None, payloads: Mapping[Payload, bytes]) -> Record:
        """Store a shape by its path, and replace an earlier shape of this path.

        A path that the store has keeps its id; an id that belongs to another path is replaced by one with the
        next free number, from `pcretrieve.catalogue.free_id`. A failure never replaces a finished shape.
        """

    def entries(self, shape_ids: Collection[str]) -> list[Entry]:
        """Everything that is stored of some shapes, in one state of the store, in ascending order of id."""

    def add(self, entries: Collection[Entry]) -> None:
        """Store shapes as they are, and replace earlier shapes of the same paths."""

    def remove(self, shape_ids: Collection[str]) -> None:
        """Remove shapes; ids that the store does not have are ignored."""

    def revise(
        self,
        *,
        moved: Mapping[str, str],
        removed: Collection[str],
        labels: Mapping[str, str | None],
        stamps: Mapping[str, str],
    ) -> None:
        """Rename, remove, label and stamp shapes by path, in this order; unknown paths are ignored."""

    def read(self, shape_id: str, names: Collection[Payload]) -> tuple[Record, dict[Payload, bytes]] | None:
        """A record and some payloads, in one state of the store.

        Returns (Record, dict of str to bytes) or None: the record, and those of the payloads that are stored;
            None if there is no shape of this id.
        """

    def sizes(self, shape_id: str) -> dict[str, int]:
        """The number of bytes of each payload of a shape, of its ``signatures``, and of its ``record``."""

    def signatures(self, digest: str) -> Listed:
        """The signatures that are stored under a digest; `OWN` for the signatures given to `put`."""

    def keep(self, digest: str, signatures: Collection[tuple[Record, bytes]]) -> None:
        """Store signatures, except of shapes that have been replaced or removed since they were read.

        signatures: collection of (Record, bytes), the bytes of each signature, and the record of the shape of
            which it was computed. A shape has been replaced if the content hash of its record has changed.
        """

    def keep_payload(self, name: Payload, record: Record, arrays: bytes) -> None:
        """Store a payload of a shape, unless the shape has been replaced or removed since it was read."""
