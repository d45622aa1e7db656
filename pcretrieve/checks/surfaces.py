"""Checks of the surface of a scan, of its spectra, and of how well points and surface fit each other."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pcretrieve.checks.grading import Check, Limits, graded, percent
from pcretrieve.surface import defects
from pcretrieve.values import Shape, Step, TriangleMesh

# What scans of known quality have:, and the rows below it.
UNSUPPORTED: Limits = (0.01, 0.15)
LOST: Limits = (0.005, 0.05)
NOISE: Limits = (0.0025, 0.01)
ENDS: Limits = (0.005, 0.03)
GAPS: Limits = (0.008, 0.025)

# Log-signature error for each unit of these measurements; that of gaps is for their square, that of ends for
# what exceeds the ends that noise and small holes give.
ERROR_OF_FILLED = 2.0
ERROR_OF_LOST = 5.0
ERROR_OF_NOISE = 100.0
ERROR_OF_ENDS = 75.0
ENDS_OF_NOISE = 0.0015
ERROR_OF_GAPS = 2900.0

# Log-signature error of a base if the ground was not seen: what was cut off there may be legs.
ERROR_OF_BASE = 0.3

# Log-signature error of one cut or bridge; those of several are independent.
ERROR_OF_CUT = 0.15

# Log-signature error of a surface with holes, and of a mesh whose parts are welded.
ERROR_OF_HOLES = 0.3
ERROR_OF_WELDS = 0.3

# Number of welds whose errors are added, as independent ones. Where a mesh has more, most of them join
# neighbours and have no effect: the mesh is doubtful, and not unusable for that reason alone.
WELDS_OF_PARTS = 5

# Smallest ratio of the first two positive eigenvalues of one body.
NECK = 0.2
NECK_ERROR = 0.45

# Number of eigenvalues that are compared between surfaces, as many as the values of the paper's signature.
N_COMPARED = 23

DISAGREEMENT: Limits = (0.08, 0.4)

# Ratio of the deviation of this signature over surfaces to that of the eigenvalues.
ERROR_OF_DISAGREEMENT = 2.0


def surface_checks(mesh: TriangleMesh) -> list[Check]:
    """Check whether a surface is one closed manifold, and count its handles."""
    found = defects(mesh)
    closed = Check(
        "Closed surface",
        "look" if found else "passed",
        float(sum((found.boundary_edges, found.non_manifold_edges, found.inconsistent_edges))),
        str(found) if found else "no defects",
        "It has holes, or edges that no closed surface has: reconstruct it with surface.mode = 'reconstruct'."
        if found
        else "One closed, consistently oriented surface.",
        ERROR_OF_HOLES if found else 0.0,
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


def mesh_check(provenance: Sequence[Step]) -> list[Check]:
    """Check whether a mesh that was repaired, or sampled for reconstruction, was a manifold."""
    return [
        Check(
            "Welds",
            "look" if step.sizes["non_manifold"] else "passed",
            step.sizes["non_manifold"],
            _counted(int(step.sizes["non_manifold"]), "non-manifold vertex or edge"),
            "Parts of the body may be joined where they only touch: separate these vertices and edges."
            if step.sizes["non_manifold"]
            else "No vertex or edge joins parts of the mesh.",
            ERROR_OF_WELDS * math.sqrt(min(step.sizes["non_manifold"], WELDS_OF_PARTS)),
        )
        for step in provenance
        if "non_manifold" in step.sizes
    ]


def fit_checks(*, filled: float, ends: float, gaps: float, lost: float, noise: float) -> list[Check]:
    """Check how well points and surface fit each other."""
    return [
        graded(
            "Filled in",
            filled,
            UNSUPPORTED,
            f"{percent(filled)} of the surface",
            passed="Nearly all of the surface lies on points.",
            poor="The orange surface is interpolated, because there are no points: scan these places too.",
            error=ERROR_OF_FILLED * filled,
        ),
        graded(
            "Closed ends",
            ends,
            ENDS,
            f"{percent(ends)} of the surface",
            passed="The filled parts continue the surface around them.",
            poor="The surface was closed across a limb that ends in a hole: scan the part that is missing.",
            error=ERROR_OF_ENDS * max(0.0, ends - ENDS_OF_NOISE),
        ),
        graded(
            "Gaps",
            gaps,
            GAPS,
            f"95 % of the surface lie within {percent(gaps)} of the diagonal of a point",
            passed="Points are dense everywhere.",
            poor="Parts of the body have few points: scan these parts more densely, or from nearer.",
            error=ERROR_OF_GAPS * gaps**2,
        ),
        graded(
            "Left out",
            lost,
            LOST,
            f"{percent(lost)} of the points lie off the surface",
            passed="The surface passes by all points.",
            poor="A part of the body was cut off, or something else was scanned with it: compare the points "
            "with the surface.",
            error=ERROR_OF_LOST * lost,
        ),
        graded(
            "Noise",
            noise,
            NOISE,
            f"{percent(noise)} of the diagonal (rms)",
            passed="Points lie close to the surface.",
            poor="Points scatter about the surface: scan from nearer, hold still, or align the views better.",
            error=ERROR_OF_NOISE * noise,
        ),
    ]


def base_check(area: float, on_ground: bool) -> Check:
    """Check how much of the surface is the base on which the body stood, which no sensor sees."""
    return Check(
        "Closed base",
        "passed" if on_ground else "look",
        area,
        f"{percent(area)} of the surface",
        "The body stands on the ground that was scanned, and its base was closed there."
        if on_ground
        else "The side on which the body can stand was not seen, and was closed flat: scan the ground too, "
        "or merge views from below; if limbs were cut off there, scan them.",
        ERROR_OF_FILLED * area + (0.0 if on_ground else ERROR_OF_BASE),
    )


def marks_check(n_cuts: int, n_bridges: int) -> Check:
    """Check how often the topology of the surface was changed."""
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
        ERROR_OF_CUT * math.sqrt(n),
    )


def spectrum_checks(shape: Shape) -> list[Check]:
    """Check whether the surface is that of one body, and whether all surfaces of the scan agree."""
    logs = np.log([surface.spectrum.eigenvalues[1:] for surface in shape.surfaces if surface.spectrum])
    checks = []
    if logs.size and logs.shape[1] > 1:
        ratio = float(np.exp(logs[0, 0] - logs[0, 1]))
        narrow = ratio < NECK
        checks.append(
            Check(
                "One body",
                "look" if narrow else "passed",
                ratio,
                f"the first eigenvalue is {ratio:.2g} of the second",
                "A narrow neck joins two parts of one size, as where two bodies touch: give each body a file "
                "of its own."
                if narrow
                else "No narrow neck divides the surface into halves.",
                NECK_ERROR if narrow else 0.0,
            )
        )
    if len(logs) > 1:
        apart = float(np.linalg.norm(logs[:, :N_COMPARED].std(axis=0, ddof=1)))
        checks.append(
            graded(
                "Surfaces",
                apart,
                DISAGREEMENT,
                f"{apart:.2g} between the spectra of {len(logs)} surfaces",
                passed="The surfaces on grids of different voxels agree.",
                poor="The surface depends on the grid where parts touch or are thin: scan more densely, pose "
                "limbs apart, and repair a mesh that is welded.",
                error=ERROR_OF_DISAGREEMENT * apart,
            )
        )
    return checks


def _counted(n: int, name: str) -> str:
    """A number with its noun, such as "1 cut" and "2 cuts"."""
    return f"{n} {name}" if n == 1 else f"{n} {name}s"
