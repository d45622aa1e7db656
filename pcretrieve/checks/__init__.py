"""How far the signature of a scan can be relied on.

In come the points, the surface and the spectrum of one scan; out come checks, each with a verdict and advice,
and the verdict on the whole shape. The checks take a few hundredths of a second, so that every scan is
checked; `pcretrieve.inspection` adds rescans, and shows the findings.
"""

from pcretrieve.checks.check import OUTCOMES, Check, Limits, Outcome, graded
from pcretrieve.checks.findings import Findings, findings_of
from pcretrieve.checks.points import normal_checks, point_checks
from pcretrieve.checks.surfaces import base_check, fit_checks, marks_check, mesh_check, surface_checks
from pcretrieve.checks.verdict import NEXT_BODY, verdict_of

__all__ = [
    "NEXT_BODY",
    "OUTCOMES",
    "Check",
    "Findings",
    "Limits",
    "Outcome",
    "base_check",
    "findings_of",
    "fit_checks",
    "graded",
    "marks_check",
    "mesh_check",
    "normal_checks",
    "point_checks",
    "surface_checks",
    "verdict_of",
]
