"""BiHDM: its eigenvalues are exactly those of the dense kernel between all vertices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapes

from pcretrieve import eigenpairs, laplace_beltrami, r_bihdm
from pcretrieve.descriptors import bihdm, bihdm_sampled, full_matrix, reduced_matrix
from pcretrieve.errors import OptionError, ShapeError
from pcretrieve.spectral import unit_eigenpairs
from pcretrieve.values import ModalSpectrum, TriangleMesh

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


def test_it_needs_the_overlaps() -> None:
    spectrum = ModalSpectrum.of(eigenpairs(laplace_beltrami(shapes.body(3)), 13))
    assert len(bihdm(spectrum, 5, 12).values) == 5
    with pytest.raises(
        ShapeError, match=r"gone: this spectrum has no overlaps .*ingest again with catalogue.keep"
    ):
        bihdm(replace(spectrum, overlaps=None), 5, 12)


def test_lengths_that_do_not_fit() -> None:
    pairs = eigenpairs(laplace_beltrami(shapes.body(3)), 13)
    for n_values, n_modes in ((13, 12), (0, 12), (5, 13)):
        with pytest.raises(OptionError, match="must be between"):
            bihdm(pairs, n_values, n_modes)


def test_sampled_eigenvalues_are_those_of_the_matrix_of_distances_between_vertices() -> None:
    pairs = unit_eigenpairs(shapes.body(2), 31)
    places = pairs.eigenvectors[:, 1:] / pairs.eigenvalues[1:]
    distances = ((places[:, np.newaxis] - places) ** 2).sum(axis=2)  # (n, n)
    magnitudes = -np.linalg.eigvalsh(distances)[:9] * pairs.area / len(places)
    np.testing.assert_allclose(bihdm_sampled(pairs, 9, 30, scale="absolute").values, magnitudes, rtol=1e-9)


def test_samples_that_are_evenly_spread_give_the_weighted_values() -> None:
    ball = unit_eigenpairs(shapes.icosphere(4), 25)  # whole multiplets, l up to 4
    even = bihdm_sampled(ball, 8, 24).values / bihdm(ball, 8, 24).values
    assert np.abs(even - 1).max() < 0.005
    sphere = shapes.icosphere(4)
    heights = sphere.vertices[:, 2:]
    moved = sphere.vertices + [0, 0, 0.6] * (1 - heights**2)  # towards the upper pole, and back to the sphere
    uneven = replace(sphere, vertices=moved / np.linalg.norm(moved, axis=1, keepdims=True))
    dense = unit_eigenpairs(uneven, 25)
    changed = bihdm_sampled(dense, 8, 24).values / bihdm(dense, 8, 24).values
    assert np.abs(changed - 1).max() > 0.1


def test_too_many_modes_for_sampled_distances() -> None:
    with pytest.raises(OptionError, match="n_modes must be between 1 and 30 for 31 eigenpairs, got 31"):
        bihdm_sampled(unit_eigenpairs(shapes.icosphere(2), 31), 9, 31)
