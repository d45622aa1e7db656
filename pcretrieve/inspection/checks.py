"""Checks of the signature of a scan by rescans, and the reports of stages that failed."""

from __future__ import annotations

from pcretrieve.checks import Check, Limits, graded
from pcretrieve.values import Failure

__all__ = ["failure_check", "rescan_check", "spread_check"]

# What scans of known quality have: see docs/decisions.md, SPREAD.
SPREAD: Limits = (0.15, 0.5)


def spread_check(spread: float) -> Check:
    """Check the spread of the signature over simulated rescans."""
    return graded(
        "Signature",
        spread,
        SPREAD,
        f"± {spread:.2g} over rescans",
        passed="It hardly changes when a tenth of the points is left out.",
        poor="It changes when a tenth of the points is left out, and so do its nearest neighbours: correct "
        "what the other checks name, and scan more than once.",
    )


def failure_check(failure: Failure) -> Check:
    """Report the stage that failed."""
    return Check(f"The {failure.stage} stage", "failed", None, failure.error, failure.message)


def rescan_check(failure: Failure) -> Check:
    """Report a signature without an error bar, because a part of the points has no signature."""
    return Check("Signature", "failed", None, "none for nine tenths of the points", failure.message)
