"""The durable store: one file, one row a shape, readable while it is being written."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from types import TracebackType

from pcretrieve.catalogue.arrays import packed_values
from pcretrieve.catalogue.gallery import Gallery
from pcretrieve.catalogue.record import Content, Record, completed
from pcretrieve.catalogue.rows import Revision, Rows, Status
from pcretrieve.catalogue.settings import fitting_options, settings_of, stored_options
from pcretrieve.catalogue.sqlite import SqliteRows
from pcretrieve.catalogue.surfaces import payloads_of, read_shape, unknown
from pcretrieve.catalogue.tables import digest_of, made_index, resolution_of, signature_table
from pcretrieve.errors import ShapeError
from pcretrieve.options import PipelineOptions
from pcretrieve.retrieval import DISTANCES, SignatureIndex, Whitening, table_whitening
from pcretrieve.types import Need, Shape, SignatureTable, TriangleMesh

__all__ = ["Catalogue"]

# Records that are read at a time where all are wanted.
PAGE = 1000


class Catalogue:
    """Shapes with their provenance, spectra, signatures and clean meshes.

    Parameters
    ----------
    path : str or Path
    options : PipelineOptions, optional
        What the catalogue is, or must have been, built with. Without it, an existing catalogue is opened
        with its own options and a new one gets the defaults.
    create : bool, default False
        Make the file where there is none.

    Raises
    ------
    CatalogueError
        If there is no such file and `create` is false; if it is a folder, no catalogue, or written by a
        newer pcretrieve; if it was built with other options (the message names the difference); if another
        process keeps it locked.

    Examples
    --------
    >>> with Catalogue("people.sqlite") as catalogue:          # doctest: +SKIP
    ...     options = catalogue.options.changed(retrieval={"whitening": "within-class"})
    ...     neighbors = catalogue.index(options).nearest("anna-sits", k=5)
    """

    def __init__(
        self, path: str | Path, options: PipelineOptions | None = None, *, create: bool = False
    ) -> None:
        self.path = Path(path)
        self._rows: Rows = SqliteRows(self.path, settings_of(options or PipelineOptions()), create=create)
        self._gallery = Gallery(self.path)
        try:
            self.options = stored_options(self.path, self._rows.settings(), options)
        except BaseException:
            self._rows.close()
            raise

    def __enter__(self) -> Catalogue:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._rows.close()

    def __len__(self) -> int:
        return self._rows.count("done")

    # --- writing --------------------------------------------------------------------------------------

    def put(self, record: Record, content: Content | None = None) -> Record:
        """Store a shape under its path, in one transaction.

        The id is given out here, because other processes may have stored shapes since `record` was made: a
        path that the catalogue holds keeps its id, and an id that belongs to another path gets the next free
        number. A failure never takes the place of a finished shape.

        Parameters
        ----------
        record : Record
        content : Content, optional
            None for a shape that failed.

        Returns
        -------
        Record
            What the catalogue holds of that path now.
        """
        record = completed(record, content, self.options.digest)
        if content is None:
            return self._rows.put(record, None, {})
        return self._rows.put(
            record, packed_values(content.signature), payloads_of(content.shape, self.options)
        )

    def remove(self, *shape_ids: str) -> None:
        """Forget shapes, all of them or none.

        Raises
        ------
        InputError
            If there is none of one of the ids.
        """
        for shape_id in shape_ids:
            self.record(shape_id)
        self._rows.remove(shape_ids)

    def revise(
        self,
        *,
        moved: Mapping[str, str] | None = None,
        removed: Collection[str] = (),
        labels: Mapping[str, str] | None = None,
    ) -> None:
        """Rename, forget and label shapes by path, in one transaction.

        Paths that the catalogue does not hold are ignored: another process may have renamed or removed the
        same shapes a moment ago.

        Parameters
        ----------
        moved : mapping of path to path, optional
            New path of a file by its old one. Where the catalogue holds the new path, nothing is renamed.
        removed : collection of str, optional
            Paths of shapes to forget.
        labels : mapping of path to class, optional
            By the new path where a file was renamed.
        """
        self._rows.revise(moved=moved or {}, removed=removed, labels=labels or {})

    # --- reading --------------------------------------------------------------------------------------

    def pages(
        self, *, status: Status | None = None, offset: int = 0, limit: int | None = None
    ) -> Iterator[list[Record]]:
        """The records, failed ones included, in ascending order of id; a page is read when it is asked for.

        Parameters
        ----------
        status : {"done", "failed"}, optional
            Only records of this status.
        offset : int, default 0
            Records that are left out at the beginning.
        limit : int, optional
            Records in all pages together.
        """
        after, left = "", limit
        while left is None or left > 0:
            size = PAGE if left is None else min(PAGE, left)
            page = self._rows.page(after=after, offset=offset, limit=size, status=status)
            if page:
                yield page
            if len(page) < size:
                return
            after, offset = page[-1].id, 0
            left = None if left is None else left - size

    def records(self, *, status: Status | None = None) -> list[Record]:
        """Every shape, failed ones included, in ascending order of id."""
        return [record for page in self.pages(status=status) for record in page]

    def record(self, shape_id: str) -> Record:
        """One shape.

        Raises
        ------
        InputError
            If there is none of that id.
        """
        record = self.get(shape_id)
        if record is None:
            raise unknown(self.path, shape_id)
        return record

    def get(self, shape_id: str) -> Record | None:
        """One shape, or None if there is none of that id."""
        return next(iter(self._rows.by_id([shape_id])), None)

    def with_content(self, content_hash: str) -> list[Record]:
        """The shapes of files with a content, failed ones included, in ascending order of id."""
        return self._rows.by_content([content_hash])

    def areas(self) -> tuple[float, float] | None:
        """The smallest and the largest area of a shape, unit length² of the files; None if it is empty."""
        return self._rows.areas()

    def stored_bytes(self, shape_id: str) -> dict[str, int]:
        """What is stored of a shape: bytes of its record, of its signatures, and of its arrays by name.

        Raises
        ------
        InputError
            If there is none of that id.
        """
        self.record(shape_id)
        return self._rows.sizes(shape_id)

    def mesh(self, shape_id: str) -> TriangleMesh:
        """The clean mesh of a shape, in the unit of its file.

        Parameters
        ----------
        shape_id : str
            The id of the shape.

        Returns
        -------
        TriangleMesh
            That of the first surface.

        Raises
        ------
        InputError
            If there is no shape of that id, or it failed.
        ShapeError
            If the meshes were left out when the shape was stored.
        """
        shape = self.shape(shape_id, needs=("mesh",))
        try:
            return shape.mesh
        except ShapeError as error:
            error.shape_id = shape_id
            raise

    def shape(self, shape_id: str, needs: tuple[Need, ...] = ("spectrum", "mesh")) -> Shape:
        """A shape, with the parts that are asked for and no others.

        Parameters
        ----------
        shape_id : str
        needs : tuple of {"spectrum", "overlaps", "eigenvectors", "mesh", "points"}
            What a descriptor needs. Overlaps that were not stored are computed from the mesh. For
            eigenvectors the mesh is read, from which `describe` computes them. The points are not stored.

        Raises
        ------
        InputError
            If there is no shape of that id, or it failed.
        """
        return read_shape(self._rows, self.path, self.options, shape_id, needs)[1]

    def signatures(self, options: PipelineOptions | None = None) -> SignatureTable:
        """The signatures by which all shapes that did not fail are compared, by id.

        Parameters
        ----------
        options : PipelineOptions, optional
            With a descriptor other than the catalogue's own, as ``catalogue.options.changed(signature=...)``.
            Such signatures are computed from what is stored when they are asked for the first time, and kept.

        Raises
        ------
        CatalogueError
            If `options` are for other spectra than those of the catalogue.
        """
        options = self._fitting(options)
        return signature_table(self._rows, self.path, self.options, options)

    def index(self, options: PipelineOptions | None = None) -> SignatureIndex:
        """The index of this catalogue's signatures that options ask for.

        Of a large catalogue it is kept in a folder beside the file, or in the user's cache folder, and opened
        from there until shapes or labels change.

        Parameters
        ----------
        options : PipelineOptions, optional
            As in `signatures`: ``catalogue.options.changed(retrieval={"whitening": "pca"})``.

        Raises
        ------
        CatalogueError
            If `options` are for other spectra than those of the catalogue.
        InputError
            If the catalogue holds no shapes, or too few for the whitening.
        """
        options = self._fitting(options)
        retrieval = options.retrieval
        distance = retrieval.distance + DISTANCES.version(retrieval.distance)
        request = f"{digest_of(options)} {distance} {retrieval.whitening} {retrieval.damping}"

        def make() -> tuple[SignatureIndex, Revision]:
            return made_index(self._rows, self.path, self.options, options)

        by_label = retrieval.whitening == "within-class"
        return self._gallery.index(request, self._rows.revision(), make, by_label=by_label)

    def whitening(self, options: PipelineOptions | None = None) -> Whitening:
        """The whitening of this catalogue's signatures that options ask for.

        ``pca`` and ``within-class`` are fitted on the shapes that it holds now.

        Parameters
        ----------
        options : PipelineOptions, optional
            As in `signatures`: ``catalogue.options.changed(retrieval={"whitening": "pca"})``.

        Raises
        ------
        CatalogueError
            If `options` are for other spectra than those of the catalogue.
        """
        options = self._fitting(options)
        if options.retrieval.whitening in ("none", "resolution"):
            return table_whitening(self.signatures(options), options.retrieval, resolution_of(options))
        return self.index(options).whitening

    def _fitting(self, options: PipelineOptions | None) -> PipelineOptions:
        """The options of a request, once they have been seen to be for the spectra that are stored."""
        return self.options if options is None else fitting_options(self.path, self.options, options)
