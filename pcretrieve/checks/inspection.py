"""The result of inspecting one scan."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pcretrieve.checks.grading import Check, Outcome, verdict_of
from pcretrieve.values import (
    Failure,
    FloatArray,
    PointCloud,
    Signature,
    Step,
    TriangleMesh,
    Verdict,
)


@dataclass(frozen=True, eq=False)
class Inspection:
    """A scan, the results of the stages that did not fail, and checks. Lengths are in the unit of the scan.

    Attributes
    ----------
    name : str
        Title of the page.
    path : str
        The file of the scan; may be empty.
    checks : tuple of Check
        In descending order of severity.
    scan : PointCloud or None
        The raw points. None if the scan could not be read, or is a mesh that is used without reconstruction.
    cut_away : (n,) bool
        Points of `scan` that the stage `crop` removed: background, ground and strays.
    dropped : (n,) bool
        Other points of `scan` that were removed: outliers. As many as the checks and the steps count.
    cloud : PointCloud or None
        The filtered points; with normals, if the stage `orient` did not fail.
    spacing : float
        Median distance from a point of `cloud` to its nearest neighbour.
    mesh : TriangleMesh or None
        The first surface.
    filled : (m,) bool
        Faces of `mesh` without a point nearby.
    cuts, bridges : (k, 3) float64
        Places where parts of the surface that touch were separated, and where a loose part was connected.
    signature : Signature or None
        That of `r_bihdm`, L = 23, which the error bar is of.
    rescan_deviation : (L,) float64 or None
        Standard deviation (ddof 0) of the logarithm of each value of the signature over simulated rescans. It
        is not `Signature.deviation`, which is over surfaces reconstructed from one scan.
    spread : float or None
        Root mean square distance of the log-signatures of rescans to their mean; dimensionless.
    failure : Failure or None
        The stage that failed, and its error; None if there is a signature.
    steps : tuple of Step
        The provenance of the last result.
    """

    name: str
    path: str
    checks: tuple[Check, ...]
    scan: PointCloud | None
    cut_away: NDArray[np.bool_]
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
    def verdict(self) -> Outcome:
        """That of the shape: "passed" if it is good, "look" if incomplete, "failed" if there is none."""
        judged = self.shape_verdict
        return "failed" if judged is None else "passed" if judged.is_good else "look"

    @property
    def shape_verdict(self) -> Verdict | None:
        """The verdict on the shape by all checks and the rescans; None without a signature.

        Its uncertainty is the error bar of the signature.
        """
        if self.signature is None:
            return None
        return verdict_of(self.checks, spread=self.spread)

    @property
    def summary(self) -> str:
        """The grade in one or two sentences: the error bar of the signature, and what to look at."""
        look = [check.name.lower() for check in self.checks if check.verdict != "passed"]
        judged = self.shape_verdict
        if judged is None:
            stage = "" if self.failure is None else self.failure.stage
            causes = [name for name in look if stage not in name]
            because = f"; look at: {', '.join(causes)}" if causes else ""
            return f"No signature, the {stage} stage failed{because}."
        error = f"the error bar of its signature is ± {judged.uncertainty:.2g}."
        if judged.is_good:
            after = f" Look at: {', '.join(look)}." if look else ""
            return f"A good scan: {error}{after}"
        word = "An incomplete" if judged.judgement == "incomplete" else "A poor"
        return f"{word} scan, may answer wrongly: {'; '.join(judged.reasons)}; {error}"

    @property
    def rings(self) -> FloatArray:
        """(k, 3) places of the checks that make the scan poor or incomplete."""
        found = [place for check in self.checks if check.grade for place in check.places]
        return np.array(found, dtype=np.float64).reshape(-1, 3)

    @cached_property
    def body(self) -> FloatArray:
        """The points that all pictures show, (n, 3): filtered points, or else raw points, and vertices."""
        parts = [np.zeros((0, 3))]
        if self.cloud is not None:
            parts.append(self.cloud.points)
        elif self.scan is not None:
            parts.append(self.scan.points)
        if self.mesh is not None:
            parts.append(self.mesh.vertices)
        return np.concatenate(parts)
