"""The durable store: one SQLite file, one row a shape, readable while it is being written."""

from __future__ import annotations

import hashlib
import io
import json
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields
from datetime import datetime, timezone
from pathlib import Path
from types import TracebackType
from typing import Any, cast
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from pcretrieve.catalogue.opening import connect, damaged, is_writable, open_options, translated
from pcretrieve.catalogue.record import Content, Record, StoredShape
from pcretrieve.errors import InputError, ShapeError
from pcretrieve.options import PipelineOptions, SignatureOptions
from pcretrieve.retrieval import Whitening, fit_whitening, log_signatures, resolution_whitening
from pcretrieve.signatures import describe
from pcretrieve.types import ModalSpectrum, SignatureTable, Step, TriangleMesh

__all__ = ["Catalogue"]

RECORD_COLUMNS = tuple(column.name for column in fields(Record))


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
    ...     index = SignatureIndex(catalogue.signatures(), whitening=catalogue.whitening("within-class"))
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

    def put(self, record: Record, content: Content | None = None) -> None:
        """Store a shape, in place of an earlier one with the same id or path.

        `content` is None for a shape that failed.
        """
        row: dict[str, Any] = asdict(record) | {
            "steps": json.dumps([asdict(step) for step in record.steps]),
            "versions": json.dumps(record.versions),
            "options_digest": self.options.digest,
            "added": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        }
        if content is not None:
            mesh = content.mesh
            spectra = (content.spectrum, *content.others)
            row |= {
                "area": mesh.area,
                "n_vertices": len(mesh.vertices),
                "n_faces": len(mesh.faces),
                "euler": mesh.euler_characteristic,
                "eigenvalues": _packed(
                    values=np.stack([s.eigenvalues for s in spectra]),
                    areas=np.array([s.area for s in spectra]),
                ),
                "moments": _packed(
                    values=np.stack([s.moments for s in spectra]),
                    overlaps=np.stack([s.known_overlaps() for s in spectra]),
                ),
                "signature": _packed(values=content.signature),
                "mesh": _packed(vertices=mesh.vertices, faces=mesh.faces),
            }
        names = ", ".join(row)
        marks = ", ".join(f":{name}" for name in row)
        with translated(self.path), self._connection:
            self._connection.execute(f"INSERT OR REPLACE INTO shapes ({names}) VALUES ({marks})", row)
            self._connection.execute("DELETE FROM whitenings")

    def remove(self, shape_id: str) -> None:
        """Forget a shape."""
        self.record(shape_id)
        with translated(self.path), self._connection:
            self._connection.execute("DELETE FROM shapes WHERE id = ?", (shape_id,))
            self._connection.execute("DELETE FROM whitenings")

    def move(self, shape_id: str, path: str) -> None:
        """Note that a shape's file is now called `path`."""
        with translated(self.path), self._connection:
            self._connection.execute("UPDATE shapes SET path = ? WHERE id = ?", (path, shape_id))

    def set_labels(self, labels: Mapping[str, str]) -> None:
        """Label shapes, by id."""
        with translated(self.path), self._connection:
            self._connection.executemany(
                "UPDATE shapes SET label = ? WHERE id = ?", [(label, key) for key, label in labels.items()]
            )

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
        arrays = self._arrays("mesh", shape_id)
        return TriangleMesh(arrays["vertices"], arrays["faces"], self.record(shape_id).steps)

    def spectra(self, shape_id: str) -> tuple[ModalSpectrum, ...]:
        """The spectra of a shape's surfaces, that of its mesh first, in the unit in which that has area 1."""
        spectra, arrays = self._arrays("eigenvalues", shape_id), self._arrays("moments", shape_id)
        eigenvalues = np.atleast_2d(spectra["values"])  # (s, k)
        n, k = eigenvalues.shape
        # Earlier versions stored one surface; or no overlaps; or no areas, each surface scaled to one.
        areas = spectra.get("areas", np.ones(n)).tolist()
        moments = arrays["values"].reshape(n, k, k)
        overlaps = arrays["overlaps"].reshape(n, k, k) if "overlaps" in arrays else [None] * n
        return tuple(
            ModalSpectrum(values, moment, area=area, overlaps=overlap)
            for values, moment, area, overlap in zip(eigenvalues, moments, areas, overlaps, strict=True)
        )

    def shape(self, shape_id: str) -> StoredShape:
        """A shape, for `describe`."""
        return StoredShape(self, shape_id)

    def signatures(self, options: SignatureOptions | None = None) -> SignatureTable:
        """The signatures of all shapes that did not fail, by id.

        With `options` other than the catalogue's own, they are computed anew from what is stored.
        """
        own = options is None or options == self.options.signature
        options = self.options.signature if options is None else options
        ids, labels, values = [], [], []
        query = "SELECT id, label, signature FROM shapes WHERE status = 'done' ORDER BY id"
        for shape_id, label, signature in self._all(query):
            ids.append(shape_id)
            labels.append(label)
            try:
                values.append(
                    self._unpacked(signature)["values"]
                    if own
                    else describe(self.shape(shape_id), options).values
                )
            except ShapeError as error:
                error.shape_id = shape_id
                raise
        rows = np.array(values) if values else np.empty((0, options.n_values))
        return SignatureTable(tuple(ids), rows, options.method, self._digest(options), tuple(labels))

    def whitening(self, kind: str, options: SignatureOptions | None = None) -> Whitening:
        """The whitening of this catalogue's signatures.

        ``pca`` and ``within-class`` are fitted on the shapes that it holds now, and stored; fitted anew once
        they change.

        Parameters
        ----------
        kind : {"none", "resolution", "pca", "within-class"}
        options : SignatureOptions, optional
            As in `signatures`.
        """
        if kind == "resolution":
            options = options or self.options.signature
            return resolution_whitening(options, options_digest=self._digest(options))
        table = self.signatures(options)
        fingerprint = _fingerprint(table)
        row = self._one(
            "SELECT arrays FROM whitenings WHERE kind = ? AND fingerprint = ?", (kind, fingerprint)
        )
        if row is not None:
            return Whitening.from_arrays(self._unpacked(row[0]))
        whitening = fit_whitening(
            kind, log_signatures(table.values), list(table.labels), options_digest=table.digest
        )
        if kind != "none" and is_writable(self.path):
            arrays = _packed(**whitening.to_arrays())
            with translated(self.path), self._connection:
                self._connection.execute(
                    "INSERT OR REPLACE INTO whitenings VALUES (?, ?, ?, ?)",
                    (whitening.digest, kind, fingerprint, arrays),
                )
        return whitening

    # --- inside ---------------------------------------------------------------------------------------

    def _digest(self, options: SignatureOptions) -> str:
        """Of the signatures that some options make of what is stored."""
        return self.options.model_copy(update={"signature": options}).signature_digest

    def _arrays(self, column: str, shape_id: str) -> dict[str, NDArray[Any]]:
        record = self.record(shape_id)
        if record.status != "done":
            raise InputError(
                f"shape {shape_id!r} has no {column}: it failed in {record.stage}: {record.message}"
            )
        return self._unpacked(self._one(f"SELECT {column} FROM shapes WHERE id = ?", (shape_id,))[0])

    def _record(self, row: tuple[Any, ...]) -> Record:
        values = dict(zip(RECORD_COLUMNS, row, strict=True))
        try:
            steps = [Step(**step | {"notes": tuple(step["notes"])}) for step in json.loads(values["steps"])]
            return Record(**values | {"steps": tuple(steps), "versions": json.loads(values["versions"])})
        except (ValueError, TypeError, KeyError) as error:
            raise damaged(self.path, f"shape {values['id']!r} has no readable provenance") from error

    def _unpacked(self, blob: bytes) -> dict[str, NDArray[Any]]:
        try:
            with np.load(io.BytesIO(blob), allow_pickle=False) as archive:
                return cast("dict[str, NDArray[Any]]", dict(archive))
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


def _packed(**arrays: Any) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()
