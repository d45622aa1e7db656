"""One check of a scan: a measurement, its verdict by two limits, and advice; the verdict of all checks."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from pcretrieve.values import Verdict

Outcome = Literal["passed", "look", "failed"]

#: In descending order of severity.
OUTCOMES: tuple[Outcome, ...] = ("failed", "look", "passed")

#: Of a check, the largest value with which it is passed, and the largest with which it is not failed.
Limits = tuple[float, float]

# Largest uncertainty of a good scan: with a larger one, the signature may be that of another body. Within it
# the uncertainty does not tell which answers are wrong. See docs/decisions.md, incomplete.
GROSS = 1.0

# Checks that say that a part is missing or invented, or that there are two bodies, whatever the error.
GRAVE = ("Closed surface", "Welds", "Closed base", "One body")

# Largest share of the surface that closes ends where noise and small holes are, and no limb is missing.
ENDS_OF_NOISE = 0.0003

# Largest share of the surface where noise looks like layers.
LAYERS_OF_NOISE = 0.03

# Smallest part in the squared uncertainty of a check that is named as a reason.
REASON = 0.1


@dataclass(frozen=True, slots=True)
class Check:
    """One check of a scan.

    shown: the measurement with its unit, as text.
    """

    name: str
    verdict: Outcome
    value: float | None
    shown: str
    words: str
    error: float = 0.0


class Measure(NamedTuple):
    """What a check says if it is passed, and if it is not; and its limits, which scans of known quality have.

    Without limits, the check itself knows whether it is passed, and never fails.
    """

    limits: Limits | None
    passed: str
    poor: str


MEASURES = {
    "Points": Measure(
        (0.005, 0.015),
        "Dense enough for limbs and fingers.",
        "Thin parts may be lost: scan more densely, or from nearer.",
    ),
    "Outliers": Measure(
        (0.04, 0.15),
        "Single points off the surface were removed.",
        "Look at the points in red: if they belong to the body, raise scan.outlier_std; else scan again.",
    ),
    "Outside": Measure(
        None,
        "It is known which side is outside.",
        "The scan has holes and no sensor positions: save the positions with it.",
    ),
    "Normals": Measure(
        (0.05, 0.25),
        "Neighbouring points agree on which side is outside.",
        "Normals of some patches point inwards, or the points are noisy: look at the orange patches, and "
        "keep the sensor positions when scanning.",
    ),
    "Sides seen": Measure(
        (0.15, 0.25),
        "The normals point to all sides.",
        "Most normals point the same way, as in a single view: scan the other sides too, and merge the "
        "views.",
    ),
    "Closed surface": Measure(
        None,
        "One closed, consistently oriented surface.",
        "It has holes, or edges that no closed surface has: reconstruct it with surface.mode = "
        "'reconstruct'.",
    ),
    "Handles": Measure(
        None,
        "No parts that touch have fused into a ring.",
        "Right for a ring or a mug. If the body has no handle, parts that touch have fused: pose it with "
        "limbs apart, or set surface.genus = 'sphere'.",
    ),
    "Welds": Measure(
        None,
        "No vertex or edge joins parts of the mesh.",
        "Parts of the body may be joined where they only touch: separate these vertices and edges.",
    ),
    "Double walls": Measure(
        (LAYERS_OF_NOISE, 0.12),
        "The points lie in one layer.",
        "Views are shifted against each other, or the body moved, so that limbs are too thick: register the "
        "views again by 'pcretrieve merge', which names the ones that stand off.",
    ),
    "Filled in": Measure(
        (0.01, 0.15),
        "Nearly all of the surface lies on points.",
        "The orange surface is interpolated, because there are no points: scan these places too.",
    ),
    "Closed ends": Measure(
        (ENDS_OF_NOISE, ENDS_OF_NOISE),
        "Points lie on the ends of the limbs.",
        "The surface was closed across a limb that ends in a hole: scan the part that is missing.",
    ),
    "Gaps": Measure(
        (0.008, 0.025),
        "Points are dense everywhere.",
        "Parts of the body have few points: scan these parts more densely, or from nearer.",
    ),
    "Largest hole": Measure(
        (0.0025, 0.0025),
        "Points lie wherever a sensor could see the surface.",
        "A part of the body that nothing hides was not seen: scan it too, and merge the views.",
    ),
    "Left out": Measure(
        (0.005, 0.05),
        "The surface passes by all points.",
        "A part of the body was cut off, or something else was scanned with it: compare the points with the "
        "surface.",
    ),
    "Noise": Measure(
        (0.0025, 0.01),
        "Points lie close to the surface.",
        "Points scatter about the surface: scan from nearer, hold still, or align the views better.",
    ),
    "Closed base": Measure(
        None,
        "The body stands on the ground that was scanned, and its base was closed there.",
        "The side on which the body can stand was not seen, and was closed flat: scan the ground too, or "
        "merge views from below; if limbs were cut off there, scan them.",
    ),
    "Cuts and bridges": Measure(
        None,
        "No parts had to be separated or connected.",
        "Look at the rings: parts that touch were separated there, or a loose part was connected; pose limbs "
        "apart, and scan between them.",
    ),
    "One body": Measure(
        None,
        "No narrow neck divides the surface into halves.",
        "A narrow neck joins two parts of one size, as where two bodies touch: give each body a file of its "
        "own.",
    ),
    "Surfaces": Measure(
        (0.08, 0.4),
        "The surfaces on grids of different voxels agree.",
        "The surface depends on the grid where parts touch or are thin: scan more densely, pose limbs apart, "
        "and repair a mesh that is welded.",
    ),
    "Signature": Measure(
        (0.15, 0.5),
        "It hardly changes when a tenth of the points is left out.",
        "It changes when a tenth of the points is left out, and so do its nearest neighbours: correct what "
        "the other checks name, and scan more than once.",
    ),
}


def graded(
    name: str, value: float | None, shown: str, *, is_good: bool = False, error: float = 0.0
) -> Check:
    """The check of a measurement, which is `shown` with its unit; `is_good` counts if there are no limits."""
    limits, passed, poor = MEASURES[name]
    verdict: Outcome
    if limits is None or value is None:
        verdict = "passed" if is_good else "look"
    else:
        verdict = OUTCOMES[-1 - bisect_left(limits, value)]
    return Check(name, verdict, value, shown, passed if verdict == "passed" else poor, error)


def percent(share: float) -> str:
    """A fraction in percent with two significant digits; fractions below 1 are not rounded to 100 %."""
    if 0.995 < share < 1:
        return f"{math.floor(1000 * share) / 10:.1f} %"
    return f"{100 * share:.2g} %" if share < 0.995 else "100 %"


def verdict_of(checks: Sequence[Check], *, spread: float | None = None) -> Verdict:
    """The verdict on a shape.

    The errors of the checks are assumed to be independent, so that the uncertainty is the root of the sum of
    their squares, or the spread if that is larger.
    """
    squared = float(sum(check.error**2 for check in checks))
    uncertainty = max(float(np.sqrt(squared)), spread or 0.0)
    failed = [
        one
        for one in checks
        if one.verdict == "failed" or (one.name in GRAVE and one.verdict == "look")
    ]
    if not failed and uncertainty <= GROSS:
        return Verdict("good", uncertainty)
    grave = [
        check for check in checks if check in failed or check.error**2 > REASON * uncertainty**2
    ]
    grave.sort(key=lambda check: (check not in failed, -check.error))
    reasons = [f"{check.name.lower()}: {check.shown}" for check in grave]
    if spread and spread**2 > squared and all(check.name != "Signature" for check in failed):
        reasons.append(f"rescans: ± {spread:.2g}")
    return Verdict("incomplete", uncertainty, tuple(reasons))
