"""Rows → tables and indexes of signatures; signatures that are not stored are computed and stored."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcretrieve.catalogue.arrays import intact, packed_values, read_shape, unpacked_values
from pcretrieve.catalogue.records import OWN, Record
from pcretrieve.catalogue.rows import Revision, Rows
from pcretrieve.errors import InputError, ShapeError
from pcretrieve.options import METHODS, PipelineOptions
from pcretrieve.retrieval import (
    CHUNK,
    MadeBy,
    Names,
    SignatureIndex,
    Whitening,
    check_comparable,
    coordinates,
    fit_scores,
    fit_whitening,
    pair_sample,
    read_whitening,
    resolution_covariance,
    resolution_whitening,
)
from pcretrieve.values import FloatArray, SignatureTable, SizeUnit

logger = logging.getLogger(__name__)

# Number of computed signatures that are stored together, so that few are lost after an interruption.
KEPT_AT_ONCE = 100


def made_before(options: PipelineOptions) -> Whitening | None:
    """The whitening ``resolution``, or one of a file, which are not fitted to the shapes of the catalogue."""
    if options.retrieval.calibration is not None:
        whitening = read_whitening(Path(options.retrieval.calibration))
        whitening.check_made_for(options.compared_digest)
        return whitening
    if options.retrieval.whitening != "resolution":
        return None
    shrinkage = options.retrieval.shrinkage
    return resolution_whitening(options.compared, shrinkage=shrinkage, options_digest=options.compared_digest)


def index_name(options: PipelineOptions) -> str:
    """A name of everything that an index depends on, apart from the shapes."""
    retrieval = options.retrieval
    calibrated = ""
    if retrieval.calibration is not None:
        calibrated = hashlib.sha256(read_whitening(Path(retrieval.calibration)).matrix.tobytes()).hexdigest()
    compared = f"{retrieval.whitening} {retrieval.shrinkage} {calibrated}"
    return f"{_digest_of(options)} {retrieval.distance} {compared}"


def _digest_of(options: PipelineOptions) -> str:
    """The digest of the signatures that are compared by some options."""
    # With the version of the package of the descriptor, because other versions may give other values.
    method = options.signature.method
    if method in METHODS:
        return options.compared_digest
    from pcretrieve.descriptors import DESCRIPTORS

    return options.compared_digest + DESCRIPTORS.version(method)


class Signatures(NamedTuple):
    """The signatures of all shapes that did not fail.

    ids: identifiers of the shapes, in ascending order.
    values: (N, L) float64, one signature in each row.
    """

    revision: Revision
    ids: list[str]
    labels: list[str | None]
    values: FloatArray


def read_signatures(rows: Rows, own: PipelineOptions, options: PipelineOptions) -> Signatures:
    """The signatures by some options; signatures that are not stored are computed and stored."""
    # Imported here, because other functions do not need this slow import.
    from pcretrieve.descriptors import signature_length

    digest = OWN if options.compared_digest == own.signature_digest else _digest_of(options)
    listed = rows.signatures(digest)
    missing = np.flatnonzero(~listed.has)
    made = _described(rows, own, digest, options, [listed.ids[row] for row in missing])
    n_values = signature_length(options.signature)
    with intact(rows.location, "a signature"):
        if listed.has.any() and not made:
            values = unpacked_values(listed.packed, n_values)
        else:
            values = np.empty((len(listed.ids), n_values))
            for row, made_now in zip(missing, made, strict=True):
                values[row] = made_now
            values[listed.has] = unpacked_values(listed.packed[listed.has], n_values)
    return Signatures(listed.revision, listed.ids, listed.labels, values)


def signature_table(rows: Rows, own: PipelineOptions, options: PipelineOptions) -> SignatureTable:
    """The signatures by some options; signatures that are not stored are computed and stored.

    Returns SignatureTable: the signatures of all shapes that did not fail, in ascending order of id.
    """
    from pcretrieve.descriptors import DESCRIPTORS

    descriptor = DESCRIPTORS[options.signature.method]
    unit = _unit_of_sizes(rows, options)
    _, ids, labels, values = read_signatures(rows, own, options)
    made_by = descriptor.name, options.compared_digest
    return SignatureTable(tuple(ids), values, *made_by, tuple(labels), descriptor.metric, unit)


def _unit_of_sizes(rows: Rows, options: PipelineOptions) -> SizeUnit | None:
    """The one unit of the sizes in all signatures; None if they do not depend on sizes."""
    if not options.signature.compares_sizes:
        return None
    units = rows.areas().keys()
    if None in units and len(units) > 1:
        raise InputError(
            f"sizes must be in one unit to be compared: in {rows.location} some shapes are in metres, the "
            "unit of others is unknown; ingest all into a new catalogue with --unit (scan.unit), the unit of "
            "the files that have none, or compare the form alone (size_weight = 0, and the scale area)"
        )
    return "unknown" if None in units else "m"


def made_index(rows: Rows, own: PipelineOptions, options: PipelineOptions) -> tuple[SignatureIndex, Revision]:
    """Compute the index of the signatures by some options.

    Except for within-class whitening, at most two arrays of the size of the table are in memory at a time.
    """
    from pcretrieve.descriptors import DESCRIPTORS

    descriptor = DESCRIPTORS[options.signature.method]
    unit = _unit_of_sizes(rows, options)
    check_comparable(descriptor.name, descriptor.metric, options.retrieval.distance)
    revision, ids, labels, values = read_signatures(rows, own, options)
    # In place, because the table is not used afterwards.
    for start in range(0, len(values), CHUNK):
        block = slice(start, start + CHUNK)
        values[block] = coordinates(values[block], descriptor.metric)
    names = Names.of(ids)
    del ids
    whitening = made_before(options)
    if whitening is None and len(values):
        whitening = fit_whitening(
            options.retrieval.whitening,
            values,
            labels,
            shrinkage=options.retrieval.shrinkage,
            prior=resolution_covariance(options.compared),
            metric=descriptor.metric,
            options_digest=options.compared_digest,
        )
    sample = pair_sample(values, labels)  # before the values are whitened in place
    index = SignatureIndex.of_coordinates(
        names,
        values,
        labels,
        MadeBy(descriptor.name, options.compared_digest, descriptor.metric, unit),
        options.retrieval,
        whitening,
    )
    scores = fit_scores(
        sample,
        index.whitening,
        distance=options.retrieval.distance,
        shrinkage=options.retrieval.shrinkage,
        metric=descriptor.metric,
    )
    return index.scored(scores), revision


def _described(
    rows: Rows,
    own: PipelineOptions,
    digest: str,
    options: PipelineOptions,
    shape_ids: Sequence[str],
) -> list[FloatArray]:
    """Compute the signatures (L,) of some shapes, and store them if the store can be written to."""
    from pcretrieve.descriptors import DESCRIPTORS, describe

    needs = DESCRIPTORS[options.signature.method].needs
    made: list[FloatArray] = []
    unkept: list[tuple[Record, bytes]] = []

    def keep() -> None:
        if unkept and rows.database.is_writable:
            rows.keep(digest, unkept)
        unkept.clear()

    try:
        for shape_id in shape_ids:
            record, shape = read_shape(rows, own, shape_id, needs)
            try:
                made.append(describe(shape, options.compared).values)
            except ShapeError as error:
                error.shape_id = shape_id
                raise
            unkept.append((record, packed_values(made[-1])))
            if len(made) % KEPT_AT_ONCE == 0:
                logger.info("%s: %d of %d shapes", options.signature.method, len(made), len(shape_ids))
                keep()
    finally:
        keep()
    return made
