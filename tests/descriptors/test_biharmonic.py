"""R-BiHDM and BiHDM: comparison with the dense kernel between all vertices, and invariances."""

from __future__ import annotations

import numpy as np
import pytest
import shapes

from pcretrieve import eigenpairs, laplace_beltrami, r_bihdm, shape_dna
from pcretrieve.descriptors import bihdm, bihdm_sampled, full_matrix, reduced_matrix
from pcretrieve.errors import OptionError
from pcretrieve.spectral import unit_eigenpairs
from pcretrieve.values import Eigenpairs, FloatArray, TriangleMesh

N_MODES = 12


def squared_distances(pairs: Eigenpairs) -> FloatArray:
    """(n, n): equation (4), truncated at m."""
    places = pairs.eigenvectors[:, 1:] / pairs.eigenvalues[1:]
    return np.asarray(((places[:, None] - places[None]) ** 2).sum(axis=2))


def dense_kernel(mesh: TriangleMesh, mass: str) -> tuple[FloatArray, FloatArray]:
    """Arrowhead, and ΦᵀM D² MΦ with D² the squared distances between all vertices."""
    operator = laplace_beltrami(mesh, mass=mass)  # type: ignore[arg-type]
    pairs = eigenpairs(operator, n_pairs=N_MODES + 1)
    projected = operator.mass @ pairs.eigenvectors
    return reduced_matrix(pairs, N_MODES), projected.T @ squared_distances(pairs) @ projected


def test_with_lumped_mass_the_arrowhead_is_the_dense_kernel() -> None:
    arrowhead, dense = dense_kernel(shapes.ellipsoid(subdivisions=2), "lumped")
    np.testing.assert_allclose(arrowhead, dense, atol=1e-12 * np.abs(dense).max())


def test_with_consistent_mass_it_is_not_as_1_m_phi_squared_is_not_phi_m_phi() -> None:
    arrowhead, dense = dense_kernel(shapes.ellipsoid(subdivisions=2), "consistent")
    gap = np.abs(arrowhead - dense).max() / np.abs(dense).max()
    assert 1e-3 < gap < 1e-1


@pytest.mark.parametrize("scale", [1e-3, 3.0])
def test_the_matrix_scales_as_length_to_the_fourth_and_the_signature_not_at_all(scale: float) -> None:
    mesh = shapes.body(subdivisions=3)
    scaled = TriangleMesh(scale * mesh.vertices, mesh.faces)
    pairs, scaled_pairs = (eigenpairs(laplace_beltrami(m)) for m in (mesh, scaled))
    matrix = reduced_matrix(pairs)
    # Eigenvectors of simple eigenvalues are unique up to sign, and the spectrum does not depend on the sign.
    spectrum, scaled_spectrum = (np.linalg.eigvalsh(reduced_matrix(p)) for p in (pairs, scaled_pairs))
    np.testing.assert_allclose(scaled_spectrum, scale**4 * spectrum, rtol=1e-6)
    assert abs(np.trace(matrix)) < 1e-12 * np.abs(matrix).max()
    np.testing.assert_allclose(r_bihdm(scaled_pairs).values, r_bihdm(pairs).values, rtol=1e-6)


def test_one_eigenvalue_is_positive_and_all_others_negative() -> None:
    mu = np.linalg.eigvalsh(reduced_matrix(eigenpairs(laplace_beltrami(shapes.body(subdivisions=3)))))
    assert (mu[:-1] < 0).all()
    assert mu[-1] > 0


@pytest.mark.parametrize("descriptor", [r_bihdm, shape_dna])
@pytest.mark.parametrize("change", [shapes.moved, shapes.renumbered])
def test_signatures_do_not_see_motion_or_numbering(descriptor, change) -> None:  # type: ignore[no-untyped-def]
    mesh = shapes.body(subdivisions=3)
    before = descriptor(eigenpairs(laplace_beltrami(mesh))).values
    after = descriptor(eigenpairs(laplace_beltrami(change(mesh, 1)))).values
    np.testing.assert_allclose(after, before, rtol=1e-6)
    assert (np.diff(before) <= 0).all()


@pytest.mark.parametrize(("n_values", "n_modes"), [(0, 60), (61, 60), (23, 61), (1, 0)])
def test_lengths_that_do_not_fit(n_values: int, n_modes: int) -> None:
    pairs = eigenpairs(laplace_beltrami(shapes.icosphere(3)))
    with pytest.raises(OptionError, match="must be between"):
        r_bihdm(pairs, n_values=n_values, n_modes=n_modes)


@pytest.mark.parametrize("mesh", [shapes.body(3), shapes.torus(24, 12)], ids=["body", "torus"])
def test_the_spectrum_of_bihdm_is_that_of_the_dense_kernel(mesh: TriangleMesh) -> None:
    operator = laplace_beltrami(mesh, mass="lumped")
    pairs = eigenpairs(operator, n_pairs=N_MODES + 1)
    root = np.sqrt(operator.mass.diagonal())
    dense = np.linalg.eigvalsh(root[:, None] * squared_distances(pairs) * root)
    dense = dense[np.argsort(-np.abs(dense))]
    small = np.linalg.eigvalsh(full_matrix(pairs, N_MODES))
    np.testing.assert_allclose(
        np.sort(dense[: N_MODES + 2]), np.sort(small), atol=1e-12 * dense[0], err_msg="the same eigenvalues"
    )
    assert np.abs(dense[N_MODES + 2 :]).max() < 1e-12 * dense[0], "and rank m + 2"
    reduced = np.linalg.eigvalsh(reduced_matrix(pairs, N_MODES))
    assert np.abs(reduced[-1] - dense[0]) > 1e-9 * dense[0], "R-BiHDM is another matrix"


def test_r_bihdm_approaches_bihdm_as_modes_are_added() -> None:
    pairs = eigenpairs(laplace_beltrami(shapes.body(4)), n_pairs=61)
    gaps = [
        np.abs(np.log(bihdm(pairs, 5, m).values / r_bihdm(pairs, 5, m).values)).max() for m in (6, 15, 30, 60)
    ]
    assert (np.diff(gaps) < 0).all(), gaps
    assert 0 < gaps[-1] < 1e-3 * gaps[0]


def test_sampled_eigenvalues_are_those_of_the_matrix_of_distances_between_vertices() -> None:
    pairs = unit_eigenpairs(shapes.body(2), 31)
    distances = squared_distances(pairs)
    magnitudes = -np.linalg.eigvalsh(distances)[:9] * pairs.area / len(distances)
    np.testing.assert_allclose(bihdm_sampled(pairs, 9, 30, scale="absolute").values, magnitudes, rtol=1e-9)
