"""The class that neighbours vote for, and the ranks within the error bar of a query."""

from __future__ import annotations

import numpy as np

from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval import SignatureIndex, Vote, class_vote, rank_ranges
from pcretrieve.values import Signature, SignatureTable

PLAIN = RetrievalOptions(whitening="none")


def test_votes_are_weighted() -> None:
    weights = np.array([0.5, 0.25, 0.5, 0.75])
    assert class_vote(["cat", "dog", "dog", None], weights) == Vote("dog", 0.6, 0.25 / 1.25, 3)
    assert class_vote(["cat", "dog"], np.ones(2)) == Vote("cat", 0.5, 0, 2)
    assert class_vote(["cat"], np.ones(1)) == Vote("cat", 1, 1, 1)
    assert class_vote([None], np.ones(1)) is None
    assert class_vote(["cat"], np.zeros(1)) is None
    assert class_vote([], np.zeros(0)) is None


def line(places: list[float]) -> SignatureIndex:
    """Shapes on a line through the origin of log-signatures of two values."""
    logs = np.stack([np.array(places), np.zeros(len(places))], axis=1)
    table = SignatureTable(tuple("abcdefgh"[: len(places)]), np.exp(logs), "any")
    return SignatureIndex(table, PLAIN)


def test_ranks_swap_where_the_error_bar_covers_the_middle() -> None:
    """The query is at 0, two shapes beyond the middle of their places are equally near."""
    index, query = line([1.0, -1.1, 5.0, 5.05]), Signature(np.ones(2), "any")
    for deviation, expected in (
        ([0.001, 0.0], [[1, 1], [2, 2], [3, 3], [4, 4]]),
        ([0.2, 0.0], [[1, 2], [1, 2], [3, 3], [4, 4]]),
        ([5.0, 0.0], [[1, 3], [1, 4], [1, 3], [1, 4]]),
        ([0.0, 3.0], [[1, 1], [2, 2], [3, 3], [4, 4]]),  # at right angles to the line
    ):
        ranges = rank_ranges(index, query, np.array(deviation), "abcd")
        np.testing.assert_array_equal(ranges[:, 0] <= np.arange(1, 5), True)
        np.testing.assert_array_equal(ranges[:, 1] >= np.arange(1, 5), True)
        if max(deviation) < 1 or deviation[0] == 0:
            np.testing.assert_array_equal(ranges, expected)
        else:
            assert (ranges[:, 1] - ranges[:, 0] >= 2).all()
