"""The compiled loops of the iteration are the lines of NumPy and SciPy that their page names."""

from __future__ import annotations

import numpy as np
import shapes
from scipy.sparse import csr_array

from pcretrieve import laplace_beltrami
from pcretrieve.spectral import blocks
from pcretrieve.spectral.blocks import BLOCK, CHUNK
from pcretrieve.spectral.krylov import Factor


def test_products_of_blocks_are_those_of_numpy() -> None:
    random = np.random.default_rng(0)
    n = CHUNK + 40
    block, basis = random.normal(size=(n, BLOCK)), random.normal(size=(12, n))
    matrix = csr_array(random.normal(size=(n, n)) * (random.random((n, n)) < 0.01))
    found = blocks.product(matrix.indptr, matrix.indices, matrix.data, block)
    np.testing.assert_allclose(found, np.asarray(matrix @ block), atol=1e-12)
    parts = blocks.components(basis, block)
    np.testing.assert_allclose(parts, basis @ block, atol=1e-11)
    turn, changed = random.normal(size=(BLOCK, BLOCK)), block.copy()
    blocks.times(changed, turn)
    np.testing.assert_allclose(changed, block @ turn, atol=1e-12)
    blocks.subtract(basis, parts, changed)
    np.testing.assert_allclose(changed, block @ turn - basis.T @ parts, atol=1e-10)


def test_substitution_solves_and_pairs_are_columns_with_the_same_rows() -> None:
    operator = laplace_beltrami(shapes.ellipsoid(subdivisions=2))
    matrix = operator.stiffness - 3.0 * operator.mass
    factor = Factor(matrix, operator.mass)
    right = np.random.default_rng(1).normal(size=(matrix.shape[0], BLOCK))
    expected = np.linalg.solve(
        matrix.toarray()[np.ix_(factor.order, factor.order)], right
    )
    np.testing.assert_allclose(factor.solve(right), expected, rtol=1e-9, atol=1e-9)
    expected = (operator.mass[factor.order][:, factor.order]) @ right
    np.testing.assert_allclose(factor.mass(right), expected, atol=1e-12)
    filled = factor.lower.toarray() != 0
    starts = np.flatnonzero(factor.paired)
    assert 0 < len(starts) < matrix.shape[0] / 2
    assert (np.diff(starts) > 1).all()
    for start in starts:
        below = slice(start + 2, None)
        np.testing.assert_array_equal(filled[below, start], filled[below, start + 1])
        assert filled[start + 1, start]
