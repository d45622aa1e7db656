"""What is wrong with a scan.

In comes one scan, run through the stages of the pipeline; out comes an `Inspection`: what every stage made of
it, checks in plain words, and the error bar of its signature.
"""

from pcretrieve.inspection.inspect import inspect_scan, signature_spread
from pcretrieve.inspection.inspection import Inspection

__all__ = ["Inspection", "inspect_scan", "signature_spread"]
