"""The catalogue: shapes with provenance, spectra, meshes and signatures, kept in a store of rows."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from types import TracebackType

from pcretrieve.catalogue.arrays import packed_values
from pcretrieve.catalogue.gallery import Gallery
from pcretrieve.catalogue.reading import StoredShapes
from pcretrieve.catalogue.record import Content, Record, completed
from pcretrieve.catalogue.settings import fitting_options, settings_of, stored_options
from pcretrieve.catalogue.stores import open_rows
from pcretrieve.catalogue.surfaces import payloads_of
from pcretrieve.catalogue.tables import index_name, made_index, resolution_of, signature_table
from pcretrieve.options import PipelineOptions
from pcretrieve.retrieval import SignatureIndex, Whitening, table_whitening
from pcretrieve.types import SignatureTable

__all__ = ["Catalogue"]


class Catalogue(StoredShapes):
    """Shapes with their provenance, spectra, signatures and clean meshes.

    Parameters
    ----------
    location : str or Path
        The path of an SQLite file, or as str a URL whose scheme is the name of a store of another package.
    options : PipelineOptions, optional
        The options that the catalogue is, or must have been, built with. By default those of the existing
        catalogue, or the defaults for a new one.
    create : bool, default False
        Make the catalogue where there is none.

    Attributes
    ----------
    location : str
        The path or the URL, as messages name it.
    options : PipelineOptions
        The options that the catalogue was built with.

    Raises
    ------
    CatalogueError
        If there is no catalogue and `create` is false; if the file is a folder, no catalogue, or written by a
        newer pcretrieve; if it was built with other options (the message names the difference); if another
        process keeps it locked.
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
        """Store a shape under its path, in one transaction.

        The id is assigned in this transaction, because other processes may have stored shapes since `record`
        was made: a path that the catalogue holds keeps its id, and an id that belongs to another path gets
        the next free number. A failure never replaces a finished shape.

        Parameters
        ----------
        record : Record
            Its path, content hash, label and provenance.
        content : Content, optional
            None for a shape that failed.

        Returns
        -------
        Record
            The record that the catalogue holds of that path now.
        """
        record = completed(record, content, self.options.digest)
        if content is None:
            return self._rows.put(record, None, {})
        payloads = payloads_of(content.shape, self.options)
        return self._rows.put(record, packed_values(content.signature), payloads)

    def remove(self, *shape_ids: str) -> None:
        """Remove shapes, all of them or none; InputError if the catalogue holds none of one of the ids."""
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
        """Rename, remove and label shapes by path, in one transaction.

        Paths that the catalogue does not hold are ignored, because another process may have renamed or
        removed the same shapes.

        Parameters
        ----------
        moved : mapping of path to path, optional
            New path of a file by its old one. Where the catalogue holds the new path, nothing is renamed.
        removed : collection of str, optional
            Paths of shapes to remove.
        labels : mapping of path to class, optional
            By the new path where a file was renamed.
        """
        self._rows.revise(moved=moved or {}, removed=removed, labels=labels or {})

    def signatures(self, options: PipelineOptions | None = None) -> SignatureTable:
        """The signatures by which all shapes that did not fail are compared, by id.

        Parameters
        ----------
        options : PipelineOptions, optional
            With a descriptor other than the catalogue's own, as ``catalogue.options.changed(signature=...)``.
            Such signatures are computed from what is stored when they are asked for the first time, and kept.

        Returns
        -------
        SignatureTable
            With the classes of the shapes.

        Raises
        ------
        CatalogueError
            If `options` are for other spectra than those of the catalogue.
        ShapeError
            If a part of a shape that the descriptor needs was not stored.
        """
        return signature_table(self._rows, self.options, self._fitting(options))

    def index(self, options: PipelineOptions | None = None) -> SignatureIndex:
        """The index of this catalogue's signatures that options ask for.

        The index of a large catalogue is kept in a folder beside the file, or in the user's cache folder, and
        opened from there until shapes or labels change.

        Parameters
        ----------
        options : PipelineOptions, optional
            As in `signatures`: ``catalogue.options.changed(retrieval={"whitening": "pca"})``.

        Returns
        -------
        SignatureIndex
            With the whitening of the signatures.

        Raises
        ------
        CatalogueError
            If `options` are for other spectra than those of the catalogue.
        InputError
            If the catalogue holds no shapes, or too few for the whitening.
        """
        options = self._fitting(options)
        return self._gallery.index(
            index_name(options),
            self._rows.revision(),
            lambda: made_index(self._rows, self.options, options),
            by_label=options.retrieval.whitening == "within-class",
        )

    def whitening(self, options: PipelineOptions | None = None) -> Whitening:
        """The whitening of this catalogue's signatures that options ask for.

        The whitenings ``pca`` and ``within-class`` are fitted on the shapes that the catalogue holds now.

        Parameters
        ----------
        options : PipelineOptions, optional
            As in `signatures`: ``catalogue.options.changed(retrieval={"whitening": "pca"})``.

        Returns
        -------
        Whitening
            The linear map of the log-signatures.

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
        return fitting_options(self.location, self.options, options or self.options)
