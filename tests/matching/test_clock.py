"""MDS-CM-BOF: views of canonical forms, and the best of 24 positions."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray

from pcretrieve.matching import MATCHERS
from pcretrieve.matching.cm_bof import (
    N_PIXELS,
    ViewWords,
    clock_distance,
    depth_pictures,
    directions,
    exchanges,
)
from pcretrieve.values import Shape, Surface, TriangleMesh

needs_opencv = pytest.mark.usefixtures("opencv")


@pytest.fixture
def opencv() -> None:
    pytest.importorskip("cv2", reason="SIFT comes from OpenCV")


def shape(mesh: TriangleMesh) -> Shape:
    return Shape((Surface(mesh.area, mesh=mesh),))


# --- views ----------------------------------------------------------------------------------------------


def test_rotations_exchange_the_directions() -> None:
    rows = exchanges()
    assert rows.shape == (24, 66)
    assert len({tuple(row) for row in rows.tolist()}) == 24
    assert np.arange(66).tolist() in rows.tolist()
    gram = directions() @ directions().T
    for row in rows:
        np.testing.assert_allclose(gram[np.ix_(row, row)], gram, atol=1e-12)


def test_pictures_show_the_depth_of_a_ball() -> None:
    ball = shapes.icosphere(5, radius=0.8)
    pictures = np.array(list(depth_pictures(ball)))
    assert pictures.shape == (66, N_PIXELS, N_PIXELS)
    x = (np.arange(N_PIXELS) - (N_PIXELS - 1) / 2) / (0.95 * (N_PIXELS - 1) / 2)
    squares = x**2 + x[:, np.newaxis] ** 2
    depth = np.where(squares < 0.6, (1 + np.sqrt(np.maximum(0.64 - squares, 0))) / 2, 0)
    inner, outside = squares < 0.55, squares > 0.65
    assert np.abs(pictures[:, inner] - depth[inner]).max() < 2e-3
    assert (pictures[:, outside] == 0).all()


# --- clock matching -------------------------------------------------------------------------------------


def words_of(histograms: NDArray[np.int64]) -> ViewWords:
    """The words of (66, W) histograms."""
    rows, words = np.nonzero(histograms)
    starts = np.searchsorted(rows, np.arange(67))
    return ViewWords(*(part.astype(np.int32) for part in (starts, words, histograms[rows, words])))


def test_the_best_position_counts() -> None:
    rng = np.random.default_rng(0)
    one, two = (rng.poisson(0.2, (66, 30)) * (rng.random((66, 1)) < 0.9) for _ in range(2))
    means = []
    for row in exchanges():
        common = np.minimum(one[row], two).sum(axis=1)
        larger = np.maximum(one[row].sum(axis=1), two.sum(axis=1))
        means.append(np.mean(np.where(larger > 0, 1 - common / np.maximum(larger, 1), 0)))
    assert clock_distance(words_of(one), words_of(two)) == pytest.approx(min(means))
    assert clock_distance(words_of(two), words_of(one)) == pytest.approx(min(means))
    assert clock_distance(words_of(one[exchanges()[7]]), words_of(one)) == 0
    nothing = words_of(np.zeros((66, 30), dtype=int))
    assert clock_distance(nothing, nothing) == 0
    assert clock_distance(words_of(np.ones((66, 30), dtype=int)), nothing) == 1


@needs_opencv
def test_moved_scaled_and_renumbered_surfaces_are_near() -> None:
    match = MATCHERS["mds-cm-bof"]
    mesh = shapes.body(2)
    described = [
        match.prepare(shape(given))
        for given in (
            mesh,
            mesh,
            shapes.ellipsoid((1, 0.6, 0.4), subdivisions=3),
            shapes.renumbered(shapes.moved(mesh, 1, scale=7), 2),
        )
    ]
    for one, two in zip(described[0], described[1], strict=True):
        np.testing.assert_array_equal(one, two)
    assert match.learn is not None
    counted = match.learn(described[:3])
    made, again, other, moved = map(pickle.loads(pickle.dumps(counted)), described)
    assert match.distance(made, again) == 0
    assert match.distance(made, moved) < 0.2 < 0.7 < match.distance(made, other)
