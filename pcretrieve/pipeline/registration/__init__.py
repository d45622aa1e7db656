"""Registration of range scans whose poses are not known, or known roughly.

In come views as point clouds, each in a frame of its own; out go their rigid motions into a common frame,
and the cloud that they make together.
"""

from pcretrieve.pipeline.registration.alignment import Overlap
from pcretrieve.pipeline.registration.register import Merged, merge_views

__all__ = ["Merged", "Overlap", "merge_views"]
