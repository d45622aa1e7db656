"""Checks of the filtered points of a scan and of their normals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcretrieve.checks.grading import Check, Limits, graded, percent
from pcretrieve.values import FloatArray, PointCloud

# What scans of known quality have:, and the rows below it.
SPACING: Limits = (0.005, 0.015)
OUTLIERS: Limits = (0.04, 0.15)
DISAGREEING: Limits = (0.05, 0.25)
UNBALANCED: Limits = (0.15, 0.25)


def point_checks(cloud: PointCloud, *, spacing: float) -> list[Check]:
    """Check the density of a filtered cloud, what was removed of it, and how its outside was found.

    spacing: median distance from a point to its nearest neighbour; unit of the file.
    """
    share = spacing / cloud.diagonal
    cleanings = [step.sizes for step in cloud.provenance if step.stage == "clean"]
    n_kept = int(cleanings[-1]["points_in"] - cleanings[-1]["outliers"]) if cleanings else len(cloud.points)
    averaged = "" if n_kept == len(cloud.points) else f", averaged to {len(cloud.points):,}"
    checks = [
        graded(
            "Points",
            share,
            SPACING,
            f"{n_kept:,} points{averaged}, {percent(share)} of the diagonal apart",
            passed="Dense enough for limbs and fingers.",
            poor="Thin parts may be lost: scan more densely, or from nearer.",
        )
    ]
    for cropped in [step for step in cloud.provenance if step.stage == "crop" and step.notes]:
        n_in, n_cut = cropped.sizes["points_in"], cropped.sizes["points_in"] - cropped.sizes["points"]
        shown = f"{n_cut:,.0f} of {n_in:,.0f} points cut away, {percent(n_cut / n_in)}"
        removed = f"{'; '.join(cropped.notes)}."
        checks.append(Check("Background", "passed", n_cut / n_in, shown, removed))
    for cleaned in cleanings:
        outliers = 1 - cleaned["points"] / cleaned["points_thinned"]
        checks.append(
            graded(
                "Outliers",
                outliers,
                OUTLIERS,
                f"{cleaned['outliers']:,.0f} of {cleaned['points_in']:,.0f} points dropped, "
                f"{percent(outliers)} of the voxels",
                passed="Single points off the surface were removed.",
                poor="Look at the points in red: if they belong to the body, raise scan.outlier_std; "
                "else scan again.",
            )
        )
    return [*checks, _sensor_check(cloud)]


def normal_checks(normals: FloatArray, some: FloatArray, neighbors: NDArray[np.intp]) -> list[Check]:
    """Check the consistency of the normals of a cloud, and whether they point to all sides.

    normals: (n, 3) float64, unit normals.
    some: (m, 3) float64, normals of the points that are compared with their neighbours.
    neighbors: (m, k) int, indices of the nearest neighbours of these points.
    Returns list of Check: "Normals": fraction of pairs of neighbours whose normals are more than 90 degrees
        apart. "Sides seen": length of the mean normal.
    """
    cosines = np.einsum("ij,ikj->ik", some, normals[neighbors])  # (m, k)
    disagreeing = float((cosines <= 0).mean())
    # The mean normal of a closed surface is 0; the mean normal of half a sphere has the length 1/2.
    unbalanced = float(np.linalg.norm(normals.mean(axis=0)))
    return [
        graded(
            "Normals",
            disagreeing,
            DISAGREEING,
            f"{percent(1 - disagreeing)} of neighbours agree",
            passed="Neighbouring points agree on which side is outside.",
            poor="Normals of some patches point inwards, or the points are noisy: look at the orange "
            "patches, and keep the sensor positions when scanning.",
        ),
        graded(
            "Sides seen",
            unbalanced,
            UNBALANCED,
            f"their normals are {percent(unbalanced)} one-sided",
            passed="The normals point to all sides.",
            poor="Most normals point the same way, as in a single view: scan the other sides too, and merge "
            "the views.",
        ),
    ]


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
