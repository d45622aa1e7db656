"""Checks of a scan → the verdict on its shape."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pcretrieve.checks.check import Check
from pcretrieve.values import Judgement, Verdict

__all__ = ["NEXT_BODY", "verdict_of"]

#: Distance ``log`` of a body to the most similar other body, as of people: docs/decisions.md, NEXT_BODY.
NEXT_BODY = 0.5

# Largest uncertainty of a sound shape, and of a doubtful one, relative to the distance to the next body. See
# docs/decisions.md, DOUBTFUL.
DOUBTFUL = 0.5
UNUSABLE = 1.5

# Smallest part in the squared uncertainty of a check that is named as a reason.
REASON = 0.1


def verdict_of(
    checks: Sequence[Check], *, spread: float | None = None, next_body: float = NEXT_BODY
) -> Verdict:
    """The verdict on a shape.

    The errors of the checks are assumed to be independent, so that the uncertainty is the root of the sum of
    their squares, or the spread if that is larger.
    """
    squared = float(sum(check.error**2 for check in checks))
    uncertainty = max(float(np.sqrt(squared)), spread or 0.0)
    failed = [check for check in checks if check.verdict == "failed"]
    if not failed and uncertainty <= DOUBTFUL * next_body:
        return Verdict("sound", uncertainty)
    grave = [check for check in checks if check in failed or check.error**2 > REASON * uncertainty**2]
    grave.sort(key=lambda check: (check not in failed, -check.error))
    reasons = [f"{check.name.lower()}: {check.shown}" for check in grave]
    if spread and spread**2 > squared and all(check.name != "Signature" for check in failed):
        reasons.append(f"rescans: ± {spread:.2g}")
    judgement: Judgement = "unusable" if failed or uncertainty > UNUSABLE * next_body else "doubtful"
    return Verdict(judgement, uncertainty, tuple(reasons))
