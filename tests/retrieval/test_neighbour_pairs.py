"""Pairs of shapes of one class are found without labels."""

import numpy as np
import pytest

from pcretrieve.retrieval import Positions
from pcretrieve.retrieval.pairs import LARGEST, MOST_NEIGHBORS, N_NEIGHBORS, neighbour_pairs
from pcretrieve.values import FloatArray


def classes_of(size: int, n_classes: int, *, spread: float = 0.1) -> FloatArray:
    """Isolated classes of equal size in ten dimensions."""
    rng = np.random.default_rng(size)
    centres = rng.normal(size=(n_classes, 10))
    return np.repeat(centres, size, axis=0) + spread * rng.normal(size=(size * n_classes, 10))


@pytest.mark.parametrize("size", [3, 5, 8, 10])
def test_the_number_of_neighbours_is_the_size_of_isolated_classes_less_one(size: int) -> None:
    pairs = neighbour_pairs(classes_of(size, 12))
    assert pairs.n_neighbors == size - 1
    np.testing.assert_array_equal(pairs.first // size, pairs.second // size)
    assert len(pairs.weights) == 12 * size * (size - 1) // 2


def test_without_classes_no_number_stands_out() -> None:
    assert neighbour_pairs(np.random.default_rng(0).normal(size=(200, 10))).n_neighbors == N_NEIGHBORS


def test_most_pairs_are_of_one_class_where_classes_overlap() -> None:
    logs = classes_of(10, 40, spread=0.35)
    pairs = neighbour_pairs(logs)
    same = pairs.first // 10 == pairs.second // 10
    assert 0.7 < same.mean() < 1
    # Pairs between classes share few neighbours, and differ more: their weights are smaller.
    assert pairs.weights[~same].mean() < 0.7 * pairs.weights[same].mean()


def test_copies_form_no_pairs_and_do_not_outweigh_others() -> None:
    logs = classes_of(5, 12)
    logs[1] = logs[0]
    logs[6] = logs[5] + 1e-14
    pairs = neighbour_pairs(logs)
    assert (0, 1) not in set(zip(pairs.first.tolist(), pairs.second.tolist(), strict=True))
    assert pairs.weights.max() * pairs.weights.min() ** -1 < 1e10
    assert neighbour_pairs(np.ones((30, 3))).weights.size == 0


def test_pairs_do_not_depend_on_the_order_of_shapes() -> None:
    logs = classes_of(5, 20, spread=0.4)
    order = np.random.default_rng(1).permutation(100)
    there, here = neighbour_pairs(logs[order]), neighbour_pairs(logs)
    assert unordered(order[there.first], order[there.second]) == unordered(here.first, here.second)


def unordered(first: Positions, second: Positions) -> set[frozenset[int]]:
    return {frozenset(pair) for pair in zip(first.tolist(), second.tolist(), strict=True)}


def test_pairs_of_many_shapes_are_those_of_groups_of_near_ones() -> None:
    size = 5
    logs = classes_of(size, LARGEST)  # 20,000 shapes
    pairs = neighbour_pairs(logs)
    assert 100 < len(pairs.weights) < LARGEST * MOST_NEIGHBORS
    assert (pairs.first // size == pairs.second // size).mean() > 0.9
