"""The catalogue: shapes with provenance, spectra, meshes and signatures, in a store."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from types import TracebackType

import numpy as np

from pcretrieve.catalogue.arrays import packed, packed_values
from pcretrieve.catalogue.checking import check_rows, set_to_be_ingested_again
from pcretrieve.catalogue.defects import Defect
from pcretrieve.catalogue.gallery import Gallery
from pcretrieve.catalogue.merging import Merged, merge_rows
from pcretrieve.catalogue.reading import StoredShapes
from pcretrieve.catalogue.record import Content, Record, completed
from pcretrieve.catalogue.rows import Origin
from pcretrieve.catalogue.settings import fitting_options, settings_of, stored_options
from pcretrieve.catalogue.stores import open_rows
from pcretrieve.catalogue.surfaces import payloads_of
from pcretrieve.catalogue.tables import index_name, made_before, made_index, signature_table
from pcretrieve.errors import CatalogueError
from pcretrieve.options import PipelineOptions
from pcretrieve.retrieval import SignatureIndex, Whitening
from pcretrieve.values import SignatureTable

__all__ = ["Catalogue"]


class Catalogue(StoredShapes):
    """Shapes with their provenance, spectra, signatures and meshes.

    Parameters
    ----------
    location : str or Path
        The path of an SQLite file; or, as str, a URL whose scheme is the name of a store of another package.
    options : PipelineOptions, optional
        The options with which a new catalogue is built, or an existing one must have been built. By default
        the options of an existing catalogue, or the default options for a new one.
    create : bool, default False
        Whether the catalogue is created if it does not exist.

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
        catalogue was written by a newer pcretrieve, or was built with other options (the message names the
        difference); if another process has locked it.
    OptionError
        If there is no store with the scheme of the URL.

    Examples
    --------
    >>> with Catalogue("people.sqlite") as catalogue:          # doctest: +SKIP
    ...     options = catalogue.options.changed(retrieval={"whitening": "within-class"})
    ...     neighbors = catalogue.index(options).nearest("anna-sits", k=5)
    """

    def __init__(
        self, location: str | Path, options: PipelineOptions | None = None, *, create: bool = False
    ) -> None:
        rows = open_rows(location, settings_of(options or PipelineOptions()), create=create)
        try:
            super().__init__(rows, stored_options(rows.location, rows.settings(), options))
        except BaseException:
            rows.close()
            raise
        self._gallery = Gallery(rows.location, rows.folder)

    def __enter__(self) -> Catalogue:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the store."""
        self._rows.close()

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
            return self._rows.put(record, None, {})
        payloads = payloads_of(content.shape, self.options)
        if content.thumbnail is not None:
            payloads["thumbnails"] = packed([np.frombuffer(content.thumbnail, np.uint8)])
        return self._rows.put(record, packed_values(content.signature), payloads)

    def keep_thumbnail(self, record: Record, picture: bytes) -> bool:
        """Store the picture of a shape in the place of an earlier one, if the catalogue can be written.

        Parameters
        ----------
        record : Record
            The record of the shape, which may have been replaced or removed since.
        picture : bytes
            A PNG file by `pcretrieve.draw.thumbnail`.

        Returns
        -------
        bool
            Whether it could be written. No error is raised, because a picture can be drawn again.
        """
        if not self._rows.is_writable:
            return False
        try:
            self._rows.keep_payload("thumbnails", record, packed([np.frombuffer(picture, np.uint8)]))
        except CatalogueError:  # another process has locked it, or the disk is full
            return False
        return True

    def remove(self, *shape_ids: str) -> None:
        """Remove shapes; InputError, without a change, if one of the ids does not exist."""
        for shape_id in shape_ids:
            self.record(shape_id)
        self._rows.remove(shape_ids)

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
        self._rows.revise(moved=moved or {}, removed=removed, labels=labels or {}, stamps=stamps or {})

    def merge(self, parts: Sequence[Catalogue]) -> Merged:
        """Store the shapes of other catalogues, which must have been built with the same options.

        Of a path that several catalogues have, the first finished shape is kept. The merge is associative,
        and continues after an interruption if it is started again.

        Parameters
        ----------
        parts : sequence of Catalogue
            The other catalogues.

        Returns
        -------
        Merged
            How many shapes were stored.

        Raises
        ------
        CatalogueError
            If options differ, or there is a conflict, before anything is written: a path has two contents or
            two labels, or an id belongs to two paths.
        """
        for part in parts:
            stored_options(part.location, settings_of(part.options), self.options)
        return merge_rows(self._rows, [part._rows for part in parts])

    def defects(
        self, *, repair: bool = False, on_shapes: Callable[[int], None] = lambda number: None
    ) -> list[Defect]:
        """Check the store, everything that is stored of each shape, and the stored indexes.

        Parameters
        ----------
        repair : bool, default False
            Whether defects are repaired: rows of no shape and damaged indexes are removed, SQL indexes are
            made again, and damaged shapes become failures in the stage ``check``, whose files the next ingest
            processes again.
        on_shapes : function of int, optional
            Called with the number of shapes that have been checked, now and then.

        Returns
        -------
        list of Defect
            The defects.
        """
        found = check_rows(self._rows, self.options, repair=repair, on_shapes=on_shapes)
        return [*found, *self._gallery.defects(repair=repair)]

    def give_up(self, shape_id: str, message: str) -> str | None:
        """Replace a shape by a failure in the stage ``check``, whose file the next ingest processes again.

        Parameters
        ----------
        shape_id : str
            The id of the shape.
        message : str
            What is wrong with it.

        Returns
        -------
        str or None
            What was done, in words; None if the catalogue cannot be written to.
        """
        record = self.record(shape_id)
        origin = Origin(record.id, record.path, record.content_hash, record.label, "failed")
        return set_to_be_ingested_again(self._rows, origin, message)

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
        return signature_table(self._rows, self.options, self._fitting(options))

    def index(self, options: PipelineOptions | None = None) -> SignatureIndex:
        """The index of the signatures of the catalogue.

        The index of a large catalogue is stored in a folder beside the file, or in the cache folder of the
        user, and opened from there until shapes or labels change.

        Parameters
        ----------
        options : PipelineOptions, optional
            As in `signatures`: ``catalogue.options.changed(retrieval={"whitening": "pca"})``.

        Returns
        -------
        SignatureIndex
            The index, with the whitening of the options.

        Raises
        ------
        CatalogueError
            If `options` require other spectra than the catalogue has.
        InputError
            If the catalogue has no shapes, or too few for the whitening.
        """
        options = self._fitting(options)
        return self._gallery.index(
            index_name(options),
            self._rows.revision(),
            lambda: made_index(self._rows, self.options, options),
        )

    def whitening(self, options: PipelineOptions | None = None) -> Whitening:
        """The whitening of the signatures of the catalogue.

        The whitenings ``neighbours``, ``pca`` and ``within-class`` are fitted to the present shapes of the
        catalogue.

        Parameters
        ----------
        options : PipelineOptions, optional
            As in `signatures`: ``catalogue.options.changed(retrieval={"whitening": "pca"})``.

        Returns
        -------
        Whitening
            The affine map of log-signatures.

        Raises
        ------
        CatalogueError
            If `options` require other spectra than the catalogue has.
        """
        options = self._fitting(options)
        return made_before(options) or self.index(options).whitening

    def _fitting(self, options: PipelineOptions | None) -> PipelineOptions:
        """The options of a request, after a check that they need no other spectra than the stored ones."""
        return fitting_options(self.location, self.options, options or self.options)
