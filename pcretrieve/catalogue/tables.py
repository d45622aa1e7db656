"""Rows → a table of signatures, of which those that are missing are computed and kept."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pcretrieve.catalogue.arrays import packed_values, unpacked_values
from pcretrieve.catalogue.opening import intact
from pcretrieve.catalogue.record import Record
from pcretrieve.catalogue.rows import OWN, Revision, Rows
from pcretrieve.catalogue.surfaces import read_shape
from pcretrieve.errors import ShapeError
from pcretrieve.names import METHODS
from pcretrieve.options import PipelineOptions
from pcretrieve.retrieval import DISTANCES, SignatureIndex, Whitening, resolution_whitening
from pcretrieve.retrieval.distances import check_comparable, coordinates
from pcretrieve.retrieval.lower_bounds import BLOCK
from pcretrieve.retrieval.names import Names
from pcretrieve.types import FloatArray, SignatureTable

__all__ = ["index_name", "made_index", "resolution_of", "signature_table"]

logger = logging.getLogger(__name__)

# Signatures that are computed before they are kept: what was done is not lost when the rest is stopped.
KEPT_AT_ONCE = 100


def resolution_of(options: PipelineOptions) -> Whitening | None:
    """The whitening that is not fitted to shapes, where it is asked for.

    Parameters
    ----------
    options : PipelineOptions
        Of which `retrieval` asks for a whitening.

    Returns
    -------
    Whitening or None
        None for the other whitenings.
    """
    if options.retrieval.whitening != "resolution":
        return None
    damping = options.retrieval.damping
    return resolution_whitening(options.compared, damping=damping, options_digest=options.compared_digest)


def index_name(options: PipelineOptions) -> str:
    """What an index depends on beside the shapes: its signatures, the distance, and the whitening.

    Parameters
    ----------
    options : PipelineOptions
        The options that ask for the index.

    Returns
    -------
    str
        Equal for equal indexes.
    """
    retrieval = options.retrieval
    distance = retrieval.distance + DISTANCES.version(retrieval.distance)
    return f"{_digest_of(options)} {distance} {retrieval.whitening} {retrieval.damping}"


def _digest_of(options: PipelineOptions) -> str:
    """What the signatures that are compared by some options depend on."""
    # A package that is upgraded may give other values by the same options.
    method = options.signature.method
    if method in METHODS:
        return options.compared_digest
    from pcretrieve.descriptors import DESCRIPTORS

    return options.compared_digest + DESCRIPTORS.version(method)


class Signatures(NamedTuple):
    """The signatures of all shapes that did not fail.

    Attributes
    ----------
    revision : Revision
        The state of the catalogue that they are of.
    ids : list of str
        Ascending.
    labels : list of (str or None)
    values : (N, L) float64
    """

    revision: Revision
    ids: list[str]
    labels: list[str | None]
    values: FloatArray


def read_signatures(rows: Rows, own: PipelineOptions, options: PipelineOptions) -> Signatures:
    """The signatures that options ask for, which are computed where they are not kept."""
    # Only for those who read all signatures: the descriptors bring scipy.
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
    """The signatures that options ask for, which are computed and kept where they are missing.

    Parameters
    ----------
    rows : Rows
        The store.
    own : PipelineOptions
        The options that the catalogue was built with.
    options : PipelineOptions
        With any options of signatures and retrieval.

    Returns
    -------
    SignatureTable
        Of all shapes that did not fail, by id.

    Raises
    ------
    ShapeError
        If a shape has no such signature.
    """
    from pcretrieve.descriptors import DESCRIPTORS

    descriptor = DESCRIPTORS[options.signature.method]
    _, ids, labels, values = read_signatures(rows, own, options)
    made_by = descriptor.name, options.compared_digest
    return SignatureTable(tuple(ids), values, *made_by, tuple(labels), descriptor.metric)


def made_index(rows: Rows, own: PipelineOptions, options: PipelineOptions) -> tuple[SignatureIndex, Revision]:
    """The index of the signatures that options ask for, and the state of the catalogue that it is of.

    Unless it is whitened by class, no more than two arrays of the size of the table are in memory at a time.

    Parameters
    ----------
    rows : Rows
        The store.
    own : PipelineOptions
        The options that the catalogue was built with.
    options : PipelineOptions
        With any options of signatures and retrieval.

    Returns
    -------
    index : SignatureIndex
        With the whitening of the signatures.
    revision : Revision
        The state of the store.
    """
    from pcretrieve.descriptors import DESCRIPTORS

    descriptor = DESCRIPTORS[options.signature.method]
    check_comparable(descriptor.name, descriptor.metric, options.retrieval.distance)
    revision, ids, labels, values = read_signatures(rows, own, options)
    # In place: the table has been read for the index alone.
    for start in range(0, len(values), BLOCK):
        block = slice(start, start + BLOCK)
        values[block] = coordinates(values[block], descriptor.metric)
    names = Names.of(ids)
    if options.retrieval.whitening != "within-class":
        labels = []  # only that whitening asks for them
    del ids
    index = SignatureIndex.of_coordinates(
        names,
        values,
        labels,
        (descriptor.name, options.compared_digest, descriptor.metric),
        options.retrieval,
        resolution_of(options),
    )
    return index, revision


def _described(
    rows: Rows,
    own: PipelineOptions,
    digest: str,
    options: PipelineOptions,
    shape_ids: Sequence[str],
) -> list[FloatArray]:
    """Signatures (L,) of shapes that have none by these options, which are kept where that can be."""
    from pcretrieve.descriptors import DESCRIPTORS, describe

    needs = DESCRIPTORS[options.signature.method].needs
    made: list[FloatArray] = []
    unkept: list[tuple[Record, bytes]] = []

    def keep() -> None:
        if unkept and rows.is_writable:
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
