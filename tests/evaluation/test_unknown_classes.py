"""How good the answer "no match" is, by queries of classes that are not in the gallery."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.retrieval import no_match_measures

from pcretrieve.errors import BenchmarkError
from pcretrieve.options import RetrievalOptions
from pcretrieve.values import SignatureTable


def table(spread: float, n_classes: int = 12, n_each: int = 6) -> SignatureTable:
    rng = np.random.default_rng(0)
    centres = np.repeat(rng.normal(size=(n_classes, 5)), n_each, axis=0)
    logs = centres + spread * rng.normal(size=centres.shape)
    labels = tuple(f"class{row // n_each}" for row in range(len(logs)))
    return SignatureTable(tuple(f"{row:03}" for row in range(len(logs))), np.exp(logs), "any", labels=labels)


@pytest.mark.parametrize("labelled", [True, False])
def test_of_distinct_classes_all_answers_are_right(labelled: bool) -> None:
    found = no_match_measures(table(1e-3), labelled=labelled)
    assert (found.precision, found.recall, found.matched, found.right) == (1, 1, 1, 1)
    assert found.n_queries == 10 * 12 * 2
    assert ("within-class" in found.whitening) == labelled


def test_of_classes_without_differences_there_is_no_match() -> None:
    """The least score is then never reached, and half of the queries are of classes in the gallery."""
    mixed = table(50.0)
    found = no_match_measures(mixed, RetrievalOptions(whitening="none"))
    assert (found.matched, found.recall) == (0, 1)
    assert found.precision == pytest.approx(0.5)
    assert math.isnan(found.right)
    lax = no_match_measures(mixed, RetrievalOptions(whitening="none"), min_score=0)
    assert (lax.matched, lax.recall) == (1, 0)
    assert math.isnan(lax.precision)
    assert lax.right < 0.5


def test_classes_must_be_left_out_of_others() -> None:
    alone = replace(table(0.1), labels=("one",) * 6 + (None,) * 66)
    with pytest.raises(BenchmarkError, match="two classes of 3 shapes or more, got 1"):
        no_match_measures(alone)
