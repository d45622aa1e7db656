"""How well shapes are retrieved after a whitening that is fitted to a few labelled classes of a set.

The classes of the fit are neither queries nor in the gallery, as if `pcretrieve calibrate` had been applied
to the scans of a few people, and its whitening to a catalogue of others.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from pcretrieve.benchmarks.tables import measure_values
from pcretrieve.evaluation import evaluate_table
from pcretrieve.evaluation.rankings import NO_FAILURES
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval import CALIBRATED, table_whitening
from pcretrieve.values import FloatArray, SignatureTable

__all__ = ["N_DRAWS", "calibrated_measures"]

#: Number of random draws of the classes of the fit.
N_DRAWS = 50

SEED = 0


def calibrated_measures(
    table: SignatureTable,
    n_classes: int,
    options: RetrievalOptions | None = None,
    *,
    n_draws: int = N_DRAWS,
    failed: Mapping[str, str | None] = NO_FAILURES,
) -> FloatArray:
    """Retrieval measures of random draws of the classes of the fit.

    Parameters
    ----------
    table : SignatureTable
        Signatures with labels.
    n_classes : int
        Number of classes to which the whitening is fitted.
    options : RetrievalOptions, optional
        The distance, the shrinkage and the re-ranking.
    n_draws : int, default 50
        Number of draws, from the seed 0.
    failed : mapping of str to (str or None), optional
        Classes by id of the shapes that failed. Those in the classes of the fit are left out.

    Returns
    -------
    (n_draws, 6) float64
        The measures of `pcretrieve.benchmarks.tables.MEASURES`.
    """
    options = options or RetrievalOptions()
    within = options.model_copy(update={"whitening": "within-class"})
    rng = np.random.default_rng(SEED)
    rows = []
    for drawn in _draws(table, n_classes, n_draws, rng):
        fitted = [shape_id for shape_id, label in zip(table.ids, table.labels, strict=True) if label in drawn]
        others = [shape_id for shape_id in table.ids if shape_id not in set(fitted)]
        whitening = replace(table_whitening(table.select(fitted), within), kind=CALIBRATED)
        misses = {shape_id: label for shape_id, label in failed.items() if label not in drawn}
        measures = evaluate_table(table.select(others), options, whitening=whitening, failed=misses)
        rows.append(measure_values(measures))
    return np.array(rows)


def _draws(
    table: SignatureTable, n_classes: int, n_draws: int, rng: np.random.Generator
) -> Iterator[set[str]]:
    classes = sorted({label for label in table.labels if label is not None})
    for _ in range(n_draws):
        yield {classes[number] for number in rng.choice(len(classes), n_classes, replace=False)}
