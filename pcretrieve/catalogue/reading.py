"""Reading of the shapes of a store: records by id and by content, meshes and spectra."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np

from pcretrieve.catalogue.arrays import unpacked, unpacked_values
from pcretrieve.catalogue.opening import intact
from pcretrieve.catalogue.record import Record
from pcretrieve.catalogue.rows import OWN, Origin, Rows, Status
from pcretrieve.catalogue.settings import settings_of, stored_options
from pcretrieve.catalogue.stores import open_rows
from pcretrieve.catalogue.surfaces import read_shape, suggested_id, unknown
from pcretrieve.errors import ShapeError
from pcretrieve.options import PipelineOptions
from pcretrieve.values import FloatArray, Need, Shape, TriangleMesh

__all__ = ["StoredShapes", "stored_shapes"]

# Number of records that are read at a time.
PAGE = 1000


class StoredShapes:
    """The shapes of a store, with the operations of a catalogue that only read."""

    def __init__(self, rows: Rows, options: PipelineOptions) -> None:
        self._rows = rows
        self.location, self.options = rows.location, options

    def __len__(self) -> int:
        return self._rows.count("done")

    def pages(
        self,
        *,
        status: Status | None = None,
        doubtful: bool = False,
        offset: int = 0,
        limit: int | None = None,
    ) -> Iterator[list[Record]]:
        """The records, including failed ones, in ascending order of id, in pages that are read one by one."""
        after, left = "", limit
        while left is None or left > 0:
            size = PAGE if left is None else min(PAGE, left)
            page = self._rows.page(after=after, offset=offset, limit=size, status=status, doubtful=doubtful)
            if page:
                yield page
            if len(page) < size:
                return
            after, offset = page[-1].id, 0
            left = None if left is None else left - size

    def records(self, *, status: Status | None = None) -> list[Record]:
        """All records, or those of one status, in ascending order of id."""
        return [record for page in self.pages(status=status) for record in page]

    def origins(self) -> list[Origin]:
        """The id, the file, the class and the status of every shape, in ascending order of id."""
        return self._rows.origins()

    def times(self) -> dict[str, str]:
        """When each shape, or its failure, was stored, by id: UTC, as 2026-01-31T12:00:00+00:00."""
        return self._rows.times()

    def outlines(self) -> list[Record]:
        """All records as `origins` has them, without their provenance, which are read much faster."""
        return [
            Record(row.id, row.path, row.content_hash, row.label, row.status, stamp=row.stamp)
            for row in self._rows.origins()
        ]

    def several(self, shape_ids: Collection[str]) -> list[Record]:
        """The records of some ids, in ascending order of id; unknown ids are ignored."""
        return self._rows.by_id(shape_ids)

    def record(self, shape_id: str) -> Record:
        """The record of a shape; InputError if there is no shape of this id."""
        record = self.get(shape_id)
        if record is None:
            raise unknown(self._rows, shape_id)
        return record

    def get(self, shape_id: str) -> Record | None:
        """The record of a shape; None if there is no shape of this id."""
        return next(iter(self._rows.by_id([shape_id])), None)

    def suggested(self, shape_id: str) -> str:
        """The question whether the id of another shape was meant; empty if no id is similar."""
        return suggested_id(self._rows, shape_id)

    def labelled(self, labels: Collection[str]) -> list[str]:
        """The ids of the shapes of some classes that did not fail, in ascending order."""
        return self._rows.labelled(labels)

    def with_content(self, content_hash: str) -> list[Record]:
        """The records of files with this content, including failed ones, in ascending order of id."""
        return self._rows.by_content([content_hash])

    def failures(self) -> dict[tuple[str, str], int]:
        """The number of failed shapes by stage and kind of error: `Record.stage` and `Record.error`."""
        return self._rows.failures()

    def areas(self) -> dict[float | None, tuple[float, float]]:
        """The smallest and the largest area of a shape, by `Record.metres_per_unit`."""
        return self._rows.areas()

    def stored_bytes(self, shape_id: str) -> dict[str, int]:
        """The sizes in bytes of a shape's record, signatures and arrays; InputError if there is no shape."""
        self.record(shape_id)
        return self._rows.sizes(shape_id)

    def mesh(self, shape_id: str) -> TriangleMesh:
        """The mesh of a shape's first surface, unit length of the file; ShapeError if it was not stored."""
        shape = self.shape(shape_id, needs=("mesh",))
        try:
            return shape.mesh
        except ShapeError as error:
            error.shape_id = shape_id
            raise

    def thumbnail(self, shape_id: str) -> bytes | None:
        """The picture of a shape that was stored with it."""
        found = self._rows.read(shape_id, ["thumbnails"])
        if found is None:
            raise unknown(self._rows, shape_id)
        stored = found[1].get("thumbnails")
        with intact(self.location, f"the thumbnail of {shape_id!r}"):
            return None if stored is None else unpacked(stored)[0].tobytes()

    def signature(self, shape_id: str) -> FloatArray:
        """The signature of a shape by the options of the catalogue.

        Returns (L,) float64: the values, as they are stored.
        """
        for entry in self._rows.entries([shape_id]):
            if OWN in entry.signatures:
                value = np.frombuffer(entry.signatures[OWN], np.uint8)
                with intact(self.location, f"the signature of {shape_id!r}"):
                    values: FloatArray = unpacked_values(value[np.newaxis], len(value) // 8 - 1)[0]
                    return values
        raise unknown(self._rows, shape_id)

    def shape(self, shape_id: str, needs: tuple[Need, ...] = ("spectrum", "mesh")) -> Shape:
        """Read a shape with some of its parts."""
        return read_shape(self._rows, self.options, shape_id, needs)[1]


@contextmanager
def stored_shapes(location: str | Path) -> Iterator[StoredShapes]:
    """Open the records and meshes of a catalogue, also of a version with other numerical results."""
    with closing(open_rows(location, settings_of(PipelineOptions()), create=False)) as rows:
        yield StoredShapes(rows, stored_options(rows.location, rows.settings(), any_numbers=True))
