"""The result of inspecting one scan."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pcretrieve.checks.grading import Check, Outcome, grade_of
from pcretrieve.values import (
    Failure,
    FloatArray,
    Grade,
    PointCloud,
    Signature,
    Step,
    TriangleMesh,
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
    rescan_errors : (L,) float64 or None
        Standard deviation (ddof 0) of the logarithm of each value of the signature over simulated rescans. It
        is not `Signature.errors`, which is over surfaces reconstructed from one scan.
    rescan_error : float or None
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
    rescan_errors: FloatArray | None
    rescan_error: float | None
    failure: Failure | None
    steps: tuple[Step, ...]

    @property
    def outcome(self) -> Outcome:
        """That of the scan: "passed" if it is good, "look" if incomplete, "failed" if there is none."""
        grade = self.grade
        return "failed" if grade is None else "passed" if grade.is_good else "look"

    @property
    def grade(self) -> Grade | None:
        """The grade of the scan by all checks and the rescans; None without a signature.

        Its error is that of the signature.
        """
        if self.signature is None:
            return None
        return grade_of(self.checks, rescan_error=self.rescan_error)

    @property
    def summary(self) -> str:
        """The grade in one or two sentences: the error bar of the signature, and what to look at."""
        look = [check.name.lower() for check in self.checks if check.outcome != "passed"]
        grade = self.grade
        if grade is None:
            stage = "" if self.failure is None else self.failure.stage
            causes = [name for name in look if stage not in name]
            because = f"; look at: {', '.join(causes)}" if causes else ""
            return f"No signature, the {stage} stage failed{because}."
        error = f"the error bar of its signature is ± {grade.error:.2g}."
        if grade.is_good:
            after = f" Look at: {', '.join(look)}." if look else ""
            return f"A good scan: {error}{after}"
        word = "An incomplete" if grade.name == "incomplete" else "A poor"
        return f"{word} scan, may answer wrongly: {'; '.join(grade.reasons)}; {error}"

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
