"""Pairwise matchers: they rank as any other source of distances, by what they learn from the gallery too."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
import shapes

from pcretrieve.errors import ShapeError
from pcretrieve.matching import MATCHERS, Matcher, PairwiseIndex, distance_matrix
from pcretrieve.matching.heat import HeatPoints, heat_distance, heat_set
from pcretrieve.retrieval import Ranking
from pcretrieve.values import FloatArray, Shape


def egg(length: float, *, subdivisions: int = 3) -> Shape:
    return shapes.shape(shapes.ellipsoid((1, 1, length), subdivisions=subdivisions))


def width_of(shape: Shape) -> float:
    return float(np.ptp(shape.mesh.vertices[:, 2]))


def lacking(query: float, other: float) -> float:
    """What a query is longer by: no distance from long shapes to short ones alone."""
    return max(0.0, query - other)


LACKING = Matcher("lacking", width_of, lacking, needs=("mesh",), symmetric=False)
LENGTHS = {"c": 1.0, "a": 2.0, "b": 1.5, "d": 1.5}


def lengths(matcher: Matcher = LACKING) -> PairwiseIndex:
    return PairwiseIndex(matcher, LENGTHS, lambda shape_id: egg(LENGTHS[shape_id], subdivisions=1))


# --- the gallery ----------------------------------------------------------------------------------------


def test_each_distance_is_that_of_the_matcher_from_the_query() -> None:
    index: Ranking = lengths()
    assert index.ids == ("c", "a", "b", "d")
    size = [width_of(egg(length, subdivisions=1)) for length in LENGTHS.values()]
    expected = [[max(0.0, query - other) for other in size] for query in size]
    matrix = distance_matrix(index)
    np.testing.assert_array_equal(matrix.values, expected)
    rows = {int(block.queries[0]): block.distances[0] for block in index.blocks(np.array([3, 1]))}
    np.testing.assert_array_equal([rows[1], rows[3]], [expected[1], expected[3]])
    for shape_id in index.ids:
        assert index.nearest(shape_id, 3) == matrix.nearest(shape_id, 3)
    assert index.nearest("a", 4).ids == ("a", "b", "d", "c")


def test_of_a_symmetric_distance_half_are_computed() -> None:
    calls = []

    def apart(query: float, other: float) -> float:
        calls.append((query, other))
        return abs(query - other)

    matrix = distance_matrix(lengths(replace(LACKING, distance=apart, symmetric=True)))
    assert len(calls) == 4 + 3 + 2 + 1
    np.testing.assert_array_equal(matrix.values, matrix.values.T)
    np.testing.assert_array_equal(
        matrix.values, distance_matrix(lengths(replace(LACKING, distance=apart))).values
    )


def test_a_new_shape_is_compared_with_the_gallery() -> None:
    found = lengths().query(egg(1.5, subdivisions=1), 3)
    assert found.ids == ("a", "b", "d")
    assert found.distances.tolist() == [0, 0, 0]
    assert pickle.loads(pickle.dumps(lengths())).query(egg(1.5, subdivisions=1), 3) == found


def test_a_shape_that_a_matcher_fails_on_is_left_out() -> None:
    def clumsy(shape: Shape) -> float:
        if width_of(shape) > 3:
            raise IndexError("list index out of range")
        return width_of(shape)

    index = lengths(replace(LACKING, prepare=clumsy))
    assert index.ids == ("c", "b", "d")
    (failure,) = index.failures
    assert (failure.shape_id, failure.stage, failure.error) == ("a", "signature", "ShapeError")
    assert failure.message == "the matcher 'lacking' failed, IndexError: list index out of range"
    with pytest.raises(ShapeError, match="the matcher 'lacking' failed, IndexError"):
        index.query(egg(2, subdivisions=1))


def relative_to_the_longest(gallery: Sequence[float]) -> Callable[[float], float]:
    longest = max(gallery)
    return lambda length: length / longest


def test_distances_are_those_of_what_the_gallery_taught() -> None:
    def apart(query: float, other: float) -> float:
        return abs(query - other)

    matcher = Matcher("relative", width_of, apart, needs=("mesh",), learn=relative_to_the_longest)
    index = lengths(matcher)
    assert index.features == pytest.approx((0.5, 1, 0.75, 0.75))
    assert distance_matrix(index).values[1] == pytest.approx([0.5, 0, 0.25, 0.25])
    # A query is measured by the gallery, and teaches it nothing.
    found = index.query(egg(3.0, subdivisions=1), 4)
    assert found.ids == ("a", "b", "d", "c")
    assert found.distances == pytest.approx((0.5, 0.75, 0.75, 1))


# --- heat kernel signatures -----------------------------------------------------------------------------


def by_hand(query: FloatArray, other: FloatArray) -> float:
    """The directed distance, without weights."""
    return float(np.mean([min(np.linalg.norm(one - there) for there in other) for one in query]))


def test_the_distance_is_the_larger_mean_of_smallest_distances() -> None:
    rng = np.random.default_rng(0)
    one, two = rng.normal(size=(7, 6)), rng.normal(size=(5, 6)) + 1
    sets = [HeatPoints(features, np.full(len(features), 1 / len(features))) for features in (one, two)]
    expected = max(by_hand(one, two), by_hand(two, one))
    assert heat_distance(*sets) == pytest.approx(expected)
    assert heat_distance(*sets) == heat_distance(*sets[::-1])
    assert heat_distance(sets[0], sets[0]) == 0


def test_size_place_and_order_of_vertices_do_not_count() -> None:
    mesh = shapes.ellipsoid((1, 1.2, 2), subdivisions=3)
    other = shapes.renumbered(shapes.moved(mesh, 3, scale=10), 0)
    made = heat_set(shapes.shape(mesh))
    assert heat_distance(made, heat_set(shapes.shape(other))) < 0.02 * heat_distance(made, heat_set(egg(2.5)))


def test_words_of_a_gallery_are_shares_of_the_surface_by_which_a_moved_copy_is_nearest() -> None:
    meshes = {
        "egg": shapes.ellipsoid((1, 1, 1.5), subdivisions=3),
        "long": shapes.ellipsoid((1, 1, 3), subdivisions=3),
        "body": shapes.body(3),
    }
    meshes |= {f"{name} again": shapes.moved(mesh, 1) for name, mesh in meshes.items()}
    index = PairwiseIndex(
        MATCHERS["hks-bow-gallery"], meshes, lambda shape_id: shapes.shape(meshes[shape_id])
    )
    for frequencies in index.features:
        assert frequencies.shape == (48,)
        assert frequencies.sum() == pytest.approx(1)
        assert (frequencies >= 0).all()
    for name in ("egg", "long", "body"):
        assert index.nearest(name, 2).ids[1] == f"{name} again"
    assert np.abs(index.features[0] - index.features[2]).sum() > 0.1
    query = shapes.shape(shapes.moved(meshes["long"], 2))
    assert pickle.loads(pickle.dumps(index)).query(query) == index.query(query)
