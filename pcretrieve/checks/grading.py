"""One check of a scan: a measurement, its verdict by two limits, and advice; the verdict of all checks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pcretrieve.values import Judgement, Verdict

Outcome = Literal["passed", "look", "failed"]

#: In descending order of severity.
OUTCOMES: tuple[Outcome, ...] = ("failed", "look", "passed")

#: Of a check, the largest value with which it is passed, and the largest with which it is not failed.
Limits = tuple[float, float]

#: Distance ``log`` of a body to the most similar other body, as of people.
NEXT_BODY = 0.5

# Largest uncertainty of a sound shape, and of a doubtful one, relative to the distance to the next body.
DOUBTFUL = 0.5
UNUSABLE = 1.5

# Smallest part in the squared uncertainty of a check that is named as a reason.
REASON = 0.1


@dataclass(frozen=True, slots=True)
class Check:
    """One check of a scan.

    shown: the measurement with its unit, as text.
    """

    name: str
    verdict: Outcome
    value: float | None
    shown: str
    words: str
    error: float = 0.0


def graded(
    name: str, value: float, limits: Limits, shown: str, *, passed: str, poor: str, error: float = 0.0
) -> Check:
    """A check of a measurement by its limits.

    shown: the measurement with its unit, as text.
    """
    good, bad = limits
    verdict: Outcome = "passed" if value <= good else "look" if value <= bad else "failed"
    return Check(name, verdict, value, shown, passed if verdict == "passed" else poor, error)


def percent(share: float) -> str:
    """A fraction in percent with two significant digits; fractions below 1 are not rounded to 100 %."""
    if 0.995 < share < 1:
        return f"{math.floor(1000 * share) / 10:.1f} %"
    return f"{100 * share:.2g} %" if share < 0.995 else "100 %"


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
