"""Catalogue → pairs of shapes that are nearer than the noise, such as two scans of one body in one pose."""

from __future__ import annotations

import numpy as np

from pcretrieve.catalogue import Catalogue
from pcretrieve.errors import InputError, OptionError
from pcretrieve.options import PipelineOptions
from pcretrieve.retrieval import NearPair, SignatureIndex, near_pairs

__all__ = ["duplicates"]


def duplicates(
    catalogue: Catalogue, *, options: PipelineOptions | None = None, threshold: float | None = None
) -> list[NearPair]:
    """Find the pairs of shapes that are nearer than their uncertainties let expect.

    Parameters
    ----------
    catalogue : Catalogue
        The shapes.
    options : PipelineOptions, optional
        The signatures; with a `threshold` also the distance and the whitening. By default those of the
        catalogue.
    threshold : float, optional
        The largest distance of a pair. By default the root of the sum of squares of the uncertainties of both
        shapes, for the distance ``log`` without whitening, to which they are comparable; shapes that are
        doubtful or unusable are then left out, because they are near to many.

    Returns
    -------
    list of NearPair
        Nearest first.

    Raises
    ------
    CatalogueError
        If `options` require other spectra than the catalogue has.
    InputError
        If the catalogue has no shapes; without `threshold`, if the signatures are not compared by logarithms.
    OptionError
        If the threshold is negative or not finite.
    """
    options = options or catalogue.options
    if threshold is not None:
        if not 0 <= threshold < np.inf:
            raise OptionError(f"threshold must be 0 or more, got {threshold}")
        index = catalogue.index(options)
        # Each of two equal errors is the part of the threshold that adds up to it.
        return near_pairs(index, np.full(len(index), threshold / np.sqrt(2)))
    plain = options.changed(retrieval={"distance": "log", "whitening": "none", "calibration": None})
    table = catalogue.signatures(plain)
    if table.metric != "logarithms":
        raise InputError(
            f"uncertainties are those of logarithms, as which {table.kind} is not compared: give a threshold"
        )
    errors = {
        record.id: 0.0 if record.verdict is None else record.verdict.uncertainty
        for page in catalogue.pages(status="done")
        for record in page
        if not record.is_doubtful
    }
    ids = [shape_id for shape_id in table.ids if shape_id in errors]
    if not ids:
        return []
    index = SignatureIndex(table.select(ids), plain.retrieval)
    return near_pairs(index, np.array([errors[shape_id] for shape_id in index.ids]))
