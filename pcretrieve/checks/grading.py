"""One check of a scan: a measurement, its outcome by two limits, and advice; the grade of the scan by all."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from pcretrieve.values import FloatArray, Grade

Outcome = Literal["passed", "look", "failed"]

#: In descending order of severity.
OUTCOMES: tuple[Outcome, ...] = ("failed", "look", "passed")

#: What a scan is called if a check fails; nothing if the check only states a fact.
CheckGrade = Literal["", "poor", "incomplete"]

#: Of a check, the largest value with which it is passed, and the largest with which it is not failed.
Limits = tuple[float, float]

# Largest expected error of a scan that is not poor. See docs/decisions.md, grades.
LARGEST_ERROR = 1.0

# Largest size of closed ends where noise and small holes are, and no limb is missing; and the same of a
# person whose form is that of one with all limbs.
ENDS_OF_NOISE = 0.0055
ENDS_OF_WHOLE = 0.0115

# Largest share of the surface where noise looks like layers.
LAYERS_OF_NOISE = 0.03

# Radius of a hole, relative to the length of the body, that a person would see: 6 cm of a standing person.
LARGE_HOLE = 0.034

# Ratio of spacings, over the surface, of which a part was scanned that has hardly any points elsewhere.
UNEVEN = 2.3

# Logarithm of a ratio of likelihoods, from which the form of a person is that of one without a limb, and
# below the opposite of which it is that of one with all limbs. See docs/decisions.md, limbs by the form.
LIMBLESS = 3.0

# Smallest part in the squared error of a check that is named as a reason.
REASON = 0.2


@dataclass(frozen=True, slots=True)
class Check:
    """One check of a scan.

    shown: the measurement with its unit, as text.
    words: what it means, or what to do.
    error: the log-signature error that is expected from it; dimensionless.
    grade: what the scan is called because of it.
    says: what is wrong, in words of consequence, if it is named as a reason; a passed check can be, by its
        error. Empty for a check that has none.
    places: where on the scan, unit of the file.
    parts: of a person, on which these places are; empty if they are not known.
    """

    name: str
    outcome: Outcome
    value: float | None
    shown: str
    words: str
    error: float = 0.0
    grade: CheckGrade = ""
    says: str = ""
    places: tuple[tuple[float, float, float], ...] = ()
    parts: tuple[str, ...] = ()


class Measure(NamedTuple):
    """Texts and limits of a check; the limits were set on scans of known quality.

    limits: without them, the check itself knows whether it is passed, and never fails.
    passed, poor: what it means if the check is passed, and what to do if it is not.
    says: what is wrong.
    grade: what a scan is called that exceeds the larger limit, or is not passed without limits.
    """

    limits: Limits | None
    passed: str
    poor: str
    says: str
    grade: CheckGrade = ""


MEASURES = {
    "Points": Measure(
        (0.005, 0.015),
        "Dense enough for limbs and fingers.",
        "Thin parts may be lost: scan more densely, or from nearer.",
        "the points are too far apart for thin parts",
        "poor",
    ),
    "Outliers": Measure(
        (0.04, 0.15),
        "Single points off the surface were removed.",
        "Look at the points in red: if they belong to the body, raise scan.outlier_std; else scan again.",
        "many points are off the surface",
    ),
    "Outside": Measure(
        None,
        "It is known which side is outside.",
        "The scan has holes and no sensor positions: save the positions with it.",
        "it was guessed which side is outside",
    ),
    "Normals": Measure(
        (0.05, 0.25),
        "Neighbouring points agree on which side is outside.",
        "Normals of some patches point inwards, or the points are noisy: look at the orange patches, and "
        "keep the sensor positions when scanning.",
        "neighbouring points disagree on which side is outside",
        "poor",
    ),
    "Evenness": Measure(
        (UNEVEN, UNEVEN),
        "All sides were scanned with a similar density.",
        "Some sides have hardly any points: scan them too, from as near as the others.",
        "some sides have hardly any points",
        "incomplete",
    ),
    "Sides seen": Measure(
        (0.15, 0.25),
        "The normals point to all sides.",
        "Most normals point the same way, as in a single view: scan the other sides too, and merge the "
        "views.",
        "only one side was seen",
        "incomplete",
    ),
    "Closed surface": Measure(
        None,
        "One closed, consistently oriented surface.",
        "It has holes, or edges that no closed surface has: reconstruct it with surface.mode = "
        "'reconstruct'.",
        "the mesh has holes",
        "incomplete",
    ),
    "Handles": Measure(
        None,
        "No parts that touch have fused into a ring.",
        "Right for a ring or a mug. If the body has no handle, parts that touch have fused: pose it with "
        "limbs apart, or set surface.genus = 'sphere'.",
        "parts that touch may have fused",
    ),
    "Welds": Measure(
        None,
        "No vertex or edge joins parts of the mesh.",
        "Parts of the body may be joined where they only touch: separate these vertices and edges.",
        "parts of the mesh are welded",
    ),
    "Double walls": Measure(
        (LAYERS_OF_NOISE, 0.12),
        "The points lie in one layer.",
        "Views are shifted against each other, or the body moved, so that limbs are too thick: register the "
        "views again by 'pcretrieve merge', which names the ones that stand off.",
        "views were registered badly, so that walls are double",
        "poor",
    ),
    "Filled in": Measure(
        (0.01, 0.15),
        "Nearly all of the surface lies on points.",
        "The orange surface is interpolated, because there are no points: scan these places too.",
        "much of the surface has no points",
        "incomplete",
    ),
    "Closed ends": Measure(
        (ENDS_OF_NOISE, ENDS_OF_NOISE),
        "Points lie on the ends of the limbs.",
        "The surface was closed across a limb that ends in a hole: scan the part that is missing.",
        "the end of a limb is missing",
        "incomplete",
    ),
    "Gaps": Measure(
        (0.008, 0.025),
        "Points are dense everywhere.",
        "Parts of the body have few points: scan these parts more densely, or from nearer.",
        "parts of the body have few points",
    ),
    "Largest hole": Measure(
        (LARGE_HOLE, LARGE_HOLE),
        "Points lie wherever a sensor could see the surface.",
        "A part of the body that nothing hides was not seen: scan it too, and merge the views.",
        "there is a hole that shows",
        "incomplete",
    ),
    "Left out": Measure(
        (0.005, 0.05),
        "The surface passes by all points.",
        "A part of the body was cut off, or something else was scanned with it: compare the points with the "
        "surface.",
        "points lie off the surface",
        "poor",
    ),
    "Noise": Measure(
        (0.0025, 0.01),
        "Points lie close to the surface.",
        "Points scatter about the surface: scan from nearer, hold still, or align the views better.",
        "the points scatter about the surface",
        "poor",
    ),
    "Closed base": Measure(
        None,
        "The body stands on the ground that was scanned, and its base was closed there.",
        "The side on which the body can stand was not seen, and was closed flat: scan the ground too, or "
        "merge views from below; if limbs were cut off there, scan them.",
        "the side on which it stands was not seen",
    ),
    "Cuts and bridges": Measure(
        None,
        "No parts had to be separated or connected.",
        "Look at the rings: parts that touch were separated there, or a loose part was connected; pose limbs "
        "apart, and scan between them.",
        "parts that touch were separated, or loose parts connected",
    ),
    "One body": Measure(
        None,
        "No crease divides the surface into two bodies.",
        "A short crease runs between two parts of similar size, as where two bodies touch: give each body a "
        "file of its own.",
        "two bodies touch",
        "poor",
    ),
    "Limbs": Measure(
        (LIMBLESS, LIMBLESS),
        "The form is that of a person with all limbs.",
        "The form is more like that of people of whom the end of a limb, or the head, was not scanned: scan "
        "what is missing, or pose limbs apart, if one is grown together with another part.",
        "by the form, the end of a limb, or the head, is missing",
        "incomplete",
    ),
    "Surfaces": Measure(
        (0.08, 0.4),
        "The surfaces on grids of different voxels agree.",
        "The surface depends on the grid where parts touch or are thin: scan more densely, pose limbs apart, "
        "and repair a mesh that is welded.",
        "the surface is uncertain where parts touch or are thin",
        "poor",
    ),
    "Signature": Measure(
        (0.15, 0.5),
        "It hardly changes when a tenth of the points is left out.",
        "It changes when a tenth of the points is left out, and so do its nearest neighbours: correct what "
        "the other checks name, and scan more than once.",
        "the signature changes when a tenth of the points is left out",
        "poor",
    ),
}


def graded(
    name: str,
    value: float | None,
    shown: str,
    *,
    is_good: bool = False,
    error: float = 0.0,
    places: Sequence[FloatArray] = (),
) -> Check:
    """The check of a measurement, which is `shown` with its unit.

    is_good: counts if there are no limits.
    """
    measure = MEASURES[name]
    outcome: Outcome
    if measure.limits is None or value is None:
        outcome = "passed" if is_good else "look"
        is_over = not is_good
    else:
        outcome = OUTCOMES[-1 - bisect_left(measure.limits, value)]
        is_over = outcome == "failed"
    if outcome == "passed":
        return Check(
            name, outcome, value, shown, measure.passed, error, says=measure.says
        )
    where = tuple((float(x), float(y), float(z)) for x, y, z in places)
    grade = measure.grade if is_over else ""
    return Check(
        name, outcome, value, shown, measure.poor, error, grade, measure.says, where
    )


def percent(share: float) -> str:
    """A fraction in percent with two significant digits; fractions below 1 are not rounded to 100 %."""
    if 0.995 < share < 1:
        return f"{math.floor(1000 * share) / 10:.1f} %"
    return f"{100 * share:.2g} %" if share < 0.995 else "100 %"


def grade_of(checks: Sequence[Check], *, rescan_error: float | None = None) -> Grade:
    """The grade of a scan.

    It is incomplete if a part is missing that a person would see missing, and poor if a check says so or if
    the expected error is so large that the nearest shape may be another one. The errors of the checks are
    assumed to be independent, so that the expected error is the root of the sum of their squares, or the
    error of rescans if that is larger; then the check of rescans, "Signature", is one of the checks.
    """
    squared = float(sum(check.error**2 for check in checks))
    error = max(float(np.sqrt(squared)), rescan_error or 0.0)
    missing = [check for check in checks if check.grade == "incomplete"]
    poor = [check for check in checks if check.grade == "poor"]
    if error > LARGEST_ERROR:
        large = [check for check in checks if check.error**2 > REASON * error**2]
        large.sort(key=lambda check: -check.error)
        poor += [check for check in large if check not in poor and check not in missing]
    if not missing and not poor and error <= LARGEST_ERROR:
        return Grade("good", error)
    reasons = tuple(_reason(check) for check in (*missing, *poor))
    return Grade("incomplete" if missing else "poor", error, reasons)


def _reason(check: Check) -> str:
    """What is wrong, and where."""
    if not check.places:
        return check.says
    if check.parts:
        return f"{check.says}, on {' and '.join(check.parts)}"
    x, y, z = check.places[0]
    more = (
        f", and at {len(check.places) - 1} more places" if len(check.places) > 1 else ""
    )
    return f"{check.says}, near ({x:.3g}, {y:.3g}, {z:.3g}){more}"
