"""Arrays that the package ships: what makes them, and that they are what is made."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.shipped import sparse_dictionary
from benchmarks.simulation import POSES, body, make_subject
from scipy.spatial import cKDTree

from pcretrieve.shrec.dl import (
    PENALTY,
    SurfacePoints,
    sparse_codes,
    supervised_dictionary,
    triplet_loss,
)
from pcretrieve.shrec.heat import heat_features, shipped
from pcretrieve.spectral import unit_eigenpairs
from pcretrieve.values import FloatArray

LABELS = np.array(["a", "a", "b", "b", "c", "c"])


def unit(rows: FloatArray) -> FloatArray:
    scaled: FloatArray = rows / np.linalg.norm(rows, axis=-1, keepdims=True)
    return scaled


def test_codes_are_minimisers_of_the_lasso() -> None:
    """At the minimum the gradient is −λ sign z where z is not zero, and within ±λ elsewhere."""
    random = np.random.default_rng(4)
    points, atoms = unit(random.normal(size=(30, 6))), unit(random.normal(size=(9, 6)))
    codes = sparse_codes(points, atoms, n_iterations=2000)
    gradient = (codes @ atoms - points) @ atoms.T
    used = codes != 0
    assert 0.2 < used.mean() < 0.9
    np.testing.assert_allclose(gradient[used], -PENALTY * np.sign(codes[used]), atol=1e-4)
    assert (np.abs(gradient) < PENALTY + 1e-4).all()


def test_a_dictionary_finds_the_directions_that_points_are_sums_of() -> None:
    random = np.random.default_rng(1)
    axes = np.linalg.qr(random.normal(size=(5, 5)))[0]
    points = axes[random.integers(5, size=200)] * random.choice(
        [-1.0, 1.0], size=(200, 1)
    )
    atoms = sparse_dictionary(points, 5, 0.05)
    np.testing.assert_allclose(np.abs(atoms @ axes.T).max(axis=0), 1, atol=1e-3)
    np.testing.assert_array_equal(sparse_dictionary(points, 5, 0.05), atoms)


def test_the_derivative_of_the_loss_is_the_limit_of_differences() -> None:
    random = np.random.default_rng(0)
    bodies, atoms = unit(random.normal(size=(6, 7, 5))), unit(random.normal(size=(9, 5)))
    value, gradient = triplet_loss(bodies, LABELS, atoms, 0.5, 2000)
    assert value > 0
    direction = random.normal(size=atoms.shape)
    step = 1e-5
    ahead, behind = (
        triplet_loss(bodies, LABELS, atoms + sign * step * direction, 0.5, 2000)[0]
        for sign in (1, -1)
    )
    assert (gradient * direction).sum() == pytest.approx(
        (ahead - behind) / (2 * step), rel=0.02
    )


def test_learning_with_labels_separates_surfaces_that_it_has_not_seen() -> None:
    """Of two atoms between the directions of two classes, each describes both classes alike."""
    random = np.random.default_rng(3)

    def surface(axis: int) -> SurfacePoints:
        points = 0.1 * random.normal(size=(30, 3))
        points[:, axis] += 1
        return SurfacePoints(unit(points), np.full(30, 1 / 30))

    labels = ["0", "1"] * 4
    known, unseen = ([surface(int(label)) for label in labels] for _ in range(2))
    start = unit(np.array([[1.0, 1, 0], [1, -1, 0], [0, 0, 1]]))
    learned = supervised_dictionary(known, labels, start, np.random.default_rng(0))
    np.testing.assert_allclose(np.linalg.norm(learned, axis=1), 1)
    points = np.array([surface.features for surface in unseen])
    before, after = (
        triplet_loss(points, np.array(labels), atoms, 0.1)[0]
        for atoms in (start, learned)
    )
    assert after < 0.75 * before


def test_words_are_near_points_of_the_first_subject() -> None:
    rng = np.random.default_rng(0)
    subject = make_subject("person", rng)
    pairs = unit_eigenpairs(body(subject, next(iter(POSES["person"].values())), rng), 61)
    for words, kind in zip(shipped("hks_sample.npy"), (False, True), strict=True):
        near = cKDTree(heat_features(pairs, scale_invariant=kind)).query(words[:120])[0]
        # Of this subject and of the second.
        own, other = np.median(np.reshape(near, (2, -1)), axis=1)
        assert 3 * own < other
