"""The durable store: one SQLite file, one row a shape, readable while it is being written."""

from __future__ import annotations

import hashlib
import sqlite3
import zlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from pcretrieve.catalogue.opening import connect, damaged, is_writable, open_options, translated
from pcretrieve.catalogue.record import Content, Record, free_id
from pcretrieve.catalogue.row import RECORD_COLUMNS, packed, record_of, row_of, unpacked
from pcretrieve.catalogue.surfaces import areas_of, meshes_of, spectra_of
from pcretrieve.descriptors import DESCRIPTORS, describe, signature_length
from pcretrieve.errors import CatalogueError, InputError, ShapeError
from pcretrieve.options import PipelineOptions, options_difference
from pcretrieve.retrieval import (
    Whitening,
    checked_damping,
    resolution_whitening,
    table_whitening,
    whitening_digest,
)
from pcretrieve.types import ModalSpectrum, Need, Shape, SignatureTable, Surface, TriangleMesh

__all__ = ["Catalogue"]


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
    ...     index = SignatureIndex(
    ...         catalogue.signatures(options), options.retrieval, whitening=catalogue.whitening(options)
    ...     )
    """

    def __init__(
        self, path: str | Path, options: PipelineOptions | None = None, *, create: bool = False
    ) -> None:
        self.path = Path(path)
        self._connection = connect(self.path, create=create)
        try:
            with translated(self.path):
                self.options = open_options(self._connection, self.path, options)
        except BaseException:
            self._connection.close()
            raise

    def __enter__(self) -> Catalogue:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def __len__(self) -> int:
        return int(self._one("SELECT count(*) FROM shapes WHERE status = 'done'")[0])

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
        row = row_of(record, content, self.options.digest)
        with self._writing() as connection:
            earlier = self._one("SELECT id FROM shapes WHERE path = ?", (record.path,))
            row["id"] = earlier[0] if earlier else free_id(record, self._is_taken)
            names = ", ".join(row)
            marks = ", ".join(f":{name}" for name in row)
            anew = ", ".join(f"{name} = excluded.{name}" for name in row)
            connection.execute(
                f"INSERT INTO shapes ({names}) VALUES ({marks}) ON CONFLICT (path) DO UPDATE SET {anew} "
                "WHERE excluded.status = 'done' OR shapes.status = 'failed'",
                row,
            )
            connection.execute("DELETE FROM whitenings")
            return self.record(row["id"])

    def remove(self, shape_id: str) -> None:
        """Forget a shape.

        Raises
        ------
        InputError
            If there is none of that id.
        """
        with self._writing() as connection:
            self.record(shape_id)
            connection.execute("DELETE FROM shapes WHERE id = ?", (shape_id,))
            connection.execute("DELETE FROM whitenings")

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
        with self._writing() as connection:
            connection.executemany(
                "UPDATE OR IGNORE shapes SET path = ? WHERE path = ?",
                [(new, old) for old, new in (moved or {}).items()],
            )
            connection.executemany("DELETE FROM shapes WHERE path = ?", [(path,) for path in removed])
            connection.executemany(
                "UPDATE shapes SET label = ? WHERE path = ?",
                [(label, path) for path, label in (labels or {}).items()],
            )
            if removed:
                connection.execute("DELETE FROM whitenings")

    # --- reading --------------------------------------------------------------------------------------

    def records(self) -> list[Record]:
        """Every shape, failed ones included, by id."""
        rows = self._all(f"SELECT {', '.join(RECORD_COLUMNS)} FROM shapes ORDER BY id")
        return [self._record(row) for row in rows]

    def record(self, shape_id: str) -> Record:
        """One shape.

        Raises
        ------
        InputError
            If there is none of that id.
        """
        row = self._one(f"SELECT {', '.join(RECORD_COLUMNS)} FROM shapes WHERE id = ?", (shape_id,))
        if row is None:
            raise InputError(f"{self.path} holds no shape {shape_id!r}; `pcretrieve list` names them")
        return self._record(row)

    def mesh(self, shape_id: str) -> TriangleMesh:
        """The clean mesh of a shape, in the unit of its file."""
        return self.shape(shape_id, needs=("mesh",)).mesh

    def shape(self, shape_id: str, needs: tuple[Need, ...] = ("spectrum", "mesh")) -> Shape:
        """A shape, with the parts that are asked for and no others.

        Parameters
        ----------
        shape_id : str
        needs : tuple of {"spectrum", "eigenvectors", "mesh", "points"}
            What a descriptor needs. Eigenvectors are computed from the mesh, which is read in their place;
            the points are not stored.

        Raises
        ------
        InputError
            If there is no shape of that id, or it failed.
        """
        record = self.record(shape_id)
        if record.status != "done":
            raise InputError(
                f"shape {shape_id!r} has no surface: it failed in {record.stage}: {record.message}"
            )
        eigenvalues = self._arrays("eigenvalues", shape_id)
        areas = areas_of(eigenvalues, record.area or 0.0)
        spectra: Sequence[ModalSpectrum | None] = [None] * len(areas)
        meshes: Sequence[TriangleMesh | None] = [None] * len(areas)
        if "spectrum" in needs:
            spectra = spectra_of(eigenvalues, self._arrays("moments", shape_id))
        if "mesh" in needs or "eigenvectors" in needs:
            meshes = meshes_of(self._arrays("mesh", shape_id), len(areas), record.steps)
        surfaces = (Surface(*parts) for parts in zip(areas, spectra, meshes, strict=True))
        return Shape(tuple(surfaces), provenance=record.steps)

    def signatures(self, options: PipelineOptions | None = None) -> SignatureTable:
        """The signatures by which all shapes that did not fail are compared, by id.

        Parameters
        ----------
        options : PipelineOptions, optional
            With a descriptor other than the catalogue's own, as ``catalogue.options.changed(signature=...)``;
            it is computed anew from what is stored.

        Raises
        ------
        CatalogueError
            If `options` are for other spectra than those of the catalogue.
        """
        options = self._fitting(options)
        descriptor = DESCRIPTORS[options.signature.method]
        stored = options.compared_digest == self.options.signature_digest
        ids, labels, values = [], [], []
        query = "SELECT id, label, signature FROM shapes WHERE status = 'done' ORDER BY id"
        for shape_id, label, signature in self._all(query):
            ids.append(shape_id)
            labels.append(label)
            try:
                values.append(
                    self._unpacked(signature)["values"]
                    if stored
                    else describe(self.shape(shape_id, descriptor.needs), options.compared).values
                )
            except ShapeError as error:
                error.shape_id = shape_id
                raise
        rows = np.array(values) if values else np.empty((0, signature_length(options.signature)))
        return SignatureTable(
            tuple(ids), rows, descriptor.name, options.compared_digest, tuple(labels), descriptor.metric
        )

    def whitening(self, options: PipelineOptions | None = None) -> Whitening:
        """The whitening of this catalogue's signatures that options ask for.

        ``pca`` and ``within-class`` are fitted on the shapes that it holds now, and stored; fitted anew once
        they change.

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
        kind, damping = options.retrieval.whitening, options.retrieval.damping
        if kind == "resolution":
            return resolution_whitening(
                options.compared, damping=damping, options_digest=options.compared_digest
            )
        table = self.signatures(options)
        if kind == "none":
            return table_whitening(table, options.retrieval)
        digest = whitening_digest(kind, checked_damping(kind, damping), table.digest)
        fingerprint = _fingerprint(table)
        row = self._one(
            "SELECT arrays FROM whitenings WHERE digest = ? AND fingerprint = ?", (digest, fingerprint)
        )
        if row is not None:
            return Whitening.from_arrays(self._unpacked(row[0]))
        whitening = table_whitening(table, options.retrieval)
        if is_writable(self.path):
            arrays = packed(**whitening.to_arrays())
            with translated(self.path), self._connection:
                self._connection.execute(
                    "INSERT OR REPLACE INTO whitenings VALUES (?, ?, ?, ?)",
                    (whitening.digest, kind, fingerprint, arrays),
                )
        return whitening

    # --- inside ---------------------------------------------------------------------------------------

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        """One transaction, which takes the write lock at its start: what it reads stays true to its end."""
        with translated(self.path), self._connection:
            self._connection.execute("BEGIN IMMEDIATE")
            yield self._connection

    def _is_taken(self, shape_id: str) -> bool:
        return self._one("SELECT 1 FROM shapes WHERE id = ?", (shape_id,)) is not None

    def _fitting(self, options: PipelineOptions | None) -> PipelineOptions:
        """The options of a request, once they have been seen to be for the spectra that are stored."""
        if options is None:
            return self.options
        if options.digest != self.options.digest:
            difference = "; ".join(options_difference(self.options, options))
            raise CatalogueError(
                f"{self.path} was built with other options: {difference}. Of those only the ones of "
                "[signature] and [retrieval] can be changed: start from its own, Catalogue.options"
            )
        return options

    def _arrays(self, column: str, shape_id: str) -> dict[str, NDArray[Any]]:
        return self._unpacked(self._one(f"SELECT {column} FROM shapes WHERE id = ?", (shape_id,))[0])

    def _record(self, row: tuple[Any, ...]) -> Record:
        try:
            return record_of(row)
        except (ValueError, TypeError, KeyError) as error:
            raise damaged(self.path, f"shape {row[0]!r} has no readable provenance") from error

    def _unpacked(self, blob: bytes) -> dict[str, NDArray[Any]]:
        try:
            return unpacked(blob)
        except (ValueError, TypeError, EOFError, OSError, BadZipFile, zlib.error) as error:
            raise damaged(self.path, f"an array cannot be read: {error}") from error

    def _all(self, query: str, values: Iterable[object] = ()) -> list[Any]:
        with translated(self.path):
            return self._connection.execute(query, tuple(values)).fetchall()

    def _one(self, query: str, values: Iterable[object] = ()) -> Any:
        with translated(self.path):
            return self._connection.execute(query, tuple(values)).fetchone()


def _fingerprint(table: SignatureTable) -> str:
    digest = hashlib.sha256(repr((table.ids, table.labels, table.kind, table.digest)).encode())
    digest.update(table.values.tobytes())
    return digest.hexdigest()[:16]
