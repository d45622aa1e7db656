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

    Attributes
    ----------
    name : str
        What was checked, such as "Noise".
    verdict : "passed", "look" or "failed"
        "passed": nothing is wrong. "look": the signature may have a larger error. "failed": the signature is
        not reliable.
    value : float or None
        The measurement that decides the verdict, mostly a fraction; None if the check has no measurement.
    shown : str
        The measurement with its unit, as text.
    words : str
        What a passed check means; what to do about one that is not passed.
    error : float, default 0
        The log-signature error that such a value causes; dimensionless. 0 if no effect on the signature is
        known.

    Raises
    ------
    InputError
        If the verdict is unknown, or the value or the error is not finite.
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

    Parameters
    ----------
    name : str
        What was checked.
    value : float
        The measurement.
    limits : tuple of float, length 2
        The largest value with which the check is passed, and the largest with which it is not failed.
    shown : str
        The measurement with its unit, as text.
    passed, poor : str
        The words for a check that is passed, and for one that is not.
    error : float, default 0
        As in `Check`.

    Returns
    -------
    Check
        The check with its verdict.
    """
    good, bad = limits
    verdict: Outcome = "passed" if value <= good else "look" if value <= bad else "failed"
    return Check(name, verdict, value, shown, passed if verdict == "passed" else poor, error)


def counted(n: int, name: str) -> str:
    """A number with its noun, such as "1 cut" and "2 cuts".

    Parameters
    ----------
    n : int
        The number.
    name : str
        The noun in the singular.

    Returns
    -------
    str
        The text.
    """
    return f"{n} {name}" if n == 1 else f"{n} {name}s"


def percent(share: float) -> str:
    """A fraction in percent with two significant digits; fractions below 1 are not rounded to 100 %.

    Parameters
    ----------
    share : float
        The fraction.

    Returns
    -------
    str
        The text, with its unit.
    """
    if 0.995 < share < 1:
        return f"{math.floor(1000 * share) / 10:.1f} %"
    return f"{100 * share:.2g} %" if share < 0.995 else "100 %"
