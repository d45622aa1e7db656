"""Intrinsic spatial pyramid matching."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import shapes

from pcretrieve.descriptors import ispm
from pcretrieve.descriptors.ispm import wavelet_signatures
from pcretrieve.errors import OptionError
from pcretrieve.spectral import unit_eigenpairs
from pcretrieve.values import Eigenpairs, FloatArray

N_WORDS = 9
N_MODES = 30


@cache
def pear() -> Eigenpairs:
    """A body of revolution with a thick and a thin end, along which φ_1 varies."""
    ball = shapes.icosphere(3)
    x, y, z = ball.vertices.T
    thickness = 0.35 + 0.3 * z
    return unit_eigenpairs(
        replace(ball, vertices=np.column_stack([thickness * x, thickness * y, z])), N_MODES + 1
    )


def with_other_sign(pairs: Eigenpairs) -> Eigenpairs:
    vectors = pairs.eigenvectors.copy()
    vectors[:, 1] *= -1
    return replace(pairs, eigenvectors=vectors)


def levels(pairs: Eigenpairs) -> list[FloatArray]:
    """The histograms of the levels, one row for each part."""
    values = ispm(pairs, N_WORDS, N_MODES).values
    ends = N_WORDS * np.cumsum([1, 2, 4, 8])
    return [level.reshape(-1, N_WORDS) for level in np.split(values, ends[:-1])]


def test_the_sign_of_the_cutting_eigenfunction_does_not_matter() -> None:
    np.testing.assert_allclose(
        ispm(with_other_sign(pear()), N_WORDS, N_MODES).values,
        ispm(pear(), N_WORDS, N_MODES).values,
        atol=1e-12,
    )


def test_every_level_is_a_histogram_of_the_whole_surface() -> None:
    whole, *others = levels(pear())
    assert whole.sum() == pytest.approx(1 / 4)
    for level in others:
        np.testing.assert_allclose(level.sum(axis=0), whole[0], atol=1e-12)
        # Each two parts that the sign exchanges are sorted: the first half of the rows has the larger shares.
        half = len(level) // 2
        assert (level[:half] >= level[half:]).all()
        np.testing.assert_allclose((level[:half] + level[half:]).sum(axis=1), 1 / 4 / half, atol=1e-12)


def test_parts_tell_a_body_from_one_with_the_same_words_in_other_places() -> None:
    """The ends of the pear differ; of an ellipsoid, which is symmetric, both halves have the same words."""
    ball = shapes.ellipsoid((0.4, 0.4, 1.0), subdivisions=3)
    first, second = levels(unit_eigenpairs(ball, N_MODES + 1))[1]
    apart = np.abs(first - second).sum()
    thick, thin = levels(pear())[1]
    assert np.abs(thick - thin).sum() > max(0.02, 10 * apart)


def test_wavelet_signatures_are_constant_on_a_sphere() -> None:
    """By the addition theorem Σ φ² over the modes of one eigenvalue is constant on a sphere."""
    pairs = unit_eigenpairs(shapes.icosphere(4), 49)  # l = 0 … 6
    features = wavelet_signatures(pairs, 48)
    np.testing.assert_allclose(np.linalg.norm(features, axis=1), 1)
    np.testing.assert_allclose(features, np.broadcast_to(features.mean(axis=0), features.shape), atol=0.01)


def test_the_wavelet_kernel_is_continuous_and_has_its_maximum_between_its_pieces() -> None:
    from pcretrieve.descriptors.ispm import KERNEL_MAXIMUM, _spline

    x = np.linspace(0, 40, 400_001)
    assert np.abs(np.diff(_spline(x))).max() < 3e-4
    assert _spline(x).max() == pytest.approx(KERNEL_MAXIMUM)


@pytest.mark.parametrize(
    ("n_words", "n_modes", "message"),
    [
        (1, 30, "n_values must be between 2 and 90 for a bag of words, got 1"),
        (91, 30, "n_values must be between 2 and 90 for a bag of words, got 91"),
        (9, 1, "n_modes must be between 2 and 30 for 31 eigenpairs, got 1"),
        (9, 31, "n_modes must be between 2 and 30 for 31 eigenpairs, got 31"),
    ],
)
def test_numbers_that_do_not_fit(n_words: int, n_modes: int, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        ispm(pear(), n_words, n_modes)
