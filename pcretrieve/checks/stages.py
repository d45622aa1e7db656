"""Checks of the points of a scan, of its surface, of its spectra, and of how well points and surface fit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import vertex_normals
from pcretrieve.checks.fit import FILLED, Fit, Hole
from pcretrieve.checks.grading import (
    ENDS_OF_NOISE,
    LARGE_HOLE,
    LAYERS_OF_NOISE,
    Check,
    graded,
    percent,
)
from pcretrieve.checks.layers import Layers
from pcretrieve.points.neighbors import nearest
from pcretrieve.values import (
    FloatArray,
    Mask,
    PointCloud,
    Shape,
    Step,
    TriangleMesh,
    unit_vectors,
)
from pcretrieve.values.geometry import adjacency
from pcretrieve.values.simplify import simplified
from pcretrieve.values.topology import defects

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Log-signature error for each unit of these measurements; that of gaps is for their square, that of ends for
# what exceeds `ENDS_OF_NOISE`. They were fitted to scans of all kinds of bodies by four sensors.
ERROR_OF_FILLED = 0.4
ERROR_OF_LOST = 20.0
ERROR_OF_NOISE = 20.0
ERROR_OF_LAYERS = 40.0
ERROR_OF_ENDS = 22.0
ERROR_OF_GAPS = 600.0

# Log-signature error of one cut or bridge; those of several are independent.
ERROR_OF_CUT = 0.15

# Log-signature error of a surface with holes, and of a mesh with welds: of one that joins a foot and a head.
# Where a mesh has many, most of them join neighbours and have no effect.
ERROR_OF_HOLES = 0.3
ERROR_OF_WELDS = 0.85

# Largest length of a level line where two bodies touch, relative to the root of the area on its smaller side:
# of a line that is nowhere in a crease, and of one that is so all round. It is .4 along the shaft of a femur,
# nowhere in a crease; .82 round the waist of somebody who sits, partly in one.
NECK = 0.4
CREASED_NECK = 1.3

# Where two bodies touch, level lines nearby, on both sides, are longer by the first factor: along a rod, and
# on the one side of a flange or of a thick end, they are not. If less than this share of the line lies in a
# crease, they are longer by the second one. See docs/decisions.md, neck.
LEAST_SHARPNESS = 1.15
LEAST_CREASED = 0.2
SHARP = 1.5
NECK_ERROR = 0.45

# Share of the area within which a rod or a cylinder goes on beside a level line.
ALONG = 0.03

# A rod between two thick ends has a crease at each: beside a level line in one of them are lines outside of
# creases that are hardly longer. Where two bodies touch, there is one crease.
OUTSIDE = 0.1
HARDLY_LONGER = 1.1

# Turned parts have creases, too, as a shaft at its flange, but these are circles: 4π times the area of their
# opening is at least the first share of their squared length (isoperimetric inequality). On one side of a
# circle nearby a cylinder goes on: the openings there differ by less than the second share of the area.
CIRCULAR = 0.95
STRAIGHT = 0.001

# A level line that may part two bodies has half of the area, within this share, on each side, and lines
# nearby at least this share.
FROM_HALF = 0.3
LEAST_SIDE = 0.15

# Number of level lines at equal steps of the area on one side, and of the function: the first pass over both
# bodies, the others lie in the creases.
N_LEVELS = 71

# Largest share of the area between level lines nearby.
NEARBY = 0.055

# An edge is weaker by 1 plus this, times the angle by which the normals at its ends lean towards each other.
WEAKNESS = 150.0

# Mean of these angles, round a vertex, from which it is in a crease; radians.
CREASE = 0.05

# Most faces of a surface on which creases are looked for, as many as surfaces of scans have: at the edges of
# smaller faces, which meshes may have, normals lean less.
N_FACES = 10_000

# Number of eigenfunctions that are combined at first, and of the steps that fit the sum to the creases, which
# are narrower. More find as many pairs.
N_COMBINED = 40
N_STEPS = 30

# Number of eigenvalues that are compared between surfaces, as many as the values of the paper's signature.
N_COMPARED = 23

# Ratio of the error of this signature to the deviation of the eigenvalues over surfaces: of 342 whole scans,
# in the median, where they deviate by .1 or more. See docs/decisions.md, grades.
ERROR_OF_DISAGREEMENT = 2.0

# Share of the light that reaches a hole that a sensor could have seen into.
OPEN = 0.7


# --- points -------------------------------------------------------------------------------------------


def point_checks(cloud: PointCloud, *, spacing: float) -> list[Check]:
    """Check the density of a filtered cloud, what was removed of it, and how its outside was found.

    spacing: median distance from a point to its nearest neighbour; unit of the file.
    """
    share = spacing / cloud.diagonal
    cleanings = [step.sizes for step in cloud.provenance if step.stage == "clean"]
    n_kept = n = len(cloud.points)
    if cleanings:
        n_kept = int(cleanings[-1]["points_in"] - cleanings[-1]["outliers"])
    averaged = "" if n_kept == n else f", averaged to {n:,}"
    shown = f"{n_kept:,} points{averaged}, {percent(share)} of the diagonal apart"
    checks = [graded("Points", share, shown)]
    for cropped in [
        step for step in cloud.provenance if step.stage == "crop" and step.notes
    ]:
        n_in = cropped.sizes["points_in"]
        n_cut = n_in - cropped.sizes["points"]
        shown = f"{n_cut:,.0f} of {n_in:,.0f} points cut away, {percent(n_cut / n_in)}"
        checks.append(
            Check(
                "Background",
                "passed",
                n_cut / n_in,
                shown,
                f"{'; '.join(cropped.notes)}.",
            )
        )
    for cleaned in cleanings:
        outliers = 1 - cleaned["points"] / cleaned["points_thinned"]
        dropped = (
            f"{cleaned['outliers']:,.0f} of {cleaned['points_in']:,.0f} points dropped"
        )
        checks.append(
            graded("Outliers", outliers, f"{dropped}, {percent(outliers)} of the voxels")
        )
    return [*checks, _sensor_check(cloud)]


def normal_checks(normals: FloatArray, near: NDArray[np.intp]) -> list[Check]:
    """Check the consistency of normals, and whether they point to all sides.

    normals: (n, 3) float64, of all points.
    near: (m, k + 1), some points, and the k nearest of each, whose normals are compared with its own.
    Returns list of Check: "Normals": fraction of pairs of neighbours whose normals are more than 90 degrees
        apart. "Sides seen": length of the mean normal.
    """
    own, others = near[:, 0], near[:, 1:]
    cosines = np.einsum(
        "ij,ikj->ik", normals[own], normals.take(others, axis=0)
    )  # (m, k)
    disagreeing = float((cosines <= 0).mean())
    # The mean normal of a closed surface is 0; the mean normal of half a sphere has the length 1/2.
    unbalanced = float(np.linalg.norm(normals.mean(axis=0)))
    return [
        graded("Normals", disagreeing, f"{percent(1 - disagreeing)} of neighbours agree"),
        graded(
            "Sides seen", unbalanced, f"their normals are {percent(unbalanced)} one-sided"
        ),
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
    worst = layers.places[layers.apart.argmax()]
    return graded(
        "Double walls", share, shown, error=ERROR_OF_LAYERS * width, places=[worst]
    )


def _sensor_check(cloud: PointCloud) -> Check:
    notes = [
        note for step in cloud.provenance if step.stage == "orient" for note in step.notes
    ]
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
    n_edges = float(
        found.boundary_edges + found.non_manifold_edges + found.inconsistent_edges
    )
    shown = str(found) if found else "no defects"
    error = ERROR_OF_HOLES if found else 0.0
    closed = graded("Closed surface", n_edges, shown, is_good=not found, error=error)
    if found:
        return [closed]
    euler = mesh.euler_characteristic
    handles = 1 - euler // 2
    shown = f"{_counted(handles, 'handle')}, Euler characteristic {euler}"
    return [closed, graded("Handles", float(handles), shown, is_good=not handles)]


def mesh_check(provenance: Sequence[Step]) -> list[Check]:
    """Check whether a mesh that was repaired, or sampled for reconstruction, was a manifold."""
    welds = [
        step.sizes["non_manifold"] for step in provenance if "non_manifold" in step.sizes
    ]
    return [
        graded(
            "Welds",
            n,
            _counted(int(n), "non-manifold vertex or edge"),
            is_good=not n,
            error=ERROR_OF_WELDS if n else 0.0,
        )
        for n in welds
    ]


def fit_checks(fit: Fit, least_end: float) -> list[Check]:
    """Check how well points and surface fit each other; `least_end` as in `ends_check`."""
    return [
        filled_check(fit),
        evenness_check(fit),
        ends_check(fit, least_end),
        gaps_check(fit),
        hole_check(fit),
        lost_check(fit),
        noise_check(fit),
    ]


def filled_check(fit: Fit) -> Check:
    """Check how much of the surface has no points nearby."""
    share = fit.share(fit.filled)
    shown = f"{percent(share)} of the surface"
    return graded("Filled in", share, shown, error=ERROR_OF_FILLED * share)


def evenness_check(fit: Fit) -> Check:
    """Check whether some sides have many fewer points than others."""
    shown = f"a quarter of the surface has {fit.unevenness:.2g} times the spacing of another quarter"
    return graded("Evenness", fit.unevenness, shown)


def ends_check(fit: Fit, least: float) -> Check:
    """Check whether the surface was closed across a limb; ends of at most the least size are none."""
    ends = [end for end in fit.ends if end.size > least]
    size = max((end.size for end in ends), default=0.0)
    missing = [end.middle for end in ends if end.size > ENDS_OF_NOISE]
    error = ERROR_OF_ENDS * max(0.0, size - ENDS_OF_NOISE)
    shown = f"{percent(size)} of the root of the area of the surface"
    return graded("Closed ends", size, shown, error=error, places=missing)


def gaps_check(fit: Fit) -> Check:
    """Check how far the surface is from the points, but for the farthest twentieth."""
    gap = fit.gap / fit.cloud.diagonal
    shown = f"95 % of the surface lie within {percent(gap)} of the diagonal of a point"
    return graded("Gaps", gap, shown, error=ERROR_OF_GAPS * gap**2)


def hole_check(fit: Fit) -> Check:
    """Check whether a hole shows: it is large, and sensors could have seen it."""
    holes = [
        hole for hole in fit.holes if not hole.is_expected and _is_visible(hole, fit)
    ]
    if not holes:
        return graded("Largest hole", 0.0, "none")
    holes.sort(key=lambda hole: -hole.radius)
    radius = holes[0].radius
    places = [hole.middle for hole in holes if hole.radius > LARGE_HOLE]
    shown = f"{2 * radius * fit.length:.2g} wide, {percent(2 * radius)} of the length of the body"
    return graded("Largest hole", radius, shown, places=places)


def _is_visible(hole: Hole, fit: Fit) -> bool:
    """Whether a sensor could have seen into a hole: no small one that is in the shade."""
    if hole.light > OPEN:
        return True
    return hole.radius > LARGE_HOLE and fit.sees_shades(hole.light)


def lost_check(fit: Fit) -> Check:
    """Check how many points are far from the surface."""
    share = float((fit.to_surface > FILLED * fit.spacing).mean())
    shown = f"{percent(share)} of the points lie off the surface"
    return graded("Left out", share, shown, error=ERROR_OF_LOST * share)


def noise_check(fit: Fit) -> Check:
    """Check how far points scatter about the surface."""
    beside = fit.to_surface[fit.to_surface <= FILLED * fit.spacing]
    rms = float(np.sqrt((beside**2).mean())) if len(beside) else 0.0
    share = rms / fit.cloud.diagonal
    shown = f"{percent(share)} of the diagonal (rms)"
    return graded("Noise", share, shown, error=ERROR_OF_NOISE * share)


def base_check(area: float, *, on_ground: bool) -> Check:
    """Check how much of the surface is the base on which the body stood, which no sensor sees."""
    error = ERROR_OF_FILLED * area
    shown = f"{percent(area)} of the surface"
    return graded("Closed base", area, shown, is_good=on_ground, error=error)


def marks_check(n_cuts: int, n_bridges: int) -> Check:
    """Check how often the topology of the surface was changed."""
    n = n_cuts + n_bridges
    shown = f"{_counted(n_cuts, 'cut')}, {_counted(n_bridges, 'bridge')}"
    return graded(
        "Cuts and bridges",
        float(n),
        shown,
        is_good=not n,
        error=ERROR_OF_CUT * n**0.5,
    )


def spectrum_checks(shape: Shape) -> list[Check]:
    """Check whether the surface is that of one body, and whether all surfaces of the scan agree."""
    logs = np.log(
        [
            surface.spectrum.eigenvalues[1:]
            for surface in shape.surfaces
            if surface.spectrum
        ]
    )
    checks = []
    for surface in shape.surfaces[:1]:
        if surface.mesh and surface.eigenpairs:
            vectors = surface.eigenpairs.eigenvectors[: len(surface.mesh.vertices)]
            checks.append(body_check(neck(surface.mesh, vectors[:, 1:])))
    if len(logs) > 1:
        apart = float(np.linalg.norm(logs[:, :N_COMPARED].std(axis=0, ddof=1)))
        shown = f"{apart:.2g} between the spectra of {len(logs)} surfaces"
        checks.append(
            graded("Surfaces", apart, shown, error=ERROR_OF_DISAGREEMENT * apart)
        )
    return checks


def limbs_check(ratio: float) -> Check:
    """Check whether the form of a person is that of one without a limb, by `limbless_ratio`."""
    shown = f"exp({ratio:.1f}) times as likely without a limb, or the head, as whole"
    return graded("Limbs", ratio, shown)


class Neck(NamedTuple):
    """The level line that is the most like that where two bodies touch.

    length: relative to the root of the area on its smaller side.
    creased: share of it that lies in a crease.
    sharpness: length of the level lines nearby, on the side where they are shorter, relative to it.
    is_sharp: whether that is enough where two bodies touch.
    middle: (3,) float64.
    """

    length: float
    creased: float
    sharpness: float
    is_sharp: bool
    middle: FloatArray


def body_check(waist: Neck) -> Check:
    """Check whether two bodies touch, in a short line with longer ones on both sides."""
    is_short = waist.length < NECK + (CREASED_NECK - NECK) * waist.creased
    are_two = is_short and waist.is_sharp
    shown = (
        f"the line between its halves is {waist.length:.2g} of the root of the smaller one's area, "
        f"{percent(waist.creased)} in a crease, and {waist.sharpness:.2g} times as long beside it"
    )
    error = NECK_ERROR if are_two else 0.0
    return graded(
        "One body",
        waist.length,
        shown,
        is_good=not are_two,
        error=error,
        places=[waist.middle],
    )


def neck(mesh: TriangleMesh, eigenvectors: FloatArray) -> Neck:
    """The line by which a surface may be two bodies, among those that part a fifth or more of the area.

    The shortest level line of the first eigenfunction of the Laplace–Beltrami operator is an estimate of the
    Cheeger constant [1]_: two balls that touch have a short one. Here, the function is flat on both sides of
    creases, so that a level line follows the one round a contact, even if it is not the narrowest place.

    eigenvectors: (n, k) float64, of the operator, without the constant one.

    References
    ----------
    .. [1] J. Cheeger, "A lower bound for the smallest eigenvalue of the Laplacian", Problems in Analysis,
       1970.
    """
    mesh, eigenvectors = _coarser(mesh, eigenvectors)
    leanings, in_crease = _creases(mesh)
    corners = _parting(mesh, leanings, eigenvectors)[mesh.faces]  # (m, 3)
    levels, shares, openings = _levels(mesh, corners.mean(axis=1))
    line, face, start, end = _level_lines(mesh, corners, levels)
    pieces = np.linalg.norm(end - start, axis=1) / np.sqrt(mesh.area)
    lengths = np.bincount(line, pieces, len(levels)).clip(np.finfo(np.float64).tiny)
    creased = np.bincount(line, pieces * in_crease[face], len(levels)) / lengths
    relative = lengths / np.sqrt(np.minimum(shares, 1 - shares))
    sharpness = _sharpness(lengths, shares)
    is_sharp = sharpness > np.where(creased > LEAST_CREASED, LEAST_SHARPNESS, SHARP)
    is_sharp &= ~_is_of_rod(lengths, creased, shares)
    is_sharp &= ~_is_turned(openings, lengths, shares)
    likeness = (CREASED_NECK - NECK) * creased - relative
    # Lines that part both halves come first, and of these the sharp ones.
    at = int(np.lexsort((likeness, is_sharp, np.abs(shares - 0.5) < FROM_HALF))[-1])
    return Neck(
        length=float(relative[at]),
        creased=float(creased[at]),
        sharpness=float(sharpness[at]),
        is_sharp=bool(is_sharp[at]),
        middle=pieces[line == at] @ (start + end)[line == at] / (2 * lengths[at]),
    )


def _coarser(
    mesh: TriangleMesh, eigenvectors: FloatArray
) -> tuple[TriangleMesh, FloatArray]:
    """A surface of at most `N_FACES` faces, and eigenfunctions (n, k) on it; unchanged, if it has defects."""
    if len(mesh.faces) <= N_FACES or defects(mesh):
        return mesh, eigenvectors
    coarse = simplified(mesh, N_FACES)
    _, near = nearest(mesh.vertices, coarse.vertices, 1)
    return coarse, eigenvectors[near[:, 0]]


def _creases(mesh: TriangleMesh) -> tuple[csr_array, Mask]:
    """By which angles normals at the ends of edges lean towards each other, and which faces are in creases.

    Returns leanings: (n, n) float64, positive in creases; in_crease: (m,) bool.
    """
    leanings = adjacency(mesh)
    normals = vertex_normals(mesh.vertices, mesh.faces)
    normals = unit_vectors(normals + leanings @ normals)
    starts, ends = leanings.tocoo().coords
    along = unit_vectors(mesh.vertices[ends] - mesh.vertices[starts])
    leanings.data = np.einsum("ij,ij->i", normals[starts] - normals[ends], along)
    at_vertices = leanings.sum(axis=1) / np.diff(leanings.indptr)  # (n,)
    return leanings, at_vertices[mesh.faces].mean(axis=1) > CREASE


def _parting(
    mesh: TriangleMesh, leanings: csr_array, eigenvectors: FloatArray
) -> FloatArray:
    """(n,) the lowest eigenfunction, about, of a Laplacian whose edges are weak in creases.

    It is the best combination of eigenfunctions (Rayleigh–Ritz method), and then the solution of one step of
    inverse iteration, by some steps of conjugate gradients.
    """
    from scipy.linalg import eigh
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import cg

    weights = leanings.copy()
    weights.data = 1 / (1 + WEAKNESS * leanings.data.clip(0))
    degrees = weights.sum(axis=1)
    laplacian = (diags_array(degrees) - weights).tocsr()
    span = eigenvectors[:, :N_COMBINED]
    energies, mixing = eigh(span.T @ (laplacian @ span), subset_by_index=[0, 0])
    start = span @ mixing[:, 0]
    corner_areas = np.repeat(mesh.face_areas / 3, 3)
    masses = np.bincount(mesh.faces.ravel(), corner_areas, len(start))
    scaling = diags_array(1 / degrees)
    solved, _ = cg(
        laplacian, masses * start, start / energies[0], maxiter=N_STEPS, M=scaling
    )
    return solved


def _levels(
    mesh: TriangleMesh, values: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(l,) levels of a function in ascending order, the shares of the area below them, and openings.

    values: (m,) of the faces.
    Returns also (5, l, 3): area vectors of level lines, relative to the area of the surface, at five steps of
        the area from `ALONG` below each to as much above it.
    """
    order = np.argsort(values)
    below = np.cumsum(mesh.face_areas[order]) / mesh.area
    steps = np.linspace(LEAST_SIDE, 1 - LEAST_SIDE, N_LEVELS)
    by_area = values[order[np.searchsorted(below, steps)]]
    by_value = np.linspace(by_area[0], by_area[-1], N_LEVELS)
    levels = np.sort(np.concatenate([by_area, by_value]))
    shares = below[np.searchsorted(values[order], levels)]
    beside = np.add.outer(np.linspace(-ALONG, ALONG, 5), shares)
    # The area vectors of all faces below a closed line sum up to that of the line.
    vectors = np.cumsum(mesh.area_vectors[order], axis=0) / mesh.area
    return levels, shares, vectors[np.searchsorted(below, beside)]


def _sharpness(lengths: FloatArray, shares: FloatArray) -> FloatArray:
    """(l,) that of each level line of a `Neck`, by its length and the share of the area below it."""
    nearby = _within(NEARBY, shares) * lengths
    below, above = (half(nearby).max(axis=1) for half in (np.tril, np.triu))
    return np.asarray(np.minimum(below, above) / lengths)


def _is_of_rod(lengths: FloatArray, creased: FloatArray, shares: FloatArray) -> Mask:
    """(l,) whether each level line is in a crease at the end of a rod."""
    is_outside = creased < OUTSIDE
    is_beside = _within(ALONG, shares) & is_outside
    shortest = np.where(is_beside, lengths, np.inf).min(axis=1)
    return np.asarray(~is_outside & (shortest < HARDLY_LONGER * lengths))


def _is_turned(openings: FloatArray, lengths: FloatArray, shares: FloatArray) -> Mask:
    """(l,) whether each level line is near a circle that is one end of a cylinder.

    openings: as by `_levels`.
    lengths: relative to the root of the area of the surface.
    """
    # Areas of openings, seen along the axis of the line in the middle.
    seen = np.einsum("ilj,lj->il", openings, unit_vectors(openings[2]))
    change = np.abs(seen - seen[2])
    is_straight = (change[:2].max(axis=0) < STRAIGHT) | (
        change[3:].max(axis=0) < STRAIGHT
    )
    is_circle = 4 * np.pi * seen[2] > CIRCULAR * lengths**2
    return np.asarray((_within(ALONG, shares) & is_circle & is_straight).any(axis=1))


def _within(reach: float, shares: FloatArray) -> Mask:
    """(l, l) between which level lines there is less than this share of the area."""
    return np.asarray(np.abs(np.subtract.outer(shares, shares)) < reach)


def _level_lines(
    mesh: TriangleMesh, values: FloatArray, levels: FloatArray
) -> tuple[NDArray[np.intp], NDArray[np.intp], FloatArray, FloatArray]:
    """The pieces of level lines, one in each face that a line crosses.

    values: (m, 3) at the corners of the faces.
    levels: (l,) in ascending order.
    Returns line, face, start, end: (k,) of which level, in which face; (k, 3) the ends of the pieces.
    """
    first, last = np.searchsorted(levels, [values.min(axis=1), values.max(axis=1)])
    face = np.repeat(np.arange(len(values)), last - first)
    line = np.arange(len(face)) - np.repeat(np.cumsum(last - first) - last, last - first)
    is_above = values[face] > levels[line, np.newaxis]
    # One corner is on a side of its own; the line crosses both edges that meet there.
    alone = np.where(
        is_above.sum(axis=1) == 1, is_above.argmax(axis=1), is_above.argmin(axis=1)
    )
    corner = mesh.vertices[mesh.faces[face, alone]]
    value = values[face, alone]
    ends = []
    for step in (1, 2):
        other = (alone + step) % 3
        share = (levels[line] - value) / (values[face, other] - value)
        along = mesh.vertices[mesh.faces[face, other]] - corner
        ends.append(corner + share[:, np.newaxis] * along)
    return line, face, ends[0], ends[1]


def _counted(n: int, name: str) -> str:
    """A number with its noun, such as "1 cut" and "2 cuts"."""
    return f"{n} {name}" if n == 1 else f"{n} {name}s"
