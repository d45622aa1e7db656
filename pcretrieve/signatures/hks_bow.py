"""ShapeGoogle: a surface as a bag of words, each of them a way that heat leaves a point.

The words are the same for every collection. They are means (k-means from a fixed start) of the features of
some hundred points on simulated people, animals and hands, which are stored beside this file; so a signature
depends on its own shape alone, and signatures of different collections compare. A vocabulary learned from the
gallery would fit it better and change with every shape that is added.
"""

from __future__ import annotations

from functools import cache
from importlib import resources

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.spatial.distance import cdist

from pcretrieve.errors import OptionError
from pcretrieve.spectral import eigenpairs, laplace_beltrami
from pcretrieve.types import Eigenpairs, FloatArray, Signature, TriangleMesh

__all__ = ["heat_features", "hks_bow", "unit_eigenpairs"]

# Six times, as ShapeGoogle has, on a surface of unit area: the first sees a finger, the last half the body.
TIMES = np.geomspace(0.002, 0.2, 6)

# Bronstein and Kokkinos: derivatives over sixteenths of an octave of time, and six of their frequencies.
LOG_TIMES = np.linspace(np.log(0.001), np.log(1), 97)
N_FREQUENCIES = 6

# How far heat goes between two words that are counted as near each other; time on a surface of unit area.
SPATIAL_TIME = 0.02

# Added to every word's share of the surface: a word that is not on it would have no logarithm, and one that
# is on a millionth of it would outweigh all others in a distance of logarithms.
SMALLEST_SHARE = 1e-3

# Means of fewer points than this are no vocabulary, and some would be left without any.
POINTS_PER_WORD = 8

SAMPLE = "hks_sample.npy"


def hks_bow(
    mesh: TriangleMesh,
    n_words: int = 23,
    n_modes: int = 60,
    *,
    spatial: bool = False,
    scale_invariant: bool = False,
) -> Signature:
    """Heat kernel signatures, vector-quantised softly into a bag of words [1]_, sections 3 and 4.

    A point belongs to words in proportion to exp(−‖p − word‖² / 2σ²), with σ twice the median distance from a
    word to the next.

    Parameters
    ----------
    mesh : TriangleMesh
        Connected.
    n_words : int, default 23
        Words of the vocabulary.
    n_modes : int, default 60
        m, the modes that the heat kernel is summed over.
    spatial : bool, default False
        Count pairs of words, weighted by the heat that flows between them, in place of words.
    scale_invariant : bool, default False
        Describe points by scale-invariant heat kernel signatures [2]_. The others are free of the size of the
        surface too, but not of that of its parts.

    Returns
    -------
    Signature
        values (L,): the share of the surface in each word, plus a thousandth; or, spatially sensitive, that
        of each of the L (L + 1) / 2 pairs. Dimensionless, in the order of the vocabulary; unchanged by
        isometry and scaling.

    Raises
    ------
    OptionError
        If there are too many words.
    SpectrumError, DegenerateMeshError
        If the surface has no spectrum of `n_modes` modes.

    References
    ----------
    .. [1] A. Bronstein, M. Bronstein, L. Guibas and M. Ovsjanikov, "Shape Google: geometric words and
       expressions for invariant shape retrieval", ACM Transactions on Graphics 30 (2011).
    .. [2] M. Bronstein and I. Kokkinos, "Scale-invariant heat kernel signatures for non-rigid shape
       recognition", CVPR 2010.
    """
    words, width = _vocabulary(n_words, scale_invariant)
    pairs = unit_eigenpairs(mesh, n_modes)
    squared = cdist(heat_features(pairs, scale_invariant=scale_invariant), words, "sqeuclidean")  # (n, L)
    # Relative to the nearest word, so that a point far from all of them still belongs to some.
    nearness = np.exp(-(squared - squared.min(axis=1, keepdims=True)) / (2 * width**2))
    belongs = nearness / nearness.sum(axis=1, keepdims=True)  # (n, L)
    in_modes = (pairs.mass @ pairs.eigenvectors).T @ belongs  # (m + 1, L): ∫ φ_k θ_w
    if spatial:
        heat = np.exp(-SPATIAL_TIME * pairs.eigenvalues)  # (m + 1,)
        shares = ((in_modes.T * heat) @ in_modes)[np.triu_indices(n_words)]  # (L (L + 1) / 2,)
    else:
        shares = in_modes[0]  # φ_0 is one on unit area
    kind = "si-hks-bow" if scale_invariant else "hks-bow"
    # The heat kernel cut at m modes may be negative where it is small.
    return Signature(
        np.maximum(shares, 0) + SMALLEST_SHARE,
        kind=f"{kind}-spatial" if spatial else kind,
        digest=f"L={n_words} m={n_modes}",
    )


def unit_eigenpairs(mesh: TriangleMesh, n_modes: int) -> Eigenpairs:
    """The m + 1 lowest eigenpairs of a surface scaled to unit area, by linear elements."""
    unit = TriangleMesh((mesh.vertices - mesh.vertices.mean(axis=0)) / np.sqrt(mesh.area), mesh.faces)
    return eigenpairs(laplace_beltrami(unit), n_modes + 1)


def heat_features(pairs: Eigenpairs, *, scale_invariant: bool = False) -> FloatArray:
    """Heat kernel signatures of all vertices.

    Parameters
    ----------
    pairs : Eigenpairs
        Of a surface of unit area.
    scale_invariant : bool, default False

    Returns
    -------
    (n, 6) float64
        log of h_t(x) = Σ exp(−λ_k t) φ_k(x)² over its mean, at six times; or the magnitudes of the six lowest
        frequencies of ∂ log h / ∂ log t over log t, which a change of size only shifts.
    """
    times = np.exp(LOG_TIMES) if scale_invariant else TIMES
    decay = np.exp(-np.outer(pairs.eigenvalues, times))  # (k, t)
    logs = np.log(pairs.eigenvectors**2 @ decay)  # (n, t)
    if scale_invariant:
        frequencies = np.fft.rfft(np.diff(logs, axis=1), axis=1)
        return np.abs(frequencies[:, :N_FREQUENCIES])
    return np.asarray(logs - np.log(decay.sum(axis=0)))


@cache
def _vocabulary(n_words: int, scale_invariant: bool) -> tuple[FloatArray, float]:
    """(L, 6) words, and the σ that points belong to them by."""
    sample = np.load(str(resources.files(__package__).joinpath(SAMPLE)))[int(scale_invariant)]  # (s, 6)
    most = len(sample) // POINTS_PER_WORD
    if not 2 <= n_words <= most:
        raise OptionError(f"n_values must be between 2 and {most} for a bag of words, got {n_words}")
    start = np.random.default_rng(0).choice(len(sample), n_words, replace=False)
    words, _ = kmeans2(sample.astype(np.float64), sample[start].astype(np.float64), iter=50, minit="matrix")
    gaps = cdist(words, words)
    np.fill_diagonal(gaps, np.inf)
    return words, 2 * float(np.median(gaps.min(axis=1)))
