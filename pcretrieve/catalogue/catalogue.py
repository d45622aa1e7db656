"""The catalogue: shapes with provenance, spectra, surfaces and signatures, in a file or a database."""

from __future__ import annotations

import logging
import os
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import TypeAlias

import numpy as np

from pcretrieve.catalogue import records
from pcretrieve.catalogue.arrays import (
    intact,
    packed,
    packed_values,
    payloads_of,
    stored_shape,
    unpacked,
    unpacked_values,
)
from pcretrieve.catalogue.cache import IndexCache, signatures_digest
from pcretrieve.catalogue.rows import Rows, file_of
from pcretrieve.errors import CatalogueError, InputError, PcretrieveError, ShapeError
from pcretrieve.options import PipelineOptions, options_difference
from pcretrieve.retrieval import SignatureIndex, Whitening, people, table_whitening
from pcretrieve.retrieval.scores import fit_scores
from pcretrieve.retrieval.whitening import read_whitening
from pcretrieve.values import (
    FloatArray,
    ModalSpectrum,
    Need,
    Shape,
    Signature,
    SignatureTable,
    SizeUnit,
    Surface,
    TriangleMesh,
)

logger = logging.getLogger(__name__)

# Number of computed signatures that are stored together, so that few are lost after an interruption.
KEPT_AT_ONCE = 100


class Catalogue(Rows):
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
        super().__init__(location, records.settings_of(options or PipelineOptions()), create=create)
        try:
            self.options = records.stored_options(
                self.location, self.settings(), options, any_numbers=any_numbers
            )
        except BaseException:
            self.close()
            raise
        file = file_of(self.location)
        # By the real path, so that a catalogue has one cache whatever links lead to it.
        self.cache = IndexCache(os.path.realpath(file) if file else self.location)

    # --- shapes -----------------------------------------------------------------------------------------

    @classmethod
    @contextmanager
    def opened(
        cls,
        catalogue: CatalogueLike,
        options: PipelineOptions | None = None,
        *,
        create: bool = False,
    ) -> Iterator[Catalogue]:
        """Open a catalogue that is given by its path, and close it at the end; leave others as they are."""
        if isinstance(catalogue, Catalogue):
            yield catalogue
        else:
            with cls(catalogue, options, create=create) as store:
                yield store

    def shape(self, shape_id: str, needs: tuple[Need, ...] = ("spectrum", "mesh")) -> Shape:
        """Read a shape with some of its parts."""
        return self._read(shape_id, needs)[1]

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
        stored = self._entry(shape_id, ["thumbnails"]).payloads.get("thumbnails")
        with intact(self.location, f"the thumbnail of {shape_id!r}"):
            return None if stored is None else unpacked(stored, 1)[0].tobytes()

    def direction_upwards(self, shape_id: str) -> FloatArray | None:
        """(3,) the direction upwards in the picture of a shape, in the frame of its file."""
        stored = self._entry(shape_id, ["up"]).payloads.get("up")
        with intact(self.location, f"the thumbnail of {shape_id!r}"):
            return None if stored is None else np.asarray(unpacked(stored, 1)[0], np.float64)

    def signature(self, shape_id: str) -> FloatArray:
        """The signature (L,) of a shape by the options of the catalogue, as it is stored."""
        stored = self._entry(shape_id, ()).signatures.get(records.OWN)
        if stored is None:
            raise self.unknown(shape_id)
        with intact(self.location, f"the signature of {shape_id!r}"):
            return np.asarray(unpacked_values(stored, 1, len(stored) // 8 - 1)[0])

    def described(self, shape_id: str, options: PipelineOptions) -> Signature:
        """The signature of a shape by other options, from what is stored; ShapeError if a part is missing."""
        from pcretrieve.descriptors import DESCRIPTORS, describe

        needs = DESCRIPTORS[options.signature.method].needs
        return describe(self.shape(shape_id, needs), options.signature)

    def stored_bytes(self, shape_id: str) -> dict[str, int]:
        """The sizes in bytes of a shape's record, signatures and arrays; InputError if there is no shape."""
        entry = self._entry(shape_id, records.PAYLOADS)
        texts = (str(value) for value in records.row_of(entry.record).values() if value is not None)
        sizes = dict.fromkeys(("record", "signatures", *records.PAYLOADS), 0)
        sizes["record"] = sum(len(text.encode()) for text in texts)
        sizes["signatures"] = sum(map(len, entry.signatures.values()))
        return sizes | {name: len(arrays) for name, arrays in entry.payloads.items()}

    def remove(self, *shape_ids: str) -> None:
        """Remove shapes: from the catalogue, its free space and log, and the cache of its indexes.

        Raises InputError, and changes nothing, if one of the ids does not exist.
        """
        super().remove(*shape_ids)
        self.cache.clear()

    def put(self, record: records.Record, content: records.Content | None = None) -> records.Record:
        """Store a shape, or with no content its failure, as by `store`; the record that is then stored."""
        added = datetime.now(timezone.utc).isoformat(timespec="seconds")
        record = replace(record, options_digest=self.options.digest, added=added)
        if content is None:
            return self.store(records.Entry(record, {}, {}))
        shape, mesh = content.shape, content.shape.mesh
        record = replace(
            record,
            area=shape.area,
            n_vertices=len(mesh.vertices),
            n_faces=len(mesh.faces),
            euler=mesh.euler_characteristic,
            verdict=shape.verdict,
        )
        payloads = payloads_of(shape, self.options)
        if content.thumbnail is not None:
            payloads["thumbnails"] = packed([np.frombuffer(content.thumbnail, np.uint8)])
        if content.up is not None:
            payloads["up"] = packed([content.up])
        return self.store(
            records.Entry(record, {records.OWN: packed_values(content.signature)}, payloads)
        )

    def keep_thumbnail(self, record: records.Record, picture: bytes, up: FloatArray) -> bool:
        """Store the picture of a shape, and what is up in it, unless the shape has been replaced meanwhile.

        Returns whether it could be written. No error is raised, because a picture can be drawn again.
        """
        if not self.database.is_writable:
            return False
        try:
            with self.database.writing():
                self.database.execute(
                    "UPDATE arrays SET up = ?, thumbnails = ? WHERE shape = "
                    "(SELECT number FROM shapes WHERE id = ? AND content_hash = ? AND status = 'done')",
                    [
                        packed([up]),
                        packed([np.frombuffer(picture, np.uint8)]),
                        record.id,
                        record.content_hash,
                    ],
                )
        except CatalogueError:  # another process has locked it, or the disk is full
            return False
        return True

    @property
    def up(self) -> str | None:
        """The axis of the files that points upwards, such as ``-y``, if it was said."""
        return self.settings().get("up")

    @records.repeated
    def keep_up(self, axis: str | None) -> None:
        """Store which axis points upwards, or with None that pictures show it for each shape, drawn again."""
        if not self.database.is_writable:
            return
        with self.database.writing():
            self.keep_setting("up", axis)
            if axis is None:
                self.database.execute(
                    "UPDATE arrays SET up = NULL, thumbnails = NULL WHERE meshes IS NOT NULL"
                )

    # --- signatures -------------------------------------------------------------------------------------

    def signatures(self, options: PipelineOptions | None = None) -> SignatureTable:
        """The signatures of all shapes that did not fail, in ascending order of id, with their classes.

        options: may have another descriptor than the options of the catalogue, from
            ``catalogue.options.changed(signature=...)``. Signatures that are not stored are computed from the
            stored spectra and surfaces, and stored.

        Raises CatalogueError if `options` require other spectra than the catalogue has, and ShapeError if a
        part of a shape that the descriptor needs was not stored.
        """
        return self._table(self._fitting(options))[0]

    def index(self, options: PipelineOptions | None = None) -> SignatureIndex:
        """The index of the signatures of the catalogue, with the whitening of the options.

        The index of a large catalogue is stored in the cache folder of the user, and opened from there until
        shapes or labels change.

        options: as in `signatures`: ``catalogue.options.changed(retrieval={"whitening": "pca"})``.

        Raises the errors of `signatures`, and InputError if the catalogue has no shapes, or too few for the
        whitening.
        """
        chosen = self._fitting(options)
        return self.cache.index(chosen, self.revision(), lambda: self._made_index(chosen))

    def whitening(self, options: PipelineOptions | None = None) -> Whitening:
        """The whitening of the signatures of the catalogue, an affine map of log-signatures.

        The whitenings ``neighbours``, ``pca`` and ``within-class`` are fitted to the present shapes of the
        catalogue. Options and errors are those of `index`.
        """
        options = self._fitting(options)
        return _calibrated(options) or self.index(options).whitening

    # --- inside -----------------------------------------------------------------------------------------

    def _fitting(self, options: PipelineOptions | None) -> PipelineOptions:
        """The options of a request, after a check that they need no other spectra than the stored ones."""
        options = options or self.options
        if options.digest != self.options.digest:
            difference = "; ".join(options_difference(self.options, options))
            raise CatalogueError(
                f"{self.location} was built with other options: {difference}. Only the options in "
                "[signature] and [retrieval] can be changed: start from Catalogue.options"
            )
        return options

    def _entry(self, shape_id: str, payloads: Collection[records.Payload]) -> records.Entry:
        for entry in self.entries([shape_id], payloads=payloads):
            return entry
        raise self.unknown(shape_id)

    def _read(self, shape_id: str, needs: Collection[Need]) -> tuple[records.Record, Shape]:
        """A record and its shape with some parts.

        Overlaps that were not stored are computed from the mesh. Parts that were not stored, and cannot be
        computed, are missing in the shape.
        """
        overlaps, with_mesh = "overlaps" in needs, bool({"mesh", "eigenvectors"} & set(needs))
        names: list[records.Payload] = ["spectra"]
        names += ["moments"] if overlaps or "spectrum" in needs else []
        names += ["overlaps"] if overlaps else []
        names += ["meshes"] if overlaps or with_mesh else []
        entry = self._entry(shape_id, names)
        record, stored = entry.record, entry.payloads
        if record.status != "done":
            raise InputError(
                f"shape {shape_id!r} has no surface: it failed in {record.stage}: {record.message}"
            )
        with intact(self.location, f"shape {shape_id!r}"):
            shape = stored_shape(stored, record.steps)
        surfaces = shape.surfaces
        if overlaps and "overlaps" not in stored:
            surfaces = tuple(_with_overlaps(one, self.options.spectral.element) for one in surfaces)
        if not with_mesh:
            surfaces = tuple(replace(surface, mesh=None) for surface in surfaces)
        return record, replace(shape, surfaces=surfaces, verdict=record.verdict)

    def _table(self, options: PipelineOptions) -> tuple[SignatureTable, str]:
        """The signatures by some options, and a name of the state of the catalogue that they belong to."""
        from pcretrieve.descriptors import DESCRIPTORS, signature_length

        descriptor = DESCRIPTORS[options.signature.method]
        unit = self._unit_of_sizes(options)
        is_own = options.signature_digest == self.options.signature_digest
        digest = records.OWN if is_own else signatures_digest(options)
        n_values = signature_length(options.signature)
        with intact(self.location, "a signature"):
            revision, ids, labels, has, packed = self.listed(digest)
            values = stored = unpacked_values(packed, int(has.sum()), n_values)
        if len(stored) < len(ids):
            values = np.empty((len(ids), n_values))
            values[has] = stored
            missing = np.flatnonzero(~has)
            made = self._described(digest, options, [ids[row] for row in missing])
            for row, values_now in zip(missing, made, strict=True):
                values[row] = values_now
        made_by = descriptor.name, options.signature_digest
        table = SignatureTable(tuple(ids), values, *made_by, tuple(labels), descriptor.metric, unit)
        return table, revision

    def _described(
        self, digest: str, options: PipelineOptions, ids: Sequence[str]
    ) -> list[FloatArray]:
        """Compute the signatures (L,) of some shapes, and store them if the catalogue can be written to."""
        from pcretrieve.descriptors import DESCRIPTORS, describe

        needs = DESCRIPTORS[options.signature.method].needs
        made: list[FloatArray] = []
        for start in range(0, len(ids), KEPT_AT_ONCE):
            unkept: list[tuple[records.Record, bytes]] = []
            try:
                for shape_id in ids[start : start + KEPT_AT_ONCE]:
                    record, shape = self._read(shape_id, needs)
                    try:
                        made.append(describe(shape, options.signature).values)
                    except ShapeError as error:
                        error.shape_id = shape_id
                        raise
                    unkept.append((record, packed_values(made[-1])))
            finally:
                if unkept and self.database.is_writable:
                    self.keep(digest, unkept)
            if len(unkept) == KEPT_AT_ONCE:
                logger.info("%s: %d of %d shapes", options.signature.method, len(made), len(ids))
        return made

    def _unit_of_sizes(self, options: PipelineOptions) -> SizeUnit | None:
        """The one unit of the sizes in all signatures; None if they do not depend on sizes."""
        if not options.signature.compares_sizes:
            return None
        units = self.areas().keys()
        if None in units and len(units) > 1:
            raise InputError(
                f"sizes must be in one unit to be compared: in {self.location} some shapes are in metres, "
                "the unit of others is unknown; ingest all into a new catalogue with --unit (scan.unit), the "
                "unit of the files that have none, or compare the form alone (size_weight = 0, and the scale "
                "area)"
            )
        return "unknown" if None in units else "m"

    def _made_index(self, options: PipelineOptions) -> tuple[SignatureIndex, str]:
        """Compute the index of the signatures by some options, and name the state that it belongs to."""
        table, revision = self._table(options)
        retrieval, known = options.retrieval, people(options.signature)
        whitening = _calibrated(options) or table_whitening(table, retrieval, people=known)
        scores = fit_scores(table, whitening, retrieval)
        return SignatureIndex(table, retrieval, whitening=whitening, scores=scores), revision


def thumbnails(location: str, ids: Sequence[str]) -> list[bytes | None]:
    """The thumbnails of shapes; none, if the catalogue is not there any more."""
    with suppress(PcretrieveError), Catalogue(location, any_numbers=True) as store:
        return [store.thumbnail(shape_id) for shape_id in ids]
    return [None] * len(ids)


def _calibrated(options: PipelineOptions) -> Whitening | None:
    """The whitening of a file, which is not fitted to the shapes of the catalogue."""
    if options.retrieval.calibration is None:
        return None
    whitening = read_whitening(Path(options.retrieval.calibration))
    whitening.check_made_for(options.signature_digest)
    return whitening


def _with_overlaps(surface: Surface, element: str) -> Surface:
    """The surface with the overlaps of its eigenfunctions, from the mesh; unchanged without a mesh."""
    if surface.mesh is None or surface.spectrum is None:
        return surface
    from threadpoolctl import threadpool_limits

    from pcretrieve.spectral import unit_eigenpairs

    with threadpool_limits(limits=1):  # as in the pipeline, so that rounding errors are the same
        pairs = unit_eigenpairs(surface.mesh, len(surface.spectrum.eigenvalues), element)
        overlaps = ModalSpectrum.of(pairs).overlaps
    return replace(surface, spectrum=replace(surface.spectrum, overlaps=overlaps))


#: A catalogue, or its path or URL.
CatalogueLike: TypeAlias = "Catalogue | str | Path"
