"""Averages and measures of classes, confusions, and the files of both, worked by hand."""

import csv
from pathlib import Path

import numpy as np
import pytest

from pcretrieve.errors import InputError
from pcretrieve.evaluation.comparison import read_scores, write_evaluation
from pcretrieve.evaluation.measures import class_measures, confusion, evaluate_rankings, query_scores
from pcretrieve.evaluation.rankings import Rankings, rank_gallery
from pcretrieve.retrieval import DistanceBlock

# Who finds whom first: X = abc, Y = de, and z has no class.
ORDERS = {"a": "bczde", "b": "dacez", "c": "zabde", "d": "eabcz", "e": "abcdz", "z": "abcde"}
LABELS = {"a": "X", "b": "X", "c": "X", "d": "Y", "e": "Y", "z": None}


@pytest.fixture
def ranked() -> Rankings:
    distances = [[0 if i == j else 1 + order.index(j) for j in ORDERS] for i, order in ORDERS.items()]
    block = DistanceBlock(np.arange(6), np.array(distances, dtype=np.float64))
    return rank_gallery([block], list(ORDERS), list(LABELS.values()), failed={"lost": "Y"})


def test_a_macro_average_gives_classes_one_weight(ranked: Rankings) -> None:
    scores = query_scores(ranked)
    x, y = scores.ap[:3].mean(), scores.ap[3:].mean()
    assert x != y
    assert evaluate_rankings(ranked, average="macro").map == pytest.approx((x + y) / 2)
    assert evaluate_rankings(ranked).map == pytest.approx(scores.ap.mean())
    assert evaluate_rankings(ranked, average="macro").nn == pytest.approx((1 / 3 + 1 / 3) / 2)


def test_measures_and_confusions_of_classes(ranked: Rankings) -> None:
    x, y = class_measures(ranked)
    assert (x.label, x.n_queries, x.confused) == ("X", 3, ((None, 1), ("Y", 1)))
    assert (y.label, y.n_queries, y.confused) == ("Y", 3, (("X", 1),))
    np.testing.assert_allclose(x.means, query_scores(ranked).columns[:3].mean(axis=0))
    found = confusion(ranked)
    assert (found.labels, found.nearest) == (("X", "Y"), ("X", "Y", None))
    assert found.counts.tolist() == [[1, 1, 1], [1, 1, 0]]


def test_files_of_an_evaluation(ranked: Rankings, tmp_path: Path) -> None:
    written = write_evaluation(ranked, tmp_path / "new" / "folder")
    tables = {path.stem: list(csv.reader(path.read_text(encoding="utf-8").splitlines())) for path in written}
    assert tables["confusion"] == [["label", "X", "Y", ""], ["X", "1", "1", "1"], ["Y", "1", "1", "0"]]
    assert [row[:2] for row in tables["classes"]] == [["label", "n_queries"], ["X", "3"], ["Y", "3"]]
    assert float(tables["classes"][1][7]) == class_measures(ranked)[0].means[5]
    assert tables["queries"][3][0] == "c"
    assert tables["queries"][3][-2:] == ["z", ""]
    assert tables["queries"][6][0] == "lost"
    assert [row[0] for row in tables["precision_recall"]][:2] == ["recall", "0.0"]
    assert len(tables["precision_recall"]) == 12
    assert read_scores(written[0]) == query_scores(ranked)


def test_files_that_hold_no_measures(tmp_path: Path) -> None:
    head = "id,label,nn,ft,st,e,dcg"
    for text, message in (
        (f"{head}\na,X,1,1,1,1,1\n", "must have the columns id, label, nn, ft, st, e, dcg, ap"),
        (f"{head},ap\na,X,1,1,1,1,1,one\n", "must have the columns"),
        (f"{head},ap\na,X,1,1,1,1\n", "must have the columns"),
        (f"{head},ap\n", "must have each query once, got 0 rows of 0 queries"),
        (f"{head},ap\na,X,1,1,1,1,1,1\na,X,1,1,1,1,1,1\n", "got 2 rows of 1 queries"),
        (f"{head},ap\na,X,1,1,1,1,1,1.5\n", "must lie between 0 and 1"),
        (f"{head},ap\na,X,1,1,1,1,1,nan\n", "must lie between 0 and 1"),
    ):
        (tmp_path / "queries.csv").write_text(text)
        with pytest.raises(InputError, match=message):
            read_scores(tmp_path / "queries.csv")
