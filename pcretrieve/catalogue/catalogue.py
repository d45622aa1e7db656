"""The catalogue: shapes with provenance, spectra, surfaces and signatures, in a file or a database.

It stores what others compute. What is fitted to its shapes, and what ranks them, is in `pcretrieve.gallery`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias, get_args

import numpy as np

from pcretrieve.catalogue.arrays import (
    intact,
    packed,
    packed_values,
    payloads_of,
    stored_shape,
    unpacked,
    unpacked_values,
)
from pcretrieve.catalogue.cache import ArrayCache
from pcretrieve.catalogue.records import (
    OWN,
    Content,
    Entry,
    Payload,
    Record,
    Status,
    UnknownShape,
    settings_of,
    stored_options,
)
from pcretrieve.catalogue.rows import Rows, file_of
from pcretrieve.errors import (
    CatalogueError,
    InputError,
    OptionError,
    PcretrieveError,
    ShapeError,
)
from pcretrieve.options import PipelineOptions, check_many
from pcretrieve.values import Decision, FloatArray, Need, Shape, TriangleMesh

if TYPE_CHECKING:
    from typing_extensions import Self


# The payloads that are read for what is needed of a shape, beside its eigenvalues.
SERVED: dict[Payload, set[Need]] = {
    "moments": {"spectrum", "overlaps"},
    "overlaps": {"overlaps"},
    "meshes": {"mesh", "eigenvectors"},
}


class Catalogue(Mapping[str, Record]):
    """Shapes with their provenance, spectra, signatures and meshes: the records of shapes by id.

    A catalogue is a mapping: ``catalogue["anna-sits"]`` is the record of a shape, and ids come in
    alphabetical order. It has the shapes that can be searched; `record` and `records` find failures too.

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
    ...     seated = [shape_id for shape_id in catalogue if "sits" in shape_id]
    ...     area = catalogue["anna-sits"].area
    """

    def __init__(
        self,
        location: str | Path,
        options: PipelineOptions | None = None,
        *,
        create: bool = False,
        any_numbers: bool = False,
    ) -> None:
        #: For other rooms of this package, which need more than the verbs below.
        self.rows = Rows(
            location, settings_of(options or PipelineOptions()), create=create
        )
        self.location = self.rows.location
        try:
            self.options = stored_options(
                self.location, self.rows.settings(), options, any_numbers=any_numbers
            )
        except BaseException:
            self.close()
            raise
        file = file_of(self.location)
        # By the real path, so that a catalogue has one cache whatever links lead to it.
        self.cache = ArrayCache(os.path.realpath(file) if file else self.location)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def __repr__(self) -> str:
        with suppress(CatalogueError):
            return f"Catalogue({self.location}: {len(self)} shapes)"
        return f"Catalogue({self.location})"  # closed, or not readable any more

    # Two catalogues are not compared shape by shape.
    __eq__ = object.__eq__
    __hash__ = object.__hash__

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

    def close(self) -> None:
        """Close the file or the connection."""
        self.rows.close()

    # --- records ----------------------------------------------------------------------------------------

    def __getitem__(self, shape_id: str) -> Record:
        """The record of a shape that did not fail; InputError, which is a KeyError too, for others."""
        record = self.record(shape_id)
        if record.status != "done":
            raise UnknownShape(
                f"shape {shape_id!r} failed in {record.stage}: {record.message}"
            )
        return record

    def __contains__(self, shape_id: object) -> bool:
        return any(
            record.status == "done" for record in self.rows.several([str(shape_id)])
        )

    def __iter__(self) -> Iterator[str]:
        return iter(self.rows.wanted(state="done")[1])

    def __len__(self) -> int:
        return len(self.rows)

    def record(self, shape_id: str) -> Record:
        """The record of a shape, or of a scan that failed; InputError if there is none of this id."""
        return self.rows.record(shape_id)

    def records(
        self,
        *,
        status: Status | None = None,
        incomplete: bool = False,
        offset: int = 0,
        limit: int | None = None,
    ) -> list[Record]:
        """Records in alphabetical order of their ids: all, or those that match.

        status: ``done`` or ``failed``.
        incomplete: poor and incomplete scans alone, whatever their status.
        offset, limit: how many are left out first, and how many there are at most.
        """
        state = "incomplete" if incomplete else status or ""
        _, ids = self.rows.wanted(state=state, offset=offset, limit=limit)
        return [record for page in self.rows.pages(ids) for record in page]

    def labels(self) -> dict[str, str | None]:
        """The class of each shape, including scans that failed, by id in alphabetical order."""
        return self.rows.labels()

    def revision(self) -> str:
        """A name of the state of the shapes and their labels, which no other state has."""
        return self.rows.revision()

    # --- one shape --------------------------------------------------------------------------------------

    def shape(
        self, shape_id: str, needs: tuple[Need, ...] = ("spectrum", "mesh")
    ) -> Shape:
        """Read a shape with some of its parts; those that were not stored are missing in it."""
        names = [name for name, served in SERVED.items() if served & {*needs}]
        entry = self.rows.entry(shape_id, ["spectra", *names])
        record = entry.record
        if record.status != "done":
            raise InputError(
                f"shape {shape_id!r} has no surface: it failed in {record.stage}: {record.message}"
            )
        with intact(self.location, f"shape {shape_id!r}"):
            shape = stored_shape(entry.payloads, record.steps)
        return replace(shape, grade=record.grade)

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
        stored = self.rows.entry(shape_id, ["thumbnails"]).payloads.get("thumbnails")
        with intact(self.location, f"the thumbnail of {shape_id!r}"):
            return None if stored is None else unpacked(stored, 1)[0].tobytes()

    def signature(self, shape_id: str) -> FloatArray:
        """The signature (L,) of a shape by the options of the catalogue, as it is stored."""
        stored = self.rows.entry(shape_id, ()).signatures.get(OWN)
        if stored is None:
            raise self.rows.unknown(shape_id)
        with intact(self.location, f"the signature of {shape_id!r}"):
            return np.asarray(unpacked_values(stored, 1, len(stored) // 8 - 1)[0])

    # --- changes ----------------------------------------------------------------------------------------

    def put(self, record: Record, content: Content | None = None) -> Record:
        """Store what was made of a scan, or with no content its failure; the record that is then stored.

        An earlier shape of the same file is replaced, and its id kept. A failure never replaces a shape.
        """
        added = datetime.now(timezone.utc).isoformat(timespec="seconds")
        record = replace(record, options_digest=self.options.digest, added=added)
        if content is None:
            return self.rows.store(Entry(record, {}, {}))
        shape, mesh = content.shape, content.shape.mesh
        record = replace(
            record,
            area=shape.area,
            n_vertices=len(mesh.vertices),
            n_faces=len(mesh.faces),
            euler=mesh.euler_characteristic,
            grade=shape.grade,
        )
        payloads = payloads_of(shape, self.options)
        if content.thumbnail is not None:
            payloads["thumbnails"] = packed([np.frombuffer(content.thumbnail, np.uint8)])
        if content.up is not None:
            payloads["up"] = packed([content.up])
        return self.rows.store(
            Entry(record, {OWN: packed_values(content.signature)}, payloads)
        )

    def remove(self, *shape_ids: str) -> None:
        """Remove shapes: from the catalogue, its free space and log, and the cache of its indexes.

        Raises InputError, and changes nothing, if one of the ids does not exist.
        """
        self.rows.remove(*shape_ids)
        self.cache.clear()


#: A catalogue, or its path or URL.
CatalogueLike: TypeAlias = "Catalogue | str | Path"


def mark(
    catalogue: CatalogueLike,
    shape_ids: Sequence[str],
    decision: str | None,
    note: str | None = None,
) -> None:
    """Keep what a person decided about scans, as ``Record.mark`` and ``Record.note``.

    A decision stays when its scan is processed again, moved, merged into another catalogue or backed up. It
    goes when the file gets another content, as by a new scan.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue.
    shape_ids : sequence of str
        The shapes, or scans that failed.
    decision : {"rescan", "accept", "note"} or None
        What is to be done: scan again; nothing, the scan will do; nothing is said but the note. None forgets
        the decision.
    note : str, optional
        Why.

    Raises
    ------
    InputError
        If one of the ids does not exist; nothing is changed then.
    OptionError
        If there is no such decision, or a note has no text.
    """
    check_many("shape_ids", shape_ids)
    known = get_args(Decision)
    if decision is not None and decision not in known:
        raise OptionError(
            f"a decision must be one of {', '.join(known)}, got {decision!r}"
        )
    if decision == "note" and not note:
        raise OptionError(
            "a note must have a text, got none: write it after the word note"
        )
    with Catalogue.opened(catalogue) as store:
        store.rows.mark(shape_ids, decision, note or None)


def thumbnails(location: str, ids: Sequence[str]) -> list[bytes | None]:
    """The thumbnails of shapes; none, if the catalogue is not there any more."""
    with suppress(PcretrieveError), Catalogue(location, any_numbers=True) as store:
        return [store.thumbnail(shape_id) for shape_id in ids]
    return [None] * len(ids)
