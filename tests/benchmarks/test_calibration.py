"""Whitenings that are fitted to a few classes, and measured on the others."""

from dataclasses import replace

import numpy as np

from pcretrieve.benchmarks.calibration import calibrated_measures
from pcretrieve.benchmarks.tables import MEASURES
from pcretrieve.evaluation import evaluate_table
from pcretrieve.options import RetrievalOptions
from pcretrieve.values import SignatureTable

MAP = MEASURES.index("mAP")


def posed(n_classes: int = 20, per_class: int = 6) -> SignatureTable:
    """Classes that differ where poses do not."""
    rng = np.random.default_rng(0)
    centres = rng.normal(size=(n_classes, 8)) * np.geomspace(0.3, 0.02, 8)
    poses = rng.normal(size=(n_classes * per_class, 8)) * np.geomspace(0.02, 1.0, 8)
    values = np.exp(np.repeat(centres, per_class, axis=0) + poses)
    labels = tuple(f"class {row // per_class:02}" for row in range(len(values)))
    return SignatureTable(tuple(f"{row:03}" for row in range(len(values))), values, "x", labels=labels)


def test_what_poses_change_is_learned_from_a_few_classes() -> None:
    table = posed()
    plain = evaluate_table(table, RetrievalOptions(whitening="none")).map
    rows = calibrated_measures(table, 5, n_draws=6)
    assert rows.shape == (6, len(MEASURES))
    assert rows[:, MAP].mean() > plain + 0.2
    np.testing.assert_array_equal(rows, calibrated_measures(table, 5, n_draws=6))


def test_classes_of_the_fit_are_neither_queries_nor_in_the_gallery() -> None:
    """With the labels of all but two classes drawn, these two are all that can be confused."""
    table = posed(n_classes=6)
    spread = replace(table, values=table.values * np.exp(np.repeat(np.arange(6.0) * 50, 6))[:, np.newaxis])
    assert evaluate_table(spread, RetrievalOptions(whitening="none")).e < 0.4
    # 11 of the 12 shapes of the other two classes are shown to a query, of which 5 are relevant.
    np.testing.assert_allclose(calibrated_measures(spread, 4, n_draws=3)[:, MEASURES.index("E")], 10 / 16)
