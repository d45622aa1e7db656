"""Words that are learned from the gallery, and matchers that learn in general."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence

import numpy as np
import pytest
import shapes

from pcretrieve.matching import MATCHERS, Matcher, PairwiseIndex, distance_matrix
from pcretrieve.matching.heat import word_distance
from pcretrieve.values import Shape, Surface, TriangleMesh

LENGTHS = {"a": 2.0, "b": 1.5, "c": 1.0}


def shape(mesh: TriangleMesh) -> Shape:
    return Shape((Surface(mesh.area, mesh=mesh),))


def egg(length: float) -> Shape:
    return shape(shapes.ellipsoid((1, 1, length), subdivisions=2))


def length_of(shape: Shape) -> float:
    return float(np.ptp(shape.mesh.vertices[:, 2]))


def relative_to_the_longest(gallery: Sequence[float]) -> Callable[[float], float]:
    longest = max(gallery)
    return lambda length: length / longest


RELATIVE = Matcher(
    "relative",
    length_of,
    lambda query, other: abs(query - other),
    needs=("mesh",),
    learn=relative_to_the_longest,
)


def test_distances_are_those_of_what_the_gallery_taught() -> None:
    index = PairwiseIndex(RELATIVE, LENGTHS, lambda shape_id: egg(LENGTHS[shape_id]))
    assert index.features == pytest.approx((1, 0.75, 0.5))
    assert distance_matrix(index).values[0] == pytest.approx([0, 0.25, 0.5])
    # A query is measured by the gallery, and teaches it nothing.
    found = index.query(egg(3.0), 3)
    assert found.ids == ("a", "b", "c")
    assert found.distances == pytest.approx((0.5, 0.75, 1))


def test_words_of_a_gallery_are_shares_of_the_surface_by_which_a_moved_copy_is_nearest() -> None:
    meshes = {
        "egg": shapes.ellipsoid((1, 1, 1.5), subdivisions=3),
        "long": shapes.ellipsoid((1, 1, 3), subdivisions=3),
        "body": shapes.body(3),
    }
    meshes |= {f"{name} again": shapes.moved(mesh, 1) for name, mesh in meshes.items()}
    index = PairwiseIndex(MATCHERS["hks-bow-gallery"], meshes, lambda shape_id: shape(meshes[shape_id]))
    for frequencies in index.features:
        assert frequencies.shape == (48,)
        assert frequencies.sum() == pytest.approx(1)
        assert (frequencies >= 0).all()
    for name in ("egg", "long", "body"):
        assert index.nearest(name, 2).ids[1] == f"{name} again"
    assert word_distance(index.features[0], index.features[2]) > 0.1
    query = shape(shapes.moved(meshes["long"], 2))
    assert pickle.loads(pickle.dumps(index)).query(query) == index.query(query)
