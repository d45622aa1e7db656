"""How far the signature of a scan can be relied on.

In come the points, the surface and the spectrum of one scan; out come checks, each with a verdict and advice,
and the verdict on the whole shape. The checks take a few hundredths of a second, so that every scan is
checked; an inspection adds rescans, and shows the findings.
"""

from pcretrieve.checks.findings import findings_of
from pcretrieve.checks.grading import OUTCOMES, Check, graded, verdict_of
from pcretrieve.checks.inspection import Inspection

__all__ = ["OUTCOMES", "Check", "Inspection", "findings_of", "graded", "verdict_of"]
