"""The signatures of a catalogue's shapes by one descriptor, computed from what the catalogue has stored."""

from __future__ import annotations

import statistics
from functools import partial
from typing import NamedTuple

import numpy as np

from pcretrieve.benchmarks.timing import timed
from pcretrieve.catalogue import Catalogue
from pcretrieve.descriptors import DESCRIPTORS, describe
from pcretrieve.errors import ShapeError
from pcretrieve.options import SignatureOptions
from pcretrieve.values import FloatArray, Signature, SignatureTable

__all__ = ["Described", "described"]


class Described(NamedTuple):
    """The signatures of a catalogue's shapes by one descriptor.

    Attributes
    ----------
    table : SignatureTable
        The signatures.
    failed : dict of str to (str or None)
        Classes of the shapes without such a signature.
    seconds : float
        Median time of a signature.
    """

    table: SignatureTable
    failed: dict[str, str | None]
    seconds: float


def described(catalogue: Catalogue, options: SignatureOptions) -> Described:
    """Compute the signatures of all shapes from their stored spectra and surfaces.

    Parameters
    ----------
    catalogue : Catalogue
        The shapes; those that failed have no signature.
    options : SignatureOptions
        The descriptor.

    Returns
    -------
    Described
        The signatures.
    """
    values: dict[str, FloatArray] = {}
    times = []
    labels = {record.id: record.label for record in catalogue.records()}

    def signature(shape_id: str) -> Signature:
        return describe(catalogue.shape(shape_id, DESCRIPTORS[options.method].needs), options)

    for shape_id in catalogue.signatures().ids:
        try:
            seconds, found = timed(partial(signature, shape_id))
        except ShapeError:
            continue  # counts as a miss
        values[shape_id] = found.values
        times.append(seconds)
    classes = tuple(labels[shape_id] for shape_id in values)
    table = SignatureTable(
        tuple(values),
        np.array(list(values.values())),
        options.method,
        labels=classes,
        metric=DESCRIPTORS[options.method].metric,
    )
    failed = {shape_id: label for shape_id, label in labels.items() if shape_id not in values}
    return Described(table, failed, statistics.median(times))
