"""Pairwise matchers: they rank as any other source of distances, by what they learn from the gallery too."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
import shapes

from pcretrieve.matching import MATCHERS, DistanceMatrix, Matcher, match_all
from pcretrieve.matching.heat import HeatPoints, heat_distance, heat_points, heat_set, word_frequencies
from pcretrieve.values import Failure, FloatArray, Shape


def egg(length: float, *, subdivisions: int = 3) -> Shape:
    return shapes.shape(shapes.ellipsoid((1, 1, length), subdivisions=subdivisions))


def width_of(shape: Shape) -> float:
    return float(np.ptp(shape.mesh.vertices[:, 2]))


def lacking(query: float, other: float) -> float:
    """What a query is longer by: no distance from long shapes to short ones alone."""
    return max(0.0, query - other)


LACKING = Matcher("lacking", width_of, lacking, needs=("mesh",), symmetric=False)
LENGTHS = {"c": 1.0, "a": 2.0, "b": 1.5, "d": 1.5}


def lengths(matcher: Matcher, failures: list[Failure] | None = None) -> DistanceMatrix:
    failed = [] if failures is None else failures
    return match_all(matcher, LENGTHS, lambda name: egg(LENGTHS[name], subdivisions=1), failed.append)


def apart(query: float, other: float) -> float:
    return abs(query - other)


def test_each_distance_is_that_of_the_matcher_from_the_query() -> None:
    """Of a symmetric distance, half are computed."""
    matrix = lengths(LACKING)
    assert matrix.ids == ("c", "a", "b", "d")
    size = [width_of(egg(length, subdivisions=1)) for length in LENGTHS.values()]
    np.testing.assert_array_equal(matrix.values, [[lacking(one, two) for two in size] for one in size])
    calls = []

    def counted(query: float, other: float) -> float:
        calls.append((query, other))
        return apart(query, other)

    matrix = lengths(replace(LACKING, distance=counted, symmetric=True))
    assert len(calls) == 4 + 3 + 2 + 1
    np.testing.assert_array_equal(matrix.values, [[apart(one, two) for two in size] for one in size])


def test_a_shape_that_a_matcher_fails_on_is_left_out() -> None:
    def clumsy(shape: Shape) -> float:
        if width_of(shape) > 3:
            raise IndexError("list index out of range")
        return width_of(shape)

    failures: list[Failure] = []
    assert lengths(replace(LACKING, prepare=clumsy), failures).ids == ("c", "b", "d")
    (failure,) = failures
    assert (failure.shape_id, failure.stage, failure.error) == ("a", "signature", "ShapeError")
    assert failure.message == "the matcher 'lacking' failed, IndexError: list index out of range"


def test_distances_are_those_of_what_all_shapes_taught() -> None:
    def relative_to_the_longest(gallery: Sequence[float]) -> Callable[[float], float]:
        longest = max(gallery)
        return lambda length: length / longest

    matcher = Matcher("relative", width_of, apart, needs=("mesh",), learn=relative_to_the_longest)
    assert lengths(matcher).values[1] == pytest.approx([0.5, 0, 0.25, 0.25])


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
    features = {name: heat_points(shapes.shape(mesh)) for name, mesh in meshes.items()}
    frequencies_of = word_frequencies(list(features.values()))
    for each in features.values():
        frequencies = frequencies_of(each)
        assert frequencies.shape == (48,)
        assert frequencies.sum() == pytest.approx(1)
        assert (frequencies >= 0).all()
    matrix = match_all(MATCHERS["hks-bow-gallery"], meshes, lambda name: shapes.shape(meshes[name]))
    for name in ("egg", "long", "body"):
        assert matrix.nearest(name, 2).ids[1] == f"{name} again"
    assert matrix.values[0, 2] > 0.1
