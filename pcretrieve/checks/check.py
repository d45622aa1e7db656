"""One check of a scan: a measurement, its verdict by two limits, and advice."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from pcretrieve.errors import InputError

__all__ = ["OUTCOMES", "Check", "Limits", "Outcome", "counted", "graded", "percent"]

Outcome = Literal["passed", "look", "failed"]

#: In descending order of severity.
OUTCOMES: tuple[Outcome, ...] = ("failed", "look", "passed")

#: Of a check, the largest value with which it is passed, and the largest with which it is not failed.
Limits = tuple[float, float]


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

    def __post_init__(self) -> None:
        if self.verdict not in OUTCOMES:
            raise InputError(f"a verdict must be one of {', '.join(OUTCOMES)}, got {self.verdict!r}")
        for name, number in (("value", self.value or 0), ("error", self.error)):
            if not math.isfinite(number):
                raise InputError(f"the {name} of a check must be finite, got {number} for {self.name!r}")


def graded(
    name: str, value: float, limits: Limits, shown: str, *, passed: str, poor: str, error: float = 0.0
) -> Check:
    """A check of a measurement by its limits.

    shown: the measurement with its unit, as text.
    """
    good, bad = limits
    verdict: Outcome = "passed" if value <= good else "look" if value <= bad else "failed"
    return Check(name, verdict, value, shown, passed if verdict == "passed" else poor, error)


def counted(n: int, name: str) -> str:
    """A number with its noun, such as "1 cut" and "2 cuts"."""
    return f"{n} {name}" if n == 1 else f"{n} {name}s"


def percent(share: float) -> str:
    """A fraction in percent with two significant digits; fractions below 1 are not rounded to 100 %."""
    if 0.995 < share < 1:
        return f"{math.floor(1000 * share) / 10:.1f} %"
    return f"{100 * share:.2g} %" if share < 0.995 else "100 %"
