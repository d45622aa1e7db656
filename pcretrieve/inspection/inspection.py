"""What is known of one inspected scan."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pcretrieve.inspection.checks import VERDICTS, Check, Verdict
from pcretrieve.types import Failure, FloatArray, PointCloud, Signature, Step, TriangleMesh

__all__ = ["Inspection"]


@dataclass(frozen=True, eq=False)
class Inspection:
    """One scan as far as the stages came, and what they made of it. Lengths are in the unit of the scan.

    Attributes
    ----------
    name : str
        What the scan is called on the page.
    path : str
        Where it came from; may be empty.
    checks : tuple of Check
        Worst first.
    scan : PointCloud or None
        As it was read; None where it was not, and for a mesh that was used as it is.
    dropped : (n,) bool
        Points of `scan` that no point of `cloud` stands for.
    cloud : PointCloud or None
        Cleaned, with normals where they were found.
    spacing : float
        Median distance from a point of `cloud` to its nearest neighbour.
    mesh : TriangleMesh or None
    filled : (m,) bool
        Faces of `mesh` without a point nearby.
    cuts, bridges : (k, 3) float64
        Where the surface was cut apart, and where a gap in it was bridged.
    signature : Signature or None
    rescan_deviation : (L,) float64 or None
        Standard deviation (ddof 0) of the logarithm of each value of the signature over simulated rescans. It
        is not `Signature.deviation`, which is over surfaces reconstructed from one scan.
    spread : float or None
        Root mean square distance of the log-signatures of rescans to their mean.
    failure : Failure or None
        Which stage stopped, and why.
    steps : tuple of Step
    """

    name: str
    path: str
    checks: tuple[Check, ...]
    scan: PointCloud | None
    dropped: NDArray[np.bool_]
    cloud: PointCloud | None
    spacing: float
    mesh: TriangleMesh | None
    filled: NDArray[np.bool_]
    cuts: FloatArray
    bridges: FloatArray
    signature: Signature | None
    rescan_deviation: FloatArray | None
    spread: float | None
    failure: Failure | None
    steps: tuple[Step, ...]

    @property
    def verdict(self) -> Verdict:
        """The worst of the checks."""
        given = {check.verdict for check in self.checks}
        return next((verdict for verdict in VERDICTS if verdict in given), "passed")

    @property
    def summary(self) -> str:
        """The verdict in one line."""
        failed, look = (
            [check.name.lower() for check in self.checks if check.verdict == verdict]
            for verdict in ("failed", "look")
        )
        if self.failure is not None:
            causes = [name for name in failed if self.failure.stage not in name] or look
            because = f"; look at: {', '.join(causes)}" if causes else ""
            return f"No signature, the {self.failure.stage} stage failed{because}."
        if failed:
            return f"Do not trust this scan: {', '.join(failed)}."
        if look:
            return f"Usable, but look at: {', '.join(look)}."
        return "A good scan: all checks passed."

    @cached_property
    def body(self) -> FloatArray:
        """(n, 3) points that pictures must show: all but what was dropped."""
        parts = [np.zeros((0, 3))]
        if self.cloud is not None:
            parts.append(self.cloud.points)
        elif self.scan is not None:
            parts.append(self.scan.points)
        if self.mesh is not None:
            parts.append(self.mesh.vertices)
        return np.concatenate(parts)
