"""Checks of the spectra of the surfaces of a scan."""

from __future__ import annotations

import numpy as np

from pcretrieve.checks.check import Check, Limits, graded
from pcretrieve.values import Shape

__all__ = ["spectrum_checks"]

# Smallest ratio of the first two positive eigenvalues of one body. See docs/decisions.md, NECK.
NECK = 0.2
NECK_ERROR = 0.45

# Number of eigenvalues that are compared between surfaces, as many as the values of the paper's signature.
N_COMPARED = 23

# See docs/decisions.md, DISAGREEMENT.
DISAGREEMENT: Limits = (0.08, 0.4)

# Ratio of the deviation of this signature over surfaces to that of the eigenvalues.
ERROR_OF_DISAGREEMENT = 2.0


def spectrum_checks(shape: Shape) -> list[Check]:
    """Check whether the surface is that of one body, and whether all surfaces of the scan agree."""
    logs = np.log([surface.spectrum.eigenvalues[1:] for surface in shape.surfaces if surface.spectrum])
    checks = []
    if logs.size and logs.shape[1] > 1:
        ratio = float(np.exp(logs[0, 0] - logs[0, 1]))
        narrow = ratio < NECK
        checks.append(
            Check(
                "One body",
                "look" if narrow else "passed",
                ratio,
                f"the first eigenvalue is {ratio:.2g} of the second",
                "A narrow neck joins two parts of one size, as where two bodies touch: give each body a file "
                "of its own."
                if narrow
                else "No narrow neck divides the surface into halves.",
                NECK_ERROR if narrow else 0.0,
            )
        )
    if len(logs) > 1:
        apart = float(np.linalg.norm(logs[:, :N_COMPARED].std(axis=0, ddof=1)))
        checks.append(
            graded(
                "Surfaces",
                apart,
                DISAGREEMENT,
                f"{apart:.2g} between the spectra of {len(logs)} surfaces",
                passed="The surfaces on grids of different voxels agree.",
                poor="The surface depends on the grid where parts touch or are thin: scan more densely, pose "
                "limbs apart, and repair a mesh that is welded.",
                error=ERROR_OF_DISAGREEMENT * apart,
            )
        )
    return checks
