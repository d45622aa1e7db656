"""Reading of the shapes of a store: records by id and by content, meshes and spectra."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from pcretrieve.catalogue.record import Record
from pcretrieve.catalogue.rows import Rows, Status
from pcretrieve.catalogue.surfaces import read_shape, unknown
from pcretrieve.errors import ShapeError
from pcretrieve.options import PipelineOptions
from pcretrieve.types import Need, Shape, TriangleMesh

__all__ = ["StoredShapes"]

# Number of records that are read at a time.
PAGE = 1000


class StoredShapes:
    """The shapes of a store, with the operations of a catalogue that only read.

    Parameters
    ----------
    rows : Rows
        The store.
    options : PipelineOptions
        The options with which the catalogue was built.

    Attributes
    ----------
    location : str
        The path or the URL of the store, as messages name it.
    options : PipelineOptions
        The options with which the catalogue was built.
    """

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
        """The records, including failed ones, in ascending order of id, in pages that are read one by one.

        Parameters
        ----------
        status : {"done", "failed"}, optional
            Only records of this status.
        doubtful : bool, default False
            Only records whose verdict is "doubtful" or "unusable".
        offset : int, default 0
            Number of records that are left out at the beginning.
        limit : int, optional
            Largest number of records in all pages together.

        Yields
        ------
        list of Record
            A page of at least one record.
        """
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

    def record(self, shape_id: str) -> Record:
        """The record of a shape; InputError if there is no shape of this id."""
        record = self.get(shape_id)
        if record is None:
            raise unknown(self._rows, shape_id)
        return record

    def get(self, shape_id: str) -> Record | None:
        """The record of a shape; None if there is no shape of this id."""
        return next(iter(self._rows.by_id([shape_id])), None)

    def labelled(self, labels: Collection[str]) -> list[str]:
        """The ids of the shapes of some classes that did not fail, in ascending order."""
        return self._rows.labelled(labels)

    def with_content(self, content_hash: str) -> list[Record]:
        """The records of files with this content, including failed ones, in ascending order of id."""
        return self._rows.by_content([content_hash])

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

    def shape(self, shape_id: str, needs: tuple[Need, ...] = ("spectrum", "mesh")) -> Shape:
        """Read a shape with some of its parts.

        Parameters
        ----------
        shape_id : str
            The id of a shape that did not fail.
        needs : tuple of {"spectrum", "overlaps", "eigenvectors", "mesh", "points"}
            The parts, as in `pcretrieve.descriptors.Descriptor`. Overlaps that were not stored are computed
            from the mesh. For eigenvectors the mesh is read, from which `describe` computes them. Points are
            never stored.

        Returns
        -------
        Shape
            The shape with these parts, except those that were not stored and cannot be computed.

        Raises
        ------
        InputError
            If there is no shape of this id, or the shape failed.
        CatalogueError
            If the stored arrays are damaged.
        """
        return read_shape(self._rows, self.options, shape_id, needs)[1]
