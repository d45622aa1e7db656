"""Intrinsic spatial pyramid matching."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import shapes

from pcretrieve.shrec.ispm import ispm, wavelet_signatures
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
        replace(ball, vertices=np.column_stack([thickness * x, thickness * y, z])),
        N_MODES + 1,
    )


def levels(pairs: Eigenpairs) -> list[FloatArray]:
    """The histograms of the levels, one row for each part."""
    values = ispm(pairs, N_WORDS, N_MODES).values
    ends = N_WORDS * np.cumsum([1, 2, 4, 8])
    return [level.reshape(-1, N_WORDS) for level in np.split(values, ends[:-1])]


def test_the_sign_of_the_cutting_eigenfunction_does_not_matter() -> None:
    vectors = pear().eigenvectors * np.where(np.arange(N_MODES + 1) == 1, -1, 1)
    turned, here = (
        levels(pairs) for pairs in (replace(pear(), eigenvectors=vectors), pear())
    )
    np.testing.assert_allclose(np.concatenate(turned), np.concatenate(here), atol=1e-12)


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
    np.testing.assert_allclose(
        features, np.broadcast_to(features.mean(axis=0), features.shape), atol=0.01
    )
