"""What is wrong with a scan.

In comes one scan, which is processed by the stages of the pipeline; out comes an `Inspection`: the result of
each stage, checks with verdicts and advice, and the rescan deviation of the signature.
"""

from pcretrieve.inspection.inspect import inspect_scan, signature_spread
from pcretrieve.inspection.inspection import Inspection
from pcretrieve.inspection.problems import report_problem

__all__ = ["Inspection", "inspect_scan", "report_problem", "signature_spread"]
