"""How far the signature of a scan can be relied on.

In come the points, the surface and the spectrum of one scan; out come checks, each with an outcome and
advice, and the grade of the whole scan. The checks take a few hundredths of a second, so that every scan is
checked; an inspection adds rescans, and shows the findings.
"""

from pcretrieve.checks.findings import Findings, findings_of
from pcretrieve.checks.grading import OUTCOMES, Check, grade_of, graded
from pcretrieve.checks.inspection import Inspection

__all__ = [
    "OUTCOMES",
    "Check",
    "Findings",
    "Inspection",
    "findings_of",
    "grade_of",
    "graded",
]
