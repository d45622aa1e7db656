"""Checks of a scan: measurements of its points, normals and surface, with a verdict and advice for each."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import InputError
from pcretrieve.surface import defects
from pcretrieve.types import Failure, FloatArray, PointCloud, TriangleMesh

__all__ = [
    "VERDICTS",
    "Check",
    "Verdict",
    "failure_check",
    "fit_checks",
    "marks_check",
    "normal_checks",
    "point_checks",
    "rescan_check",
    "spread_check",
    "surface_checks",
]

Verdict = Literal["passed", "look", "failed"]

#: In descending order of severity.
VERDICTS: tuple[Verdict, ...] = ("failed", "look", "passed")

# Of each check, the largest value with which it is passed, and the largest with which it is not failed. What
# scans of known quality have: see docs/decisions.md, SPACING, and the rows below it.
Limits = tuple[float, float]
SPACING: Limits = (0.005, 0.015)
OUTLIERS: Limits = (0.02, 0.15)
DISAGREEING: Limits = (0.05, 0.25)
UNBALANCED: Limits = (0.15, 0.25)
UNSUPPORTED: Limits = (0.01, 0.15)
LOST: Limits = (0.005, 0.05)
NOISE: Limits = (0.0025, 0.01)
SPREAD: Limits = (0.15, 0.5)


@dataclass(frozen=True, slots=True)
class Check:
    """One check of a scan.

    Attributes
    ----------
    name : str
        What was checked, such as "Noise".
    verdict : "passed", "look" or "failed"
        "passed": nothing is wrong. "look": the signature may have a larger error. "failed": the signature is
        not reliable.
    value : float or None
        The measurement that decides the verdict, mostly a fraction; None if the check has no measurement.
    shown : str
        The measurement with its unit, as text.
    words : str
        What a passed check means; what to do about one that is not passed.

    Raises
    ------
    InputError
        If the verdict is unknown or the value is not finite.
    """

    name: str
    verdict: Verdict
    value: float | None
    shown: str
    words: str

    def __post_init__(self) -> None:
        if self.verdict not in VERDICTS:
            raise InputError(f"a verdict must be one of {', '.join(VERDICTS)}, got {self.verdict!r}")
        if self.value is not None and not math.isfinite(self.value):
            raise InputError(f"the value of a check must be finite, got {self.value} for {self.name!r}")


def point_checks(cloud: PointCloud, *, spacing: float) -> list[Check]:
    """Check the density of a filtered cloud, the fraction of outliers, and how its outside was found.

    Parameters
    ----------
    cloud : PointCloud
        The check "Outliers" is left out if there is no step ``clean`` in the provenance.
    spacing : float
        Median distance from a point to its nearest neighbour; unit of the file.

    Returns
    -------
    list of Check
        "Points": spacing relative to the diagonal. "Outliers": fraction of the points of the voxel grid that
        were removed as statistical outliers. "Outside": no value.
    """
    share = spacing / cloud.diagonal
    checks = [
        _graded(
            "Points",
            share,
            SPACING,
            f"{len(cloud.points):,} points, {_percent(share)} of the diagonal apart",
            passed="Dense enough for limbs and fingers.",
            poor="Thin parts may be lost: scan more densely, or from nearer.",
        )
    ]
    for cleaned in [step.sizes for step in cloud.provenance if step.stage == "clean"]:
        outliers = 1 - cleaned["points"] / cleaned["points_thinned"]
        checks.append(
            _graded(
                "Outliers",
                outliers,
                OUTLIERS,
                f"{_percent(outliers)} dropped",
                passed="Single points off the surface were removed.",
                poor="Look at the points in red: if they belong to the body, raise scan.outlier_std; "
                "else scan again.",
            )
        )
    return [*checks, _sensor_check(cloud)]


def normal_checks(normals: FloatArray, neighbors: NDArray[np.intp]) -> list[Check]:
    """Check the consistency of the normals of a cloud, and whether they point to all sides.

    Parameters
    ----------
    normals : (n, 3) float64
        Unit normals.
    neighbors : (n, k) int
        Indices of the nearest neighbours of each point.

    Returns
    -------
    list of Check
        "Normals": fraction of pairs of neighbours whose normals are more than 90 degrees apart. "Sides seen":
        length of the mean normal.
    """
    cosines = np.einsum("ij,ikj->ik", normals, normals[neighbors])  # (n, k)
    disagreeing = float((cosines <= 0).mean())
    # The mean normal of a closed surface is 0; the mean normal of half a sphere has the length 1/2.
    unbalanced = float(np.linalg.norm(normals.mean(axis=0)))
    return [
        _graded(
            "Normals",
            disagreeing,
            DISAGREEING,
            f"{_percent(1 - disagreeing)} of neighbours agree",
            passed="Neighbouring points agree on which side is outside.",
            poor="Normals of some patches point inwards, or the points are noisy: look at the orange "
            "patches, and keep the sensor positions when scanning.",
        ),
        _graded(
            "Sides seen",
            unbalanced,
            UNBALANCED,
            f"their normals are {_percent(unbalanced)} one-sided",
            passed="The normals point to all sides.",
            poor="Most normals point the same way, as in a single view: scan the other sides too, and merge "
            "the views.",
        ),
    ]


def surface_checks(mesh: TriangleMesh) -> list[Check]:
    """Check whether a surface is one closed manifold, and count its handles.

    Parameters
    ----------
    mesh : TriangleMesh
        The surface.

    Returns
    -------
    list of Check
        "Closed surface": number of boundary edges, non-manifold edges and inconsistently oriented edges. If
        there are none, "Handles": the genus.
    """
    found = defects(mesh)
    closed = Check(
        "Closed surface",
        "look" if found else "passed",
        float(sum((found.boundary_edges, found.non_manifold_edges, found.inconsistent_edges))),
        str(found) if found else "no defects",
        "It has holes, or edges that no closed surface has: reconstruct it with surface.mode = 'reconstruct'."
        if found
        else "One closed, consistently oriented surface.",
    )
    if found:
        return [closed]
    handles = 1 - mesh.euler_characteristic // 2
    return [
        closed,
        Check(
            "Handles",
            "look" if handles else "passed",
            float(handles),
            f"{_counted(handles, 'handle')}, Euler characteristic {mesh.euler_characteristic}",
            "Right for a ring or a mug. If the body has no handle, parts that touch have fused: pose it with "
            "limbs apart, or set surface.genus = 'sphere'."
            if handles
            else "No parts that touch have fused into a ring.",
        ),
    ]


def fit_checks(*, filled: float, lost: float, noise: float) -> list[Check]:
    """Check how well points and surface fit each other.

    Parameters
    ----------
    filled : float
        Area of the surface without a point nearby; relative to the whole area.
    lost : float
        Number of points without a surface nearby; relative to all points.
    noise : float
        Root mean square distance of the other points to the surface; relative to the diagonal.

    Returns
    -------
    list of Check
        "Filled in", "Left out" and "Noise", with these values.
    """
    return [
        _graded(
            "Filled in",
            filled,
            UNSUPPORTED,
            f"{_percent(filled)} of the surface",
            passed="Nearly all of the surface lies on points.",
            poor="The orange surface is interpolated, because there are no points: scan these places too.",
        ),
        _graded(
            "Left out",
            lost,
            LOST,
            f"{_percent(lost)} of the points lie off the surface",
            passed="The surface passes by all points.",
            poor="A part of the body was cut off, or something else was scanned with it: compare the points "
            "with the surface.",
        ),
        _graded(
            "Noise",
            noise,
            NOISE,
            f"{_percent(noise)} of the diagonal (rms)",
            passed="Points lie close to the surface.",
            poor="Points scatter about the surface: scan from nearer, hold still, or align the views better.",
        ),
    ]


def marks_check(n_cuts: int, n_bridges: int) -> Check:
    """Check how often the topology of the surface was changed.

    Parameters
    ----------
    n_cuts : int
        Number of places where parts that touch were separated.
    n_bridges : int
        Number of places where a loose part was connected.

    Returns
    -------
    Check
        "Cuts and bridges": the number of both.
    """
    n = n_cuts + n_bridges
    return Check(
        "Cuts and bridges",
        "look" if n else "passed",
        float(n),
        f"{_counted(n_cuts, 'cut')}, {_counted(n_bridges, 'bridge')}",
        "Look at the rings: parts that touch were separated there, or a loose part was connected; pose limbs "
        "apart, and scan between them."
        if n
        else "No parts had to be separated or connected.",
    )


def spread_check(spread: float) -> Check:
    """Check the spread of the signature over simulated rescans.

    Parameters
    ----------
    spread : float
        As of `pcretrieve.inspection.signature_spread`; dimensionless.

    Returns
    -------
    Check
        "Signature": the spread.
    """
    return _graded(
        "Signature",
        spread,
        SPREAD,
        f"± {spread:.2g} over rescans",
        passed="It hardly changes when a tenth of the points is left out.",
        poor="It changes when a tenth of the points is left out, and so do its nearest neighbours: correct "
        "what the other checks name, and scan more than once.",
    )


def failure_check(failure: Failure) -> Check:
    """Report the stage that failed.

    Parameters
    ----------
    failure : Failure
        The failure of the whole scan.

    Returns
    -------
    Check
        Failed, named after the stage; no value.
    """
    return Check(f"The {failure.stage} stage", "failed", None, failure.error, failure.message)


def rescan_check(failure: Failure) -> Check:
    """Report a signature without an error bar, because a part of the points has no signature.

    Parameters
    ----------
    failure : Failure
        The failure of a rescan.

    Returns
    -------
    Check
        "Signature", failed; no value.
    """
    return Check("Signature", "failed", None, "none for nine tenths of the points", failure.message)


def _sensor_check(cloud: PointCloud) -> Check:
    notes = [note for step in cloud.provenance if step.stage == "orient" for note in step.notes]
    guessed = cloud.viewpoints is None and any("leaked" in note for note in notes)
    return Check(
        "Outside",
        "look" if guessed else "passed",
        None,
        "sensor positions in the file"
        if cloud.viewpoints is not None
        else (notes or ["found by flood fill from outside"])[0],
        "The scan has holes and no sensor positions: save the positions with it."
        if guessed
        else "It is known which side is outside.",
    )


def _graded(name: str, value: float, limits: Limits, shown: str, *, passed: str, poor: str) -> Check:
    good, bad = limits
    verdict: Verdict = "passed" if value <= good else "look" if value <= bad else "failed"
    return Check(name, verdict, value, shown, passed if verdict == "passed" else poor)


def _counted(n: int, name: str) -> str:
    return f"{n} {name}" if n == 1 else f"{n} {name}s"


def _percent(share: float) -> str:
    """A fraction in percent with two significant digits; fractions below 1 are not rounded to 100 %."""
    if 0.995 < share < 1:
        return f"{math.floor(1000 * share) / 10:.1f} %"
    return f"{100 * share:.2g} %" if share < 0.995 else "100 %"
