"""R-BiHDM and BiHDM: comparison with the dense kernel between all vertices, and invariances."""

from __future__ import annotations

import numpy as np
import pytest
import shapes

from pcretrieve import eigenpairs, laplace_beltrami, r_bihdm
from pcretrieve.descriptors import bihdm, full_matrix, reduced_matrix
from pcretrieve.errors import OptionError
from pcretrieve.shrec.spectra import bihdm_sampled
from pcretrieve.spectral import unit_eigenpairs
from pcretrieve.values import Eigenpairs, FloatArray, TriangleMesh

N_MODES = 12


def squared_distances(pairs: Eigenpairs) -> FloatArray:
    """(n, n): equation (4), truncated at m."""
    places = pairs.eigenvectors[:, 1:] / pairs.eigenvalues[1:]
    return np.asarray(((places[:, None] - places[None]) ** 2).sum(axis=2))


def test_the_arrowhead_is_the_dense_kernel_with_lumped_mass_only() -> None:
    """With consistent mass, 1ᵀM φ² is not φᵀM φ."""
    for mass, least, most in (("lumped", 0, 1e-12), ("consistent", 1e-3, 1e-1)):
        operator = laplace_beltrami(shapes.ellipsoid(subdivisions=2), mass=mass)  # type: ignore[arg-type]
        pairs = eigenpairs(operator, n_pairs=N_MODES + 1)
        projected = operator.mass @ pairs.eigenvectors
        dense = projected.T @ squared_distances(pairs) @ projected
        assert (
            least
            <= np.abs(reduced_matrix(pairs, N_MODES) - dense).max() / np.abs(dense).max()
            < most
        )


def test_one_eigenvalue_is_positive_and_their_sum_zero() -> None:
    pairs = unit_eigenpairs(shapes.body(subdivisions=3), 61)
    matrix = reduced_matrix(pairs)
    assert abs(np.trace(matrix)) < 1e-12 * np.abs(matrix).max()
    mu = np.linalg.eigvalsh(matrix)
    assert (mu[:-1] < 0).all()
    assert mu[-1] > 0
    assert (np.diff(r_bihdm(pairs).values) <= 0).all()
    for n_values, n_modes in ((0, 60), (61, 60), (23, 61), (1, 0)):
        with pytest.raises(OptionError, match="must be between"):
            r_bihdm(pairs, n_values=n_values, n_modes=n_modes)


@pytest.mark.parametrize(
    "mesh", [shapes.body(3), shapes.torus(24, 12)], ids=["body", "torus"]
)
def test_the_spectrum_of_bihdm_is_that_of_the_dense_kernel(mesh: TriangleMesh) -> None:
    operator = laplace_beltrami(mesh, mass="lumped")
    pairs = eigenpairs(operator, n_pairs=N_MODES + 1)
    root = np.sqrt(operator.mass.diagonal())
    dense = np.linalg.eigvalsh(root[:, None] * squared_distances(pairs) * root)
    dense = dense[np.argsort(-np.abs(dense))]
    small = np.linalg.eigvalsh(full_matrix(pairs, N_MODES))
    np.testing.assert_allclose(
        np.sort(dense[: N_MODES + 2]), np.sort(small), atol=1e-12 * dense[0]
    )
    assert np.abs(dense[N_MODES + 2 :]).max() < 1e-12 * dense[0], "rank m + 2"
    reduced = np.linalg.eigvalsh(reduced_matrix(pairs, N_MODES))
    assert np.abs(reduced[-1] - dense[0]) > 1e-9 * dense[0], "R-BiHDM is another matrix"


def test_r_bihdm_approaches_bihdm_as_modes_are_added() -> None:
    pairs = eigenpairs(laplace_beltrami(shapes.body(4)), n_pairs=61)
    gaps = [
        np.abs(np.log(bihdm(pairs, 5, m).values / r_bihdm(pairs, 5, m).values)).max()
        for m in (6, 15, 30, 60)
    ]
    assert (np.diff(gaps) < 0).all(), gaps
    assert 0 < gaps[-1] < 1e-3 * gaps[0]


def test_sampled_eigenvalues_are_those_of_the_matrix_of_distances_between_vertices() -> (
    None
):
    pairs = unit_eigenpairs(shapes.body(2), 31)
    distances = squared_distances(pairs)
    magnitudes = -np.linalg.eigvalsh(distances)[:9] * pairs.area / len(distances)
    np.testing.assert_allclose(
        bihdm_sampled(pairs, 9, 30, scale="absolute").values, magnitudes, rtol=1e-9
    )
