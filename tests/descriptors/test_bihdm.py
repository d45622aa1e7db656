"""BiHDM: its eigenvalues are exactly those of the dense kernel between all vertices."""

from __future__ import annotations

import numpy as np
import pytest
import shapes

from pcretrieve import eigenpairs, laplace_beltrami, r_bihdm
from pcretrieve.descriptors import bihdm, bihdm_sampled, full_matrix, reduced_matrix
from pcretrieve.spectral import unit_eigenpairs
from pcretrieve.values import TriangleMesh

N_MODES = 12


@pytest.mark.parametrize("mesh", [shapes.body(3), shapes.torus(24, 12)], ids=["body", "torus"])
def test_its_spectrum_is_that_of_the_dense_kernel(mesh: TriangleMesh) -> None:
    operator = laplace_beltrami(mesh, mass="lumped")
    pairs = eigenpairs(operator, n_pairs=N_MODES + 1)
    embedded = pairs.eigenvectors[:, 1:] / pairs.eigenvalues[1:]
    squared = ((embedded[:, None] - embedded[None]) ** 2).sum(axis=2)  # (n, n): equation (4), truncated at m
    root = np.sqrt(operator.mass.diagonal())
    dense = np.linalg.eigvalsh(root[:, None] * squared * root)
    dense = dense[np.argsort(-np.abs(dense))]
    small = np.linalg.eigvalsh(full_matrix(pairs, N_MODES))
    np.testing.assert_allclose(
        np.sort(dense[: N_MODES + 2]), np.sort(small), atol=1e-12 * dense[0], err_msg="the same eigenvalues"
    )
    assert np.abs(dense[N_MODES + 2 :]).max() < 1e-12 * dense[0], "and rank m + 2"
    reduced = np.linalg.eigvalsh(reduced_matrix(pairs, N_MODES))
    assert np.abs(reduced[-1] - dense[0]) > 1e-9 * dense[0], "R-BiHDM is another matrix"


def test_r_bihdm_approaches_it_as_modes_are_added() -> None:
    pairs = eigenpairs(laplace_beltrami(shapes.body(4)), n_pairs=61)
    gaps = [
        np.abs(np.log(bihdm(pairs, 5, m).values / r_bihdm(pairs, 5, m).values)).max() for m in (6, 15, 30, 60)
    ]
    assert (np.diff(gaps) < 0).all(), gaps
    assert 0 < gaps[-1] < 1e-3 * gaps[0]


def test_sampled_eigenvalues_are_those_of_the_matrix_of_distances_between_vertices() -> None:
    pairs = unit_eigenpairs(shapes.body(2), 31)
    places = pairs.eigenvectors[:, 1:] / pairs.eigenvalues[1:]
    distances = ((places[:, np.newaxis] - places) ** 2).sum(axis=2)  # (n, n)
    magnitudes = -np.linalg.eigvalsh(distances)[:9] * pairs.area / len(places)
    np.testing.assert_allclose(bihdm_sampled(pairs, 9, 30, scale="absolute").values, magnitudes, rtol=1e-9)
