"""Checks of a scan → the verdict on its shape."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pcretrieve.quality.check import Check
from pcretrieve.types import Verdict

__all__ = ["verdict_of"]

# Largest uncertainty of a sound shape, and of a doubtful one. See docs/decisions.md, DOUBTFUL.
DOUBTFUL = 0.25
UNUSABLE = 0.75

# Smallest part in the squared uncertainty of a check that is named as a reason.
REASON = 0.1


def verdict_of(checks: Sequence[Check]) -> Verdict:
    """The verdict on a shape.

    The errors of the checks are assumed to be independent, so that the uncertainty is the root of the sum of
    their squares.

    Parameters
    ----------
    checks : sequence of Check
        All checks of the shape.

    Returns
    -------
    Verdict
        "unusable" if a check failed or the uncertainty exceeds .75, "doubtful" if it exceeds .25, otherwise
        "sound".
    """
    squared = float(sum(check.error**2 for check in checks))
    uncertainty = float(np.sqrt(squared))
    failed = [check for check in checks if check.verdict == "failed"]
    if not failed and uncertainty <= DOUBTFUL:
        return Verdict("sound", uncertainty)
    grave = [check for check in checks if check in failed or check.error**2 > REASON * squared]
    grave.sort(key=lambda check: (check not in failed, -check.error))
    return Verdict(
        "unusable" if failed or uncertainty > UNUSABLE else "doubtful",
        uncertainty,
        tuple(f"{check.name.lower()}: {check.shown}" for check in grave),
    )
