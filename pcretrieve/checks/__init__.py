"""How far the signature of a scan can be relied on.

In come the points, the surface and the spectrum of one scan; out come checks, each with a verdict and advice,
and the verdict on the whole shape. The checks take a few hundredths of a second, so that every scan is
checked; an inspection adds rescans, and shows the findings.
"""

from pcretrieve.checks.findings import Findings, findings_of
from pcretrieve.checks.grading import NEXT_BODY, OUTCOMES, Check, Limits, Outcome, graded, verdict_of
from pcretrieve.checks.inspection import Inspection, NextBody, failure_check, rescan_check, spread_check
from pcretrieve.checks.points import normal_checks, point_checks
from pcretrieve.checks.surfaces import base_check, fit_checks, marks_check, mesh_check, surface_checks

__all__ = [
    "NEXT_BODY",
    "OUTCOMES",
    "Check",
    "Findings",
    "Inspection",
    "Limits",
    "NextBody",
    "Outcome",
    "base_check",
    "failure_check",
    "findings_of",
    "fit_checks",
    "graded",
    "marks_check",
    "mesh_check",
    "normal_checks",
    "point_checks",
    "rescan_check",
    "spread_check",
    "surface_checks",
    "verdict_of",
]
