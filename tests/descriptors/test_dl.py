"""Bags of sparse codes: the lasso, its derivative, and dictionaries without and with labels."""

from __future__ import annotations

import numpy as np
import pytest
import shapes
from benchmarks.shipped import (
    LabelledSurface,
    dictionaries,
    sparse_dictionary,
    supervised_dictionary,
    surfaces,
    triplet_loss,
)

from pcretrieve.descriptors import dl
from pcretrieve.descriptors.dl import PENALTY, SurfacePoints, atom_shares, sparse_codes, surface_points
from pcretrieve.errors import InputError
from pcretrieve.spectral import unit_eigenpairs
from pcretrieve.values import FloatArray

LABELS = ("a", "a", "b", "b", "c", "c")


def unit(rows: FloatArray) -> FloatArray:
    scaled: FloatArray = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    return scaled


def some_surfaces(random: np.random.Generator, n_points: int = 7) -> list[SurfacePoints]:
    shares = np.full(n_points, 1 / n_points)
    return [SurfacePoints(unit(random.normal(size=(n_points, 5))), shares) for _ in LABELS]


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
    points = axes[random.integers(5, size=200)] * random.choice([-1.0, 1.0], size=(200, 1))
    atoms = sparse_dictionary(points, 5, 0.05)
    np.testing.assert_allclose(np.abs(atoms @ axes.T).max(axis=0), 1, atol=1e-3)
    np.testing.assert_array_equal(sparse_dictionary(points, 5, 0.05), atoms)


def test_the_shares_of_a_surface_weigh_its_points_by_their_areas() -> None:
    axes = np.eye(3)
    points = SurfacePoints(axes[[0, 1, 1]], np.array([0.5, 0.25, 0.25]))
    np.testing.assert_allclose(atom_shares(points, axes), [0.5, 0.5, 0], atol=1e-9)
    opposite = SurfacePoints(-points.features, points.shares)
    np.testing.assert_allclose(atom_shares(opposite, axes), [0.5, 0.5, 0], atol=1e-9)


def test_the_derivative_of_the_loss_is_the_limit_of_differences() -> None:
    random = np.random.default_rng(0)
    bodies, atoms = some_surfaces(random), unit(random.normal(size=(9, 5)))
    loss = triplet_loss(bodies, LABELS, atoms, 0.5, 2000)
    assert loss.value > 0
    direction = random.normal(size=atoms.shape)
    step = 1e-5
    ahead, behind = (
        triplet_loss(bodies, LABELS, atoms + sign * step * direction, 0.5, 2000).value for sign in (1, -1)
    )
    assert (loss.gradient * direction).sum() == pytest.approx((ahead - behind) / (2 * step), rel=0.02)


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
    learned = supervised_dictionary(known, labels, start, np.random.default_rng(0), n_steps=50)
    np.testing.assert_allclose(np.linalg.norm(learned, axis=1), 1)
    before, after = (triplet_loss(unseen, labels, atoms, 0.1).value for atoms in (start, learned))
    assert after < 0.75 * before


def test_learning_needs_two_classes() -> None:
    bodies = some_surfaces(np.random.default_rng(0))
    with pytest.raises(InputError, match="two classes of two surfaces or more, got 1"):
        supervised_dictionary(bodies, ["a", "a", "b", "c", "d", "e"], np.eye(5), np.random.default_rng(0))


@pytest.mark.parametrize("supervised", [False, True])
def test_the_shares_of_the_atoms_sum_up_to_one(supervised: bool) -> None:
    pairs = unit_eigenpairs(shapes.ellipsoid((1, 1, 1.8), subdivisions=3), 61)
    shares = dl(pairs, supervised=supervised).values
    assert shares.shape == (32,)
    assert shares.sum() == pytest.approx(1)
    assert (shares >= 0).all()
    assert (shares > 0.01).sum() >= 2


def test_one_dictionary_is_learned_from_the_other() -> None:
    meshes = {"egg": shapes.ellipsoid((1, 1, 1.8), subdivisions=3), "body": shapes.body(3)}
    bodies = [
        LabelledSurface(surface_points(unit_eigenpairs(mesh, 61)), label)
        for label, mesh in meshes.items()
        for _ in range(2)
    ]
    plain, labelled = dictionaries(bodies, n_steps=2)
    assert plain.shape == (32, 19)
    for atoms in (plain, labelled):
        np.testing.assert_allclose(np.linalg.norm(atoms, axis=1), 1)
    assert 0 < np.abs(plain - labelled).max() < 0.1


def test_the_classes_that_dictionaries_are_learned_from_are_individuals() -> None:
    first = next(surfaces(1, 1))
    assert first.label == "person 0"
    assert first.points.shares.sum() == pytest.approx(1)
    np.testing.assert_allclose(np.linalg.norm(first.points.features, axis=1), 1)
