"""Questions that a scan is asked, each answered with a number and in plain words."""

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

#: Worst first.
VERDICTS: tuple[Verdict, ...] = ("failed", "look", "passed")

# What each check passes up to, and what it fails beyond. Measured on six bodies of TOSCA, each scanned
# densely, with noise of 0.5 % of the diagonal, by a rig of cameras, and with 3000 points; on the Stanford
# dragon, parts of which nobody saw; and on single views of the Stanford bunny.
Limits = tuple[float, float]
SPACING: Limits = (0.005, 0.015)  # 0.003 to 0.004 for the dense scans, 0.006 for 3000 points
STRAYS: Limits = (0.02, 0.15)  # 0.002 to 0.004 for the simulated scans, 0.04 for views of the bunny
DISAGREEING: Limits = (0.05, 0.25)  # 0.005 to 0.045; 0.12 to 0.16 with noise
UNBALANCED: Limits = (0.15, 0.25)  # up to 0.1; from 0.31 for single views
FILLED: Limits = (0.01, 0.15)  # up to 0.008; 0.1 for the dragon
LOST: Limits = (0.005, 0.05)  # up to 0.003; 0.02 to 0.06 where limbs were lost
NOISE: Limits = (0.0025, 0.01)  # 0.001 to 0.002; 0.005 with noise
SPREAD: Limits = (0.15, 0.5)  # 0.04 to 0.07 for the dense scans; 1.3 with noise


@dataclass(frozen=True, slots=True)
class Check:
    """One question that a scan was asked.

    Attributes
    ----------
    name : str
    verdict : "passed", "look" or "failed"
        In order; worth a look, as a signature may suffer; not to be trusted.
    value : float or None
        The number that the verdict goes by; None where there is none.
    shown : str
        That number with its unit, in words.
    words : str
        What it means or, where the check is not passed, what to do.
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
    """Of a cleaned cloud: whether it is dense enough, how much of it was strays, and who saw it.

    Parameters
    ----------
    cloud : PointCloud
    spacing : float
        Median distance from a point to its nearest neighbour; unit of the file.
    """
    share = spacing / cloud.diagonal
    cleaned = next(step.sizes for step in cloud.provenance if step.stage == "clean")
    strays = 1 - cleaned["points"] / cleaned["points_thinned"]
    return [
        _graded(
            "Points",
            share,
            SPACING,
            f"{len(cloud.points):,} points, {_percent(share)} of the diagonal apart",
            passed="Dense enough for limbs and fingers.",
            poor="Thin parts may be lost: scan more densely, or from nearer.",
        ),
        _graded(
            "Strays",
            strays,
            STRAYS,
            f"{_percent(strays)} dropped",
            passed="Single points that belong to nothing are gone.",
            poor="Look at the points in red: where they belong to the body, raise scan.outlier_std; "
            "else scan anew.",
        ),
        _sensor_check(cloud),
    ]


def normal_checks(normals: FloatArray, neighbors: NDArray[np.intp]) -> list[Check]:
    """Of the normals of a cloud: whether near ones agree, and whether they look to all sides.

    Parameters
    ----------
    normals : (n, 3) float64
    neighbors : (n, k) int
        Numbers of the points next to each.
    """
    cosines = np.einsum("ij,ikj->ik", normals, normals[neighbors])  # (n, k)
    disagreeing = float((cosines <= 0).mean())
    # The normals of a closed surface cancel out; those of half a sphere have a mean of 1/2.
    unbalanced = float(np.linalg.norm(normals.mean(axis=0)))
    return [
        _graded(
            "Normals",
            disagreeing,
            DISAGREEING,
            f"{_percent(1 - disagreeing)} of neighbours agree",
            passed="Neighbouring points agree on which side is outside.",
            poor="Patches are turned over, or the points are noisy: look at the orange patches, and keep the "
            "sensor positions when scanning.",
        ),
        _graded(
            "Sides seen",
            unbalanced,
            UNBALANCED,
            f"their normals are {_percent(unbalanced)} one-sided",
            passed="The points look to all sides alike.",
            poor="Most points look the same way, as those of a single view do: scan the other sides too, and "
            "merge the views.",
        ),
    ]


def surface_checks(mesh: TriangleMesh) -> list[Check]:
    """Of a surface: whether it is one closed manifold, and how many handles it has."""
    found = defects(mesh)
    closed = Check(
        "Closed surface",
        "look" if found else "passed",
        float(sum((found.boundary_edges, found.non_manifold_edges, found.inconsistent_edges))),
        str(found) if found else "no defects",
        "It has holes or edges that no body has: let it be reconstructed with surface.mode = 'reconstruct'."
        if found
        else "One piece, without holes, the inside on one side.",
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
            "Right for a ring or a mug. If the body has none, parts of it that touch have fused: pose it "
            "with limbs apart, or set surface.genus = 'sphere'."
            if handles
            else "Nothing that touches has fused into a ring.",
        ),
    ]


def fit_checks(*, filled: float, lost: float, noise: float) -> list[Check]:
    """How points and surface fit each other.

    Parameters
    ----------
    filled : float
        Surface without a point nearby; share of the area.
    lost : float
        Points without a surface nearby; share of them.
    noise : float
        Root mean square distance of all others to the surface; relative to the diagonal.
    """
    return [
        _graded(
            "Filled in",
            filled,
            FILLED,
            f"{_percent(filled)} of the surface",
            passed="Nearly all of the surface lies on points.",
            poor="The orange surface is a guess, for no point was seen there: scan those places too.",
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
    """How often the surface is not what the points say."""
    n = n_cuts + n_bridges
    return Check(
        "Cuts and bridges",
        "look" if n else "passed",
        float(n),
        f"{_counted(n_cuts, 'cut')}, {_counted(n_bridges, 'bridge')}",
        "Look at the rings: fused parts were cut apart there, or a loose part was joined; pose limbs apart, "
        "and scan what is between."
        if n
        else "Nothing had to be cut apart or joined.",
    )


def spread_check(spread: float) -> Check:
    """Whether the signature has a small error bar."""
    return _graded(
        "Signature",
        spread,
        SPREAD,
        f"± {spread:.2g} over rescans",
        passed="It hardly moves when a tenth of the points is left out.",
        poor="It changes when a tenth of the points is left out, and so does what is found by it: mend what "
        "the other checks say, and scan more than once.",
    )


def failure_check(failure: Failure) -> Check:
    """The stage that stopped."""
    return Check(f"The {failure.stage} stage", "failed", None, failure.error, failure.message)


def rescan_check(failure: Failure) -> Check:
    """A signature without an error bar, for part of the points has none."""
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
        else (notes or ["found by a flood from outside"])[0],
        "The scan has holes, and does not say where its sensors stood: save their positions with it."
        if guessed
        else "Which side is outside is no guess.",
    )


def _graded(name: str, value: float, limits: Limits, shown: str, *, passed: str, poor: str) -> Check:
    good, bad = limits
    verdict: Verdict = "passed" if value <= good else "look" if value <= bad else "failed"
    return Check(name, verdict, value, shown, passed if verdict == "passed" else poor)


def _counted(n: int, name: str) -> str:
    return f"{n} {name}" if n == 1 else f"{n} {name}s"


def _percent(share: float) -> str:
    """Two significant digits, and never 100 % for less."""
    if 0.995 < share < 1:
        return f"{math.floor(1000 * share) / 10:.1f} %"
    return f"{100 * share:.2g} %" if share < 0.995 else "100 %"
