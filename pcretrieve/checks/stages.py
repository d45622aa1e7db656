"""Checks of the points of a scan, of its surface, of its spectra, and of how well points and surface fit."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pcretrieve.checks.grading import ENDS_OF_NOISE, LAYERS_OF_NOISE, Check, graded, percent
from pcretrieve.points.layers import Layers
from pcretrieve.surface import defects
from pcretrieve.values import FloatArray, PointCloud, Shape, Step, TriangleMesh

# Log-signature error for each unit of these measurements; that of gaps is for their square, that of ends for
# what exceeds `ENDS_OF_NOISE`.
ERROR_OF_FILLED = 2.0
ERROR_OF_LOST = 5.0
ERROR_OF_NOISE = 100.0
ERROR_OF_LAYERS = 40.0
ERROR_OF_ENDS = 200.0
ERROR_OF_GAPS = 2900.0

# Log-signature error of a base if the ground was not seen: a limb may end there, unless it is a mere sole.
ERROR_OF_BASE = 0.3
LEAST_BASE = 0.0015

# Log-signature error of one cut or bridge; those of several are independent.
ERROR_OF_CUT = 0.15

# Log-signature error of a surface with holes, and of a mesh whose parts are welded.
ERROR_OF_HOLES = 0.3
ERROR_OF_WELDS = 0.3

# Number of welds whose errors are added, as independent ones. Where a mesh has more, most of them join
# neighbours and have no effect: the mesh is not incomplete for that reason alone.
WELDS_OF_PARTS = 5

# Least length of the shortest level line of the first eigenfunction round one body, relative to the root of
# the area on its smaller side. People who sit bent forward have .49 and more, TOSCA's animals .71.
LEAST_NECK = 0.43
NECK_ERROR = 0.45

# Quantiles of the first eigenfunction at which level lines are drawn.
LEVELS = np.linspace(0.1, 0.9, 25)

# Number of eigenvalues that are compared between surfaces, as many as the values of the paper's signature.
N_COMPARED = 23

# Ratio of the deviation of this signature over surfaces to that of the eigenvalues.
ERROR_OF_DISAGREEMENT = 2.0


# --- points -------------------------------------------------------------------------------------------


def point_checks(cloud: PointCloud, *, spacing: float) -> list[Check]:
    """Check the density of a filtered cloud, what was removed of it, and how its outside was found.

    spacing: median distance from a point to its nearest neighbour; unit of the file.
    """
    share = spacing / cloud.diagonal
    cleanings = [step.sizes for step in cloud.provenance if step.stage == "clean"]
    n_kept = (
        int(cleanings[-1]["points_in"] - cleanings[-1]["outliers"])
        if cleanings
        else len(cloud.points)
    )
    averaged = "" if n_kept == len(cloud.points) else f", averaged to {len(cloud.points):,}"
    shown = f"{n_kept:,} points{averaged}, {percent(share)} of the diagonal apart"
    checks = [graded("Points", share, shown)]
    for cropped in [step for step in cloud.provenance if step.stage == "crop" and step.notes]:
        n_in, n_cut = (
            cropped.sizes["points_in"],
            cropped.sizes["points_in"] - cropped.sizes["points"],
        )
        shown = f"{n_cut:,.0f} of {n_in:,.0f} points cut away, {percent(n_cut / n_in)}"
        checks.append(
            Check("Background", "passed", n_cut / n_in, shown, f"{'; '.join(cropped.notes)}.")
        )
    for cleaned in cleanings:
        outliers = 1 - cleaned["points"] / cleaned["points_thinned"]
        dropped = f"{cleaned['outliers']:,.0f} of {cleaned['points_in']:,.0f} points dropped"
        checks.append(graded("Outliers", outliers, f"{dropped}, {percent(outliers)} of the voxels"))
    return [*checks, _sensor_check(cloud)]


def normal_checks(
    normals: FloatArray, some: FloatArray, neighbors: NDArray[np.intp]
) -> list[Check]:
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
        graded("Normals", disagreeing, f"{percent(1 - disagreeing)} of neighbours agree"),
        graded("Sides seen", unbalanced, f"their normals are {percent(unbalanced)} one-sided"),
    ]


def layers_check(layers: Layers, diagonal: float) -> Check:
    """Check how much of the surface has several layers of points, and how far apart they are."""
    apart = layers.apart[layers.apart > 0] / diagonal
    share = len(apart) / len(layers.apart)
    if share <= LAYERS_OF_NOISE:
        return graded("Double walls", share, "one layer")
    width = float(apart.mean())
    shown = (
        f"layers {width * diagonal:.2g} apart, {percent(width)} of the diagonal, along "
        f"{percent(share)} of the surface"
    )
    return graded("Double walls", share, shown, error=ERROR_OF_LAYERS * width)


def _sensor_check(cloud: PointCloud) -> Check:
    notes = [note for step in cloud.provenance if step.stage == "orient" for note in step.notes]
    is_known = cloud.viewpoints is not None
    guessed = not is_known and any("leaked" in note for note in notes)
    shown = (
        "sensor positions in the file"
        if is_known
        else (notes or ["found by flood fill from outside"])[0]
    )
    return graded("Outside", None, shown, is_good=not guessed)


# --- surfaces -----------------------------------------------------------------------------------------


def surface_checks(mesh: TriangleMesh) -> list[Check]:
    """Check whether a surface is one closed manifold, and count its handles."""
    found = defects(mesh)
    n_edges = float(found.boundary_edges + found.non_manifold_edges + found.inconsistent_edges)
    shown = str(found) if found else "no defects"
    error = ERROR_OF_HOLES if found else 0.0
    closed = graded("Closed surface", n_edges, shown, is_good=not found, error=error)
    if found:
        return [closed]
    handles = 1 - mesh.euler_characteristic // 2
    shown = f"{_counted(handles, 'handle')}, Euler characteristic {mesh.euler_characteristic}"
    return [closed, graded("Handles", float(handles), shown, is_good=not handles)]


def mesh_check(provenance: Sequence[Step]) -> list[Check]:
    """Check whether a mesh that was repaired, or sampled for reconstruction, was a manifold."""
    welds = [step.sizes["non_manifold"] for step in provenance if "non_manifold" in step.sizes]
    return [
        graded(
            "Welds",
            n,
            _counted(int(n), "non-manifold vertex or edge"),
            is_good=not n,
            error=ERROR_OF_WELDS * math.sqrt(min(n, WELDS_OF_PARTS)),
        )
        for n in welds
    ]


def fit_checks(
    *, filled: float, ends: float, gaps: float, hole: float, lost: float, noise: float
) -> list[Check]:
    """Check how well points and surface fit each other."""
    near = f"95 % of the surface lie within {percent(gaps)} of the diagonal of a point"
    beyond_noise = max(0.0, ends - ENDS_OF_NOISE)
    off = f"{percent(lost)} of the points lie off the surface"
    return [
        graded(
            "Filled in", filled, f"{percent(filled)} of the surface", error=ERROR_OF_FILLED * filled
        ),
        graded(
            "Closed ends",
            ends,
            f"{percent(ends)} of the surface",
            error=ERROR_OF_ENDS * beyond_noise,
        ),
        graded("Gaps", gaps, near, error=ERROR_OF_GAPS * gaps**2),
        graded("Largest hole", hole, f"{percent(hole)} of the surface"),
        graded("Left out", lost, off, error=ERROR_OF_LOST * lost),
        graded(
            "Noise", noise, f"{percent(noise)} of the diagonal (rms)", error=ERROR_OF_NOISE * noise
        ),
    ]


def base_check(area: float, on_ground: bool) -> Check:
    """Check how much of the surface is the base on which the body stood, which no sensor sees."""
    is_good = on_ground or area < LEAST_BASE
    error = ERROR_OF_FILLED * area + (0.0 if is_good else ERROR_OF_BASE)
    return graded(
        "Closed base", area, f"{percent(area)} of the surface", is_good=is_good, error=error
    )


def marks_check(n_cuts: int, n_bridges: int) -> Check:
    """Check how often the topology of the surface was changed."""
    n = n_cuts + n_bridges
    shown = f"{_counted(n_cuts, 'cut')}, {_counted(n_bridges, 'bridge')}"
    return graded(
        "Cuts and bridges", float(n), shown, is_good=not n, error=ERROR_OF_CUT * math.sqrt(n)
    )


def spectrum_checks(shape: Shape) -> list[Check]:
    """Check whether the surface is that of one body, and whether all surfaces of the scan agree."""
    logs = np.log(
        [surface.spectrum.eigenvalues[1:] for surface in shape.surfaces if surface.spectrum]
    )
    checks = []
    for surface in shape.surfaces[:1]:
        if surface.mesh is None or surface.eigenpairs is None:
            continue
        vectors = surface.eigenpairs.eigenvectors[: len(surface.mesh.vertices)]
        waist = neck(surface.mesh, vectors[:, 1])
        is_narrow = waist < LEAST_NECK
        shown = f"the neck between its halves is {waist:.2g} of the root of the smaller one's area"
        error = NECK_ERROR if is_narrow else 0.0
        checks.append(graded("One body", waist, shown, is_good=not is_narrow, error=error))
    if len(logs) > 1:
        apart = float(np.linalg.norm(logs[:, :N_COMPARED].std(axis=0, ddof=1)))
        shown = f"{apart:.2g} between the spectra of {len(logs)} surfaces"
        checks.append(graded("Surfaces", apart, shown, error=ERROR_OF_DISAGREEMENT * apart))
    return checks


def neck(mesh: TriangleMesh, function: FloatArray) -> float:
    """The shortest level line of a function, relative to the root of the area on its smaller side.

    Of the first eigenfunction of the Laplace-Beltrami operator, level lines run round the body, across its
    longest extent; the shortest is an estimate of the Cheeger constant [1]_. A rod has a long one in relation
    to the root of its area, two balls that touch a short one.

    function: (n,) float64, one value at each vertex.

    References
    ----------
    .. [1] J. Cheeger, "A lower bound for the smallest eigenvalue of the Laplacian", Problems in Analysis,
       1970.
    """
    corners = function[mesh.faces]  # (m, 3)
    areas, middles = mesh.face_areas, corners.mean(axis=1)
    total = areas.sum()
    narrowest = np.inf
    for level in np.quantile(function, LEVELS):
        above = corners > level
        crossed = above.any(axis=1) & ~above.all(axis=1)
        faces, values, is_above = mesh.faces[crossed], corners[crossed], above[crossed]
        # One corner is on a side of its own; the line crosses both edges that meet there.
        alone = np.where(
            is_above.sum(axis=1) == 1, is_above.argmax(axis=1), is_above.argmin(axis=1)
        )
        row = np.arange(len(faces))
        start, at_start = mesh.vertices[faces[row, alone]], values[row, alone]
        ends = []
        for step in (1, 2):
            other = (alone + step) % 3
            share = (level - at_start) / (values[row, other] - at_start)
            ends.append(start + share[:, np.newaxis] * (mesh.vertices[faces[row, other]] - start))
        length = np.linalg.norm(ends[1] - ends[0], axis=1).sum()
        upper = areas[middles > level].sum()
        smaller = min(upper, total - upper)
        if smaller > 0:
            narrowest = min(narrowest, float(length / np.sqrt(smaller)))
    return narrowest


def _counted(n: int, name: str) -> str:
    """A number with its noun, such as "1 cut" and "2 cuts"."""
    return f"{n} {name}" if n == 1 else f"{n} {name}s"
