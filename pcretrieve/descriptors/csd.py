"""The compact shape descriptor: means of point descriptors of the heat and the wave kernel over a surface."""

from __future__ import annotations

import numpy as np

from pcretrieve.descriptors.descriptor import Descriptor, check_modes
from pcretrieve.errors import OptionError
from pcretrieve.values import Eigenpairs, FloatArray, ModalSpectrum, Signature

# One value in three is of the heat kernel: Chiotellis et al. take 50 and 100.
HEAT_SHARE = 3

# Logarithms of the diffusion times of the heat kernel, about a tenth of an octave apart.
LOG_TIMES = np.linspace(np.log(0.001), np.log(1), 97)

# The heat kernel is sampled at 97 times, whose differences have 49 frequencies.
MOST_VALUES = 3 * 49


def csd(pairs: Eigenpairs, n_values: int = 23, n_modes: int = 60) -> Signature:
    """The mean over a surface of two point descriptors, each scaled to unit length at every point [1]_.

    Two thirds of the values are the wave kernel signature [2]_, equation (4), at energies that are evenly
    spaced from log λ_1 to log λ_m. The others are the lowest frequencies of the scale-invariant heat kernel
    signature [3]_, the zero frequency and the constant eigenfunction included.

    pairs: at least `n_modes` + 1 eigenpairs of a connected surface on unit area.
    Returns Signature: values : (L,) float64: first the wave kernel by ascending energy, then the heat kernel
        by ascending frequency; dimensionless, between 0 and 1. Invariant to isometry and scaling.

    References
    ----------
    .. [1] I. Chiotellis, R. Triebel, T. Windheuser and D. Cremers, "Non-rigid 3D shape retrieval via large
       margin nearest neighbor embedding", ECCV 2016, section 3.
    .. [2] M. Aubry, U. Schlickewei and D. Cremers, "The wave kernel signature: a quantum mechanical approach
       to shape analysis", ICCV Workshops 2011.
    .. [3] M. Bronstein and I. Kokkinos, "Scale-invariant heat kernel signatures for non-rigid shape
       recognition", CVPR 2010.
    """
    if not HEAT_SHARE <= n_values <= MOST_VALUES:
        raise OptionError(
            f"n_values must be between {HEAT_SHARE} and {MOST_VALUES} for csd, got {n_values}"
        )
    n_frequencies = n_values // HEAT_SHARE
    weights = wave_kernel_weights(
        pairs.eigenvalues, n_values - n_frequencies, n_modes
    )  # (e, m)
    lowest = pairs.lowest(n_modes + 1)
    wave = lowest.eigenvectors[:, 1:] ** 2 @ weights.T  # (n, e)
    heat = scale_invariant_heat(lowest, n_frequencies)  # (n, f)
    # (n,), the areas of the vertices, of sum 1.
    areas = pairs.mass @ np.ones(pairs.mass.shape[0])
    values = np.concatenate([_mean_direction(wave, areas), _mean_direction(heat, areas)])
    return Signature(values, kind="csd", digest=f"L={n_values} m={n_modes}")


def scale_invariant_heat(pairs: Eigenpairs, n_frequencies: int) -> FloatArray:
    """Scale-invariant heat kernel signatures of all vertices.

    The heat kernel signature is h_t(x) = Σ_k exp(−λ_k t) φ_k(x)². A scaling of the surface shifts the
    derivative ∂ log h / ∂ log t along log t, and so changes the phases of its Fourier transform alone.

    Returns (n, f) float64: magnitudes of the lowest frequencies of that transform, the zero frequency first.
    """
    decay = np.exp(-np.outer(pairs.eigenvalues, np.exp(LOG_TIMES)))  # (k, t)
    slopes = np.diff(np.log(pairs.eigenvectors**2 @ decay), axis=1)  # (n, t - 1)
    return np.abs(np.fft.rfft(slopes, axis=1)[:, :n_frequencies])


def _mean_direction(features: FloatArray, areas: FloatArray) -> FloatArray:
    """The mean (d,) over the surface of point descriptors (n, d) scaled to unit length."""
    return np.asarray((areas / np.linalg.norm(features, axis=1)) @ features)


CSD = Descriptor(
    name="csd",
    make=lambda shape, o: csd(shape.eigenpairs, o.n_values, o.n_modes),
    needs=("eigenvectors",),
    has_size=False,
    spread=0.18,
)


# σ of the distribution of energies, relative to their range. Aubry et al. take 7 of 100 energy steps.
WIDTH = 0.07


def wks(
    pairs: Eigenpairs | ModalSpectrum, n_values: int = 23, n_modes: int = 60
) -> Signature:
    """The second moment of the wave kernel signature over a surface, at L energies.

    The wave kernel signature of a point x at energy e [1]_, equations (4) and (5), is

        w_e(x) = Σ_k p_k(e) φ_k(x)²,    p_k(e) ∝ exp(−(e − log λ_k)² / 2σ²),    Σ_k p_k(e) = 1,

    summed over m modes. Its mean over a surface of area A is 1 / A for every surface. The lowest moment that
    distinguishes surfaces is the second one, which is a sum of ⟨φ_i², φ_j²⟩.

    Returns Signature: values : (L,) float64: A ∫ w_e², in the order of ascending energies. Dimensionless, at
        least 1, and 1 if w_e is constant on the surface. Invariant to isometry and scaling.

    References
    ----------
    .. [1] M. Aubry, U. Schlickewei and D. Cremers, "The wave kernel signature: a quantum mechanical approach
       to shape analysis", ICCV Workshops 2011.
    """
    spectrum = ModalSpectrum.of(pairs)
    weights = wave_kernel_weights(spectrum.eigenvalues, n_values, n_modes)  # (L, m)
    overlaps = spectrum.known_overlaps()[1 : n_modes + 1, 1 : n_modes + 1]  # (m, m)
    values = spectrum.area * np.einsum("ei,ij,ej->e", weights, overlaps, weights)  # (L,)
    return Signature(values, kind="wks", digest=f"L={n_values} m={n_modes}")


def wave_kernel_weights(
    eigenvalues: FloatArray, n_energies: int, n_modes: int
) -> FloatArray:
    """The weights p_k(e) of the modes in the wave kernel signature, as in `wks`.

    eigenvalues: (k,) float64, ascending, the zero eigenvalue first.
    Returns (n_energies, m) float64: each row sums to 1.
    """
    check_modes(n_modes, len(eigenvalues), least=2)
    levels = np.log(eigenvalues[1 : n_modes + 1])  # (m,)
    energies = np.linspace(levels[0], levels[-1], n_energies)
    width = WIDTH * (levels[-1] - levels[0])
    weights: FloatArray = np.exp(
        -((energies[:, np.newaxis] - levels) ** 2) / (2 * width**2)
    )
    weights /= weights.sum(axis=1, keepdims=True)
    return weights


WKS = Descriptor(
    name="wks",
    make=lambda shape, o: wks(shape.spectrum, o.n_values, o.n_modes),
    needs=("spectrum", "overlaps"),
    has_size=False,
    spread=0.44,
)
