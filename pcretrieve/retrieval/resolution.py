"""Whitening by what the resolution of a surface changes.

How far fingers are parted and folds are open in a reconstruction depends on the size of its cells more than
on who was scanned. What that does to log-signatures has been measured once, on simulated people, animals and
hands: each was scanned, and rebuilt from cells of two sizes. Directions in which the two differ count less
[1]_. Nothing is fitted to the shapes that are compared: one of them, or a million, get the same map.

mAP without and with it, L = 23: TOSCA's clean meshes .960, .956; its scans .820, .868; easy scans .858, .874;
scans with sensor positions .780, .807; SHREC'11 .978, .981 (L = 60: .979, .987). Where little but the girth
of limbs tells bodies apart it does harm, for that is what resolution changes too: ten simulated people .936,
.848, and their scans .893, .815.

References
----------
.. [1] Hatch, Kajarekar and Stolcke, "Within-class covariance normalization for SVM-based speaker
   recognition", Interspeech 2006; each body is a class of two members here.
"""

from __future__ import annotations

from importlib import resources

import numpy as np

from pcretrieve.errors import OptionError
from pcretrieve.options import SignatureOptions
from pcretrieve.retrieval.whitening import Whitening, checked_damping, inverse_square_root

__all__ = ["is_measured", "resolution_whitening"]

# (2, n, m + 1) float32, made by scripts/sample_resolution: logarithms of |μ_1| … |μ_m| and μ_0 over the
# squared area, of n bodies, from small cells and from large ones.
SAMPLE = "resolution.npy"

# The share of bodies that it is taken from: in the others, cells of one size fused limbs, or lost a tail, and
# those few would outweigh the rest. mAP of TOSCA's scans by each half of the sample, .825 without whitening:
# .808 and .776 with all bodies, .844 and .854 with these.
MOST = 0.85

METHOD = "r-bihdm"
N_MODES = 60


def is_measured(options: SignatureOptions) -> bool:
    """Whether there is a `resolution_whitening` of such signatures."""
    return options.method == METHOD and options.n_modes == N_MODES and options.scale != "absolute"


def resolution_whitening(
    options: SignatureOptions, *, damping: float | None = None, options_digest: str = ""
) -> Whitening:
    """The whitening W = s (C + d c I)^(−1/2), C being the mean square of what resolution changes.

    Parameters
    ----------
    options : SignatureOptions
        Of the signatures: R-BiHDM with 60 modes, by area or relative.
    damping : float, optional
        d, in (0, 1], in units of c, the largest eigenvalue of C; by default as in `DEFAULT_DAMPING`.
    options_digest : str
        Digest of the table that it is for.

    Returns
    -------
    Whitening
        Its s leaves the mean square length of differences that know no direction as it was. The value that
        is the size, where that has a weight, stays what it is.

    Raises
    ------
    OptionError
        For other signatures, or damping out of range.
    """
    if not is_measured(options):
        raise OptionError(
            f"whitening 'resolution' has been measured for {METHOD} with n_modes = {N_MODES}, by area or "
            f"relative, got {options.method} with {options.n_modes}, {options.scale}: take 'pca' or 'none'"
        )
    damping = checked_damping("resolution", damping)
    sample = np.load(str(resources.files(__package__).joinpath(SAMPLE))).astype(np.float64)
    if options.scale == "relative":
        sample -= sample[:, :, -1:]
    logs = sample[:, :, : options.n_values]
    change = logs[0] - logs[1]  # (n, L)
    size = np.linalg.norm(change, axis=1)
    change = change[size <= np.quantile(size, MOST)]
    covariance = change.T @ change / len(change)
    largest = np.linalg.eigvalsh(covariance)[-1]
    root = inverse_square_root(covariance + damping * largest * np.eye(len(covariance)))
    root *= np.sqrt(len(root) / np.trace(root @ root))
    mean = logs.mean(axis=(0, 1))
    if options.size_weight:
        root, mean = np.pad(root, (0, 1)), np.append(mean, 0.0)
        root[-1, -1] = 1
    return Whitening("resolution", mean, root, len(change), damping, options_digest)
