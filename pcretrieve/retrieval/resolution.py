"""Whitening by the covariance that the resolution of the reconstruction causes in log-signatures.

Whether fingers are separated and folds are open in a reconstructed surface depends more on the edge of the
voxels than on the body. The effect of the edge on log-signatures was measured once, on simulated people,
animals and hands: each body was scanned, and reconstructed with two voxel edges. The whitening reduces the
weight of the directions in which the two log-signatures of a body differ (within-class covariance
normalisation [1]_ with one class of two members for each body). It is not fitted to the shapes that are
compared, and therefore the same for every gallery.

It improves the rankings of scans, but not of bodies that differ mainly in the girth of their limbs, because
the voxel edge changes this girth too. See docs/decisions.md, resolution_whitening.

References
----------
.. [1] Hatch, Kajarekar and Stolcke, "Within-class covariance normalization for SVM-based speaker
   recognition", Interspeech 2006.
"""

from __future__ import annotations

from importlib import resources

import numpy as np

from pcretrieve.errors import OptionError
from pcretrieve.options import Shrinkage, SignatureOptions
from pcretrieve.retrieval.regularisation import checked_shrinkage, inverse_square_root
from pcretrieve.retrieval.whitening import Whitening
from pcretrieve.values import FloatArray

__all__ = ["is_measured", "resolution_covariance", "resolution_whitening"]

# (2, n, m + 1) float32, written by scripts/sample_resolution: logarithms of |μ_1| … |μ_m| and μ_0, divided by
# the squared area, of n bodies reconstructed with the smaller and with the larger voxel edge.
SAMPLE = "resolution.npy"

# Fraction of the bodies, those with the smallest change, of which the covariance is computed (trimming). In
# the others limbs fused, or a tail was lost, at one of the voxel edges, and these few outliers would dominate
# the covariance. See docs/decisions.md, MOST.
MOST = 0.85

METHOD = "r-bihdm"
N_MODES = 60


def is_measured(options: SignatureOptions) -> bool:
    """Whether `resolution_whitening` is defined for signatures with these options."""
    return options.method == METHOD and options.n_modes == N_MODES and options.measured_by != "absolute"


def resolution_whitening(
    options: SignatureOptions, *, shrinkage: Shrinkage = "auto", options_digest: str = ""
) -> Whitening:
    """The whitening W = s (C + d c I)^(−1/2), with C the second moment of the changes caused by resolution.

    shrinkage: d, in (0, 1], in units of c, the largest eigenvalue of C. auto: that of `DEFAULT_SHRINKAGE`.
    """
    used = checked_shrinkage("resolution", shrinkage)
    mean, change = _changes(options)
    covariance = change.T @ change / len(change)
    largest = np.linalg.eigvalsh(covariance)[-1]
    root = inverse_square_root(covariance + used * largest * np.eye(len(covariance)))
    root *= np.sqrt(len(root) / np.trace(root @ root))
    if options.size_weight:
        root, mean = np.pad(root, (0, 1)), np.append(mean, 0.0)
        root[-1, -1] = 1
    reason = f"resolution: changes of {len(change)} simulated bodies"
    return Whitening("resolution", mean, root, len(change), used, options_digest, reason)


def resolution_covariance(options: SignatureOptions) -> FloatArray | None:
    """The covariance of the changes caused by resolution, for `fit_whitening`.

    Returns (L, L) float64, or None: of trace 1; zero in the row and the column of a size. None if it was not
        measured for the options.
    """
    if not is_measured(options):
        return None
    _, change = _changes(options)
    covariance = change.T @ change
    covariance /= np.trace(covariance)
    return np.pad(covariance, (0, 1)) if options.size_weight else covariance


def _changes(options: SignatureOptions) -> tuple[FloatArray, FloatArray]:
    """The mean log-signature (L,), and the changes (n, L) of the bodies of the sample that change least."""
    if not is_measured(options):
        raise OptionError(
            f"whitening 'resolution' has been measured for {METHOD} with n_modes = {N_MODES}, by area or "
            f"relative, got {options.method} with {options.n_modes}, {options.measured_by}: take 'pca' or "
            "'none'"
        )
    sample = np.load(str(resources.files(__package__).joinpath(SAMPLE))).astype(np.float64)
    if options.measured_by == "relative":
        sample -= sample[:, :, -1:]
    logs = sample[:, :, : options.n_values]
    change = logs[0] - logs[1]  # (n, L)
    size = np.linalg.norm(change, axis=1)
    return logs.mean(axis=(0, 1)), change[size <= np.quantile(size, MOST)]
