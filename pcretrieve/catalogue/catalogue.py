"""The catalogue: shapes with provenance, spectra, surfaces and signatures, in a file or a database."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import TypeAlias

import numpy as np

from pcretrieve.catalogue.arrays import (
    intact,
    packed,
    packed_values,
    payloads_of,
    read_shape,
    suggested_id,
    unknown,
    unpacked,
    unpacked_values,
)
from pcretrieve.catalogue.cache import IndexCache
from pcretrieve.catalogue.records import OWN, Content, Origin, Record, Status, completed
from pcretrieve.catalogue.rows import Rows
from pcretrieve.catalogue.settings import fitting_options, settings_of, stored_options
from pcretrieve.catalogue.signatures import index_name, made_before, made_index, signature_table
from pcretrieve.errors import CatalogueError, ShapeError
from pcretrieve.options import PipelineOptions
from pcretrieve.retrieval import SignatureIndex, Whitening
from pcretrieve.values import FloatArray, Need, Shape, SignatureTable, TriangleMesh

# Number of records that are read at a time.
PAGE = 1000


class Catalogue:
    """Shapes with their provenance, spectra, signatures and meshes.

    Parameters
    ----------
    location : str or Path
        The path of an SQLite file; or, as str, the URL of a PostgreSQL database.
    options : PipelineOptions, optional
        The options with which a new catalogue is built, or an existing one must have been built. By default
        the options of an existing catalogue, or the default options for a new one.
    create : bool, default False
        Whether the catalogue is created if it does not exist.
    any_numbers : bool, default False
        Whether a catalogue of a version with other numerical results is opened too, to list, show and export
        its shapes.

    Attributes
    ----------
    location : str
        The path or the URL, as messages name it.
    options : PipelineOptions
        The options with which the catalogue was built.

    Raises
    ------
    CatalogueError
        If the catalogue does not exist and `create` is false; if the path is a folder or another file; if the
        catalogue was written by an older or a newer pcretrieve, or was built with other options (the message
        names the difference); if another process has locked it.
    OptionError
        If the scheme of the URL is not that of PostgreSQL.

    Examples
    --------
    >>> with Catalogue("people.sqlite") as catalogue:          # doctest: +SKIP
    ...     options = catalogue.options.changed(retrieval={"whitening": "within-class"})
    ...     neighbors = catalogue.index(options).nearest("anna-sits", k=5)
    """

    def __init__(
        self,
        location: str | Path,
        options: PipelineOptions | None = None,
        *,
        create: bool = False,
        any_numbers: bool = False,
    ) -> None:
        self.rows = Rows(location, settings_of(options or PipelineOptions()), create=create)
        self.location: str = self.rows.location
        try:
            self.options = stored_options(
                self.location, self.rows.settings(), options, any_numbers=any_numbers
            )
        except BaseException:
            self.close()
            raise
        self.cache = IndexCache(self.location, self.rows.database.folder)

    def __enter__(self) -> Catalogue:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file or the connection."""
        self.rows.close()

    # --- records ----------------------------------------------------------------------------------------

    def __len__(self) -> int:
        return self.rows.count("done")

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
            page = self.rows.page(after=after, offset=offset, limit=size, status=status, doubtful=doubtful)
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
        return self.rows.origins()

    def outlines(self) -> list[Record]:
        """All records as `origins` has them, without their provenance, which are read much faster."""
        return [
            Record(row.id, row.path, row.content_hash, row.label, row.status, stamp=row.stamp)
            for row in self.origins()
        ]

    def times(self) -> dict[str, str]:
        """When each shape, or its failure, was stored, by id: UTC, as 2026-01-31T12:00:00+00:00."""
        return self.rows.times()

    def several(self, shape_ids: Collection[str]) -> list[Record]:
        """The records of some ids, in ascending order of id; unknown ids are ignored."""
        return self.rows.by("id", shape_ids)

    def get(self, shape_id: str) -> Record | None:
        """The record of a shape; None if there is no shape of this id."""
        return next(iter(self.several([shape_id])), None)

    def record(self, shape_id: str) -> Record:
        """The record of a shape; InputError if there is no shape of this id."""
        record = self.get(shape_id)
        if record is None:
            raise unknown(self.rows, shape_id)
        return record

    def suggested(self, shape_id: str) -> str:
        """The question whether the id of another shape was meant; empty if no id is similar."""
        return suggested_id(self.rows, shape_id)

    def labelled(self, labels: Collection[str]) -> list[str]:
        """The ids of the shapes of some classes that did not fail, in ascending order."""
        return self.rows.labelled(labels)

    def with_content(self, content_hash: str) -> list[Record]:
        """The records of files with this content, including failed ones, in ascending order of id."""
        return self.rows.by("content_hash", [content_hash])

    def failures(self) -> dict[tuple[str, str], int]:
        """The number of failed shapes by stage and kind of error: `Record.stage` and `Record.error`."""
        return self.rows.failures()

    def areas(self) -> dict[float | None, tuple[float, float]]:
        """The smallest and the largest area of a shape, by `Record.metres_per_unit`."""
        return self.rows.areas()

    # --- shapes -----------------------------------------------------------------------------------------

    def shape(self, shape_id: str, needs: tuple[Need, ...] = ("spectrum", "mesh")) -> Shape:
        """Read a shape with some of its parts."""
        return read_shape(self.rows, self.options, shape_id, needs)[1]

    def mesh(self, shape_id: str) -> TriangleMesh:
        """The mesh of a shape's first surface, unit length of the file; ShapeError if it was not stored."""
        shape = self.shape(shape_id, needs=("mesh",))
        try:
            return shape.mesh
        except ShapeError as error:
            error.shape_id = shape_id
            raise

    def thumbnail(self, shape_id: str) -> bytes | None:
        """The picture of a shape that was stored with it, a PNG file."""
        found = self.rows.read(shape_id, ["thumbnails"])
        if found is None:
            raise unknown(self.rows, shape_id)
        stored = found[1].get("thumbnails")
        with intact(self.location, f"the thumbnail of {shape_id!r}"):
            return None if stored is None else unpacked(stored)[0].tobytes()

    def signature(self, shape_id: str) -> FloatArray:
        """The signature (L,) of a shape by the options of the catalogue, as it is stored."""
        for entry in self.rows.entries([shape_id]):
            if OWN in entry.signatures:
                value = np.frombuffer(entry.signatures[OWN], np.uint8)
                with intact(self.location, f"the signature of {shape_id!r}"):
                    values: FloatArray = unpacked_values(value[np.newaxis], len(value) // 8 - 1)[0]
                    return values
        raise unknown(self.rows, shape_id)

    def stored_bytes(self, shape_id: str) -> dict[str, int]:
        """The sizes in bytes of a shape's record, signatures and arrays; InputError if there is no shape."""
        self.record(shape_id)
        return self.rows.sizes(shape_id)

    # --- changes ----------------------------------------------------------------------------------------

    def put(self, record: Record, content: Content | None = None) -> Record:
        """Store a shape by its path, in one transaction.

        The id is assigned in this transaction, because other processes may have stored shapes since `record`
        was made: a path that the catalogue has keeps its id, and an id that belongs to another path gets the
        next free number. A failure never replaces a finished shape.

        Parameters
        ----------
        record : Record
            Path, content hash, label and provenance of the shape.
        content : Content, optional
            The shape and its signature; None for a shape that failed.

        Returns
        -------
        Record
            The record that the catalogue now has for this path.
        """
        record = completed(record, content, self.options.digest)
        if content is None:
            return self.rows.put(record, None, {})
        payloads = payloads_of(content.shape, self.options)
        if content.thumbnail is not None:
            payloads["thumbnails"] = packed([np.frombuffer(content.thumbnail, np.uint8)])
        return self.rows.put(record, packed_values(content.signature), payloads)

    def keep_thumbnail(self, record: Record, picture: bytes) -> bool:
        """Store the picture of a shape, a PNG file, in the place of an earlier one.

        Returns bool: whether it could be written. No error is raised, because a picture can be drawn again.
        """
        if not self.rows.database.is_writable:
            return False
        try:
            self.rows.keep_payload("thumbnails", record, packed([np.frombuffer(picture, np.uint8)]))
        except CatalogueError:  # another process has locked it, or the disk is full
            return False
        return True

    def remove(self, *shape_ids: str) -> None:
        """Remove shapes; InputError, without a change, if one of the ids does not exist."""
        for shape_id in shape_ids:
            self.record(shape_id)
        self.rows.remove(shape_ids)

    def revise(
        self,
        *,
        moved: Mapping[str, str] | None = None,
        removed: Collection[str] = (),
        labels: Mapping[str, str] | None = None,
        stamps: Mapping[str, str] | None = None,
    ) -> None:
        """Rename, remove, label and stamp shapes by path, in one transaction.

        Unknown paths are ignored, because another process may have renamed or removed the same shapes.

        Parameters
        ----------
        moved : mapping of str to str, optional
            New path by old path. If the catalogue has the new path already, nothing is renamed.
        removed : collection of str, optional
            Paths of the shapes that are removed.
        labels : mapping of str to str, optional
            Class by path; by the new path, if a file was renamed.
        stamps : mapping of str to str, optional
            `Record.stamp` by path; by the new path, if a file was renamed.
        """
        self.rows.revise(moved=moved, removed=removed, labels=labels, stamps=stamps)

    # --- signatures -------------------------------------------------------------------------------------

    def signatures(self, options: PipelineOptions | None = None) -> SignatureTable:
        """The signatures of all shapes that did not fail.

        Parameters
        ----------
        options : PipelineOptions, optional
            Options, which may have another descriptor than the options of the catalogue, from
            ``catalogue.options.changed(signature=...)``. Signatures that are not stored are computed from the
            stored spectra and surfaces, and stored.

        Returns
        -------
        SignatureTable
            The signatures in ascending order of id, with the classes of the shapes.

        Raises
        ------
        CatalogueError
            If `options` require other spectra than the catalogue has.
        ShapeError
            If a part of a shape that the descriptor needs was not stored.
        """
        return signature_table(self.rows, self.options, self._fitting(options))

    def index(self, options: PipelineOptions | None = None) -> SignatureIndex:
        """The index of the signatures of the catalogue, with the whitening of the options.

        The index of a large catalogue is stored in a folder beside the file, or in the cache folder of the
        user, and opened from there until shapes or labels change.

        Parameters
        ----------
        options : PipelineOptions, optional
            As in `signatures`: ``catalogue.options.changed(retrieval={"whitening": "pca"})``.

        Returns
        -------
        SignatureIndex
            The index.

        Raises
        ------
        CatalogueError
            If `options` require other spectra than the catalogue has.
        InputError
            If the catalogue has no shapes, or too few for the whitening.
        """
        options = self._fitting(options)
        return self.cache.index(
            index_name(options),
            self.rows.revision(),
            lambda: made_index(self.rows, self.options, options),
        )

    def whitening(self, options: PipelineOptions | None = None) -> Whitening:
        """The whitening of the signatures of the catalogue, an affine map of log-signatures.

        The whitenings ``neighbours``, ``pca`` and ``within-class`` are fitted to the present shapes of the
        catalogue. Options and errors are those of `index`.
        """
        options = self._fitting(options)
        return made_before(options) or self.index(options).whitening

    def _fitting(self, options: PipelineOptions | None) -> PipelineOptions:
        """The options of a request, after a check that they need no other spectra than the stored ones."""
        return fitting_options(self.location, self.options, options or self.options)


#: A catalogue, or its path or URL.
CatalogueLike: TypeAlias = "Catalogue | str | Path"


@contextmanager
def opened(
    catalogue: CatalogueLike, options: PipelineOptions | None = None, *, create: bool = False
) -> Iterator[Catalogue]:
    """Open a catalogue that is given by its path, and close it at the end; leave others as they are."""
    if isinstance(catalogue, Catalogue):
        yield catalogue
    else:
        with Catalogue(catalogue, options, create=create) as store:
            yield store


def stored_shapes(location: str | Path) -> Catalogue:
    """Open a catalogue to list, show and export its shapes, also one with other numerical results."""
    return Catalogue(location, any_numbers=True)


def stored_records(catalogue: CatalogueLike, options: PipelineOptions | None = None) -> list[Record]:
    """The records in ascending order of id; none of a file that does not exist, which is not made."""
    if not isinstance(catalogue, Catalogue) and "://" not in str(catalogue) and not Path(catalogue).exists():
        return []
    with opened(catalogue, options) as store:
        return store.records()
