"""The result of inspecting one scan: a value, with the next body that its error bar is compared with."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pcretrieve.checks.grading import NEXT_BODY, Check, Outcome, percent, verdict_of
from pcretrieve.values import Failure, FloatArray, PointCloud, Signature, Step, TriangleMesh, Verdict


@dataclass(frozen=True, slots=True)
class NextBody:
    """The most similar other body."""

    distance: float = NEXT_BODY
    id: str | None = None
    label: str | None = None
    source: str = (
        f"The distance to the next body, {NEXT_BODY:g}, is that of people: simulated ones are "
        "that far from the most similar other person. Name a catalogue to have it measured there."
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
        Without the size of the body.
    rescan_deviation : (L,) float64 or None
        Standard deviation (ddof 0) of the logarithm of each value of the signature over simulated rescans. It
        is not `Signature.deviation`, which is over surfaces reconstructed from one scan.
    spread : float or None
        Root mean square distance of the log-signatures of rescans to their mean; dimensionless.
    failure : Failure or None
        The stage that failed, and its error; None if there is a signature.
    steps : tuple of Step
        The provenance of the last result.
    next_body : NextBody
        The distance with which the error bar of the signature is compared.
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
    next_body: NextBody = field(default_factory=NextBody)

    @property
    def verdict(self) -> Outcome:
        """That of the shape: "passed" if it is sound, "look" if doubtful, "failed" if unusable or none."""
        judged = self.shape_verdict
        if judged is None:
            return "failed"
        return "passed" if judged.is_sound else "look" if judged.judgement == "doubtful" else "failed"

    @property
    def shape_verdict(self) -> Verdict | None:
        """The verdict on the shape by all checks, the rescans and the next body; None without a signature.

        Its uncertainty is the error bar of the signature.
        """
        if self.signature is None:
            return None
        return verdict_of(self.checks, spread=self.spread, next_body=self.next_body.distance)

    @property
    def summary(self) -> str:
        """The verdict in one or two sentences: the error bar of the signature, and what to look at."""
        failed, look = (
            [check.name.lower() for check in self.checks if check.verdict == verdict]
            for verdict in ("failed", "look")
        )
        judged = self.shape_verdict
        if judged is None:
            stage = "" if self.failure is None else self.failure.stage
            causes = [name for name in failed if stage not in name] or look
            because = f"; look at: {', '.join(causes)}" if causes else ""
            return f"No signature, the {stage} stage failed{because}."
        ratio = judged.uncertainty / self.next_body.distance if self.next_body.distance else np.inf
        times = f"{percent(ratio)} of" if ratio <= 1 else f"{min(ratio, 100):.2g} times"
        size = f"± {judged.uncertainty:.2g}, is {times} the distance to the next body."
        words = {"sound": "A good scan", "doubtful": "A doubtful scan", "unusable": "Do not trust this scan"}
        before = f"{', '.join(failed)} failed; by the other checks, " if failed else ""
        after = f" Look at: {', '.join(look)}." if look else ""
        return f"{words[judged.judgement]}: {before}its error bar, {size}{after}"

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
