"""The arrays that the package keeps of simulated bodies are those that its programs make."""

from __future__ import annotations

from importlib import resources

import numpy as np
from benchmarks.shipped import features, log_eigenvalues

from pcretrieve.values import FloatArray


def kept(package: str, name: str) -> FloatArray:
    array: FloatArray = np.load(str(resources.files(package).joinpath(name)))
    return array


def test_the_words_come_from_the_first_subject_too() -> None:
    made = next(features())
    heat = kept("pcretrieve.descriptors", "hks_sample.npy")
    np.testing.assert_allclose(made.heat, heat[:, : made.heat.shape[1]], atol=1e-3)
    wavelets = kept("pcretrieve.descriptors", "wavelet_sample.npy")
    np.testing.assert_allclose(made.wavelets, wavelets[: len(made.wavelets)], atol=1e-3)


def test_a_hand_moves_with_the_resolution_as_was_measured() -> None:
    sample = kept("pcretrieve.retrieval", "resolution.npy")  # 56 people, animals and hands each
    made = log_eigenvalues(("hand", 0))
    np.testing.assert_allclose(made, sample[:, 2 * 56], atol=1e-3)
    assert np.linalg.norm(made[0] - made[1]) > 0.01, "cells of two sizes, two surfaces"
