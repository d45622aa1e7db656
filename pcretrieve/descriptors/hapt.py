"""HAPT: histograms of the area projection transform, which measure the girths of the parts of a body.

Move every point of a surface by R along its inward normal. Where the surface is part of a sphere or a tube
of radius R, many points arrive at its centre or on its axis. The multiscale area projection transform (MAPT)
at a point x is the area that arrives within a distance of σ = c R from x, divided by the area 4 π R² of a
sphere: 1 in the centre of a sphere, and about c on the axis of a tube. The descriptor says in how much of the
body it exceeds certain levels, for each radius R.

Poses change it little: limbs remain tubes when they bend. Its errors are not those of spectra.

Voxels are aligned with the principal axes of the body. A surface is described on two grids, the second half
an edge beside the first: their errors differ, and cancel in part in the mean. Of several surfaces of a scan,
over which the mean is taken anyway, each is described on one of the grids. See docs/decisions.md, grids of
HAPT.

The moments along the principal axes are a descriptor too: they are integrals, which change little with
triangulation, noise and small holes, and not at all in a mirror, but change with the pose. So they find
copies of one body in one pose: see docs/decisions.md, `SAME`.
"""

from __future__ import annotations

from functools import cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from pcretrieve.descriptors.descriptor import Descriptor
from pcretrieve.errors import DegenerateMeshError
from pcretrieve.values import FloatArray, Grid, IntArray, Mask, Signature, TriangleMesh
from pcretrieve.values.compiled import compiled, inner

# Half as long as float64: the time is that of reading them.
Areas: TypeAlias = NDArray[np.float32]

# R, in units of √A with the area A of the surface, each 1.113 times the one before, and the ratio c = σ / R.
# A person of 1.7 m² has arms of .03, thighs of .06, a head of .07. See docs/decisions.md, HAPT.
RADII = np.array([0.0166 * 1.113**step for step in range(22)])
SPREAD = 0.5

# Values of the transform, each 1.6 times the one before. Higher ones are found in balls alone.
STEP = 1.6
LEVELS = np.array([0.052 * STEP**step for step in range(7)])

# Half a step below the first level, from which on a voxel counts.
LEAST = LEVELS[0] / np.sqrt(STEP)

# What the volumes are multiplied by, (r, l). Thin parts, and the middle of parts, where levels are high,
# change less with the pose than the larger volumes at low levels. A learned metric has weights of its own.
WEIGHTS = LEVELS**4 / RADII[:, np.newaxis] ** 3

# What is added to each volume: five narrow voxels. Roots of smaller volumes, those in fingers, are noise.
PSEUDOCOUNT = 5e-6

# Edge of a voxel in units of √A, twice as long for the radii from `WIDE` on; largest distance of sample
# points, in voxels.
CELL = 0.01
WIDE = 0.06
SPACING = 1.25

# By which share of an edge the voxels of each of two grids lie beside those round the centre.
SHIFTS = (0.0, 0.5)

# Memory is limited to about 1 GB: a body of unit area that is long, thin and bent has a large bounding box,
# and long triangles have many sample points, most of which are nearer to each other than the spacing.
MOST_VOXELS = 2**24
MOST_POINTS = 2**23


def hapt(mesh: TriangleMesh, number: int | None = None) -> Signature:
    """Histograms of the area projection transform [1]_, for 22 radii.

    The settings that the article leaves open, or varies with the data (see docs/decisions.md, HAPT): radii of
    .017 to .16 √A, relative to the area A because the unit of a file may be unknown; c = 1/2; voxels of .01
    and .02 √A; normals interpolated from the vertices; cumulative histograms in units of volume, not of the
    share of the body, to which a voxel contributes in part where the transform is near a level; a pseudocount
    of 5e-6 A^(3/2); weights of radii and levels; and the Hellinger distance in the place of the Jeffrey
    divergence, to which it is proportional for small differences, and which is no metric.

    number : which of several surfaces of a scan it is, which are described on one of two grids in turn; by
    default, a surface is described on both.

    values : (154,), for each radius the volumes at the levels of .052 to .87 with the pseudocount, relative
    to R³, times the fourth power of the level.

    References
    ----------
    .. [1] A. Giachetti and C. Lovato, "Radial symmetry detection and shape characterization with the
       multiscale area projection transform", Computer Graphics Forum 31 (2012).
    """
    framed = in_principal_frame(mesh)
    shifts = SHIFTS if number is None else (SHIFTS[number % 2],)
    volumes = np.mean([_volumes(framed, shift) for shift in shifts], axis=0)
    weighted = WEIGHTS * (volumes + PSEUDOCOUNT)
    return Signature(weighted.ravel(), kind="hapt", metric="histograms")


def _volumes(framed: TriangleMesh, shift: float) -> FloatArray:
    """(r, l) in how much of a body the transform for each radius exceeds each level, by one grid."""
    scales = (RADII[RADII < WIDE], CELL), (RADII[RADII >= WIDE], 2 * CELL)
    return np.concatenate(
        [
            cell**3 * _counted(projected_areas(framed, radii, SPREAD, cell, shift))
            for radii, cell in scales
        ]
    )


@compiled()
def _counted(areas: Areas) -> FloatArray:
    """(r, l) in how many of k voxels each of the areas (r, k) exceeds each level.

    A voxel counts in part half a step below and above the level: whole ones would make steps of the values.
    """
    counts = np.zeros((len(areas), len(LEVELS)))
    for row in range(len(areas)):
        for area in areas[row]:
            if area <= LEAST:
                continue
            # In steps, from half a step below the first level.
            above, level = np.log(area / LEVELS[0]) / np.log(STEP) + 0.5, 0
            while level < len(LEVELS) and above > level:
                counts[row, level] += min(above - level, 1.0)
                level += 1
    return counts


def projected_areas(
    framed: TriangleMesh,
    radii: FloatArray,
    spread: float,
    cell: float,
    shift: float = 0.0,
) -> Areas:
    """(r, k) the transform for radii (r,) at the centres of all k voxels inside a body of unit area.

    shift: as in `SHIFTS`. A thin body may have no voxel of the wide radii inside.
    """
    # Half a voxel more on each side moves all centres by half an edge.
    grid = _grid(framed, cell, margin=np.ceil(spread * radii.max() / cell) + 1 + shift)
    inside = np.flatnonzero(interior(framed, grid))  # (k,)
    if not len(inside) and cell == CELL:
        raise DegenerateMeshError(
            f"hapt needs a body with an interior, got a surface that encloses no voxel of {cell:g} √area: "
            "close its holes, or choose a descriptor of surfaces"
        )
    samples = _samples(framed, grid)
    steps = np.array([grid.shape[1] * grid.shape[2], grid.shape[2], 1])
    transform = np.empty((len(radii), len(inside)), dtype=np.float32)
    for row, radius in zip(transform, radii, strict=True):
        arrived = _arrived(samples, radius / cell, grid.shape)
        offsets, shares = _ball(spread * radius / cell)
        row[:] = _gathered(arrived, inside, offsets @ steps, shares) / (
            4 * np.pi * radius**2
        )
    return transform


@compiled()
def _arrived(samples: FloatArray, radius: float, shape: tuple[int, int, int]) -> Areas:
    """The area that arrives in each voxel of a grid, in C order, from a surface that moves inwards.

    The area of a point is divided between the eight voxels around it, trilinearly: with the nearest voxel
    alone, the errors of small radii would be two thirds of what poses change.
    """
    arrived = np.zeros(shape[0] * shape[1] * shape[2], dtype=np.float32)
    step_x, step_y = shape[1] * shape[2], shape[2]
    for i in range(len(samples)):
        x, y, z = (
            samples[i, 0] - radius * samples[i, 3],
            samples[i, 1] - radius * samples[i, 4],
            samples[i, 2] - radius * samples[i, 5],
        )
        a, b, c = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
        if not (
            0 <= a < shape[0] - 1 and 0 <= b < shape[1] - 1 and 0 <= c < shape[2] - 1
        ):
            continue
        first = a * step_x + b * step_y + c
        for right in range(2):
            along_x = samples[i, 6] * (x - a if right else a + 1 - x)
            for behind in range(2):
                along_y = along_x * (y - b if behind else b + 1 - y)
                voxel = first + right * step_x + behind * step_y
                arrived[voxel] += along_y * (c + 1 - z)
                arrived[voxel + 1] += along_y * (z - c)
    return arrived


@compiled()
def _gathered(
    arrived: Areas,
    inside: NDArray[np.intp],
    offsets: NDArray[np.intp],
    shares: Areas,
) -> Areas:
    """(k,) sums of the areas round each of k voxels, each area with the share of its voxel in the ball."""
    gathered, first = np.zeros(len(inside), dtype=np.float32), 0
    while first < len(inside):
        # Voxels that follow each other are summed together.
        last = first + 1
        while last < len(inside) and inside[last] == inside[last - 1] + 1:
            last += 1
        sums = gathered[first:last]
        for number in range(len(offsets)):
            areas, share = arrived[inside[first] + offsets[number] :], shares[number]
            for row in range(len(sums)):
                sums[row] += share * areas[row]
        first = last
    return gathered


def _grid(mesh: TriangleMesh, cell: float, margin: float) -> Grid:
    """A grid that is its own mirror image, because the directions of principal axes are arbitrary."""
    reach = np.ceil(np.abs(mesh.vertices).max(axis=0) / cell) + margin  # (3,)
    if (n_voxels := np.prod(2 * reach + 1)) > MOST_VOXELS:
        raise DegenerateMeshError(
            f"hapt needs a body of at most {MOST_VOXELS:,} voxels of {cell:g} √area, got {n_voxels:,.0f}: "
            "the body is too thin for its length; choose another descriptor"
        )
    n_x, n_y, n_z = (2 * reach + 1).astype(int).tolist()
    return Grid(-reach * cell, cell, (n_x, n_y, n_z))


def _samples(mesh: TriangleMesh, grid: Grid) -> FloatArray:
    """(p, 7) points of a surface, in voxels, their unit normals, and the areas that they represent.

    These are the centres of the triangles into which each triangle is divided, at most `SPACING` voxels wide.
    """
    corners = mesh.corners  # (3, 3, m)
    widest = np.sqrt(
        ((corners - corners[:, [2, 0, 1]]) ** 2).sum(axis=0).max(axis=0)
    )  # (m,)
    n_parts = np.maximum(1, np.ceil(widest / (SPACING * grid.cell)))  # (m,) of each edge
    if (n_points := (n_parts**2).sum()) > MOST_POINTS:
        raise DegenerateMeshError(
            f"hapt needs a surface of at most {MOST_POINTS:,} sample points, got {n_points:,.0f}: some "
            "triangles are too long; remesh it"
        )
    values = np.column_stack(
        [grid.coordinates(mesh.vertices), _vertex_normals(mesh.vertices, mesh.faces)]
    )
    return _centres(values, mesh.faces, mesh.face_areas, n_parts.astype(np.intp))


@compiled()
def _centres(
    values: FloatArray, faces: IntArray, areas: FloatArray, parts: NDArray[np.intp]
) -> FloatArray:
    """The samples, of which all but the area are interpolated from those of the vertices."""
    samples = np.empty(((parts**2).sum(), 7))
    point = 0
    for f in range(len(faces)):
        a, b, c, n = faces[f, 0], faces[f, 1], faces[f, 2], parts[f]
        for part in range(n * n):
            row, column, share = part // n, part % n, 1 / 3
            if (
                row + column >= n
            ):  # a triangle between those with the orientation of the face
                row, column, share = n - 1 - row, n - 1 - column, 2 / 3
            u, v = (row + share) / n, (column + share) / n
            sample = samples[point]
            for k in range(6):
                sample[k] = (
                    u * values[a, k] + v * values[b, k] + (1 - (u + v)) * values[c, k]
                )
            length = np.sqrt(sample[3] ** 2 + sample[4] ** 2 + sample[5] ** 2)
            for k in range(3, 6):
                sample[k] /= length if length > 0 else 1.0
            sample[6] = areas[f] / n**2
            point += 1
    return samples


@compiled()
def _vertex_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """(n, 3) means of the normals of the faces at each vertex by their angles, not of unit length."""
    # Such normals do not depend on how the surface is triangulated: G. Thürmer and C. Wüthrich, "Computing
    # vertex normals from polygonal facets", Journal of Graphics Tools 3 (1998).
    normals = np.zeros_like(vertices)
    for f in range(len(faces)):
        for k in range(3):
            here = faces[f, k]
            part = _weighted_normal(vertices, here, faces[f, k - 2], faces[f, k - 1])
            for axis in range(3):
                normals[here, axis] += part[axis]
    return normals


@inner()
def _weighted_normal(
    vertices: FloatArray, here: int, after: int, before: int
) -> tuple[float, float, float]:
    """The unit normal of a triangle times its angle at the corner `here`."""
    a, b, c = vertices[here, 0], vertices[here, 1], vertices[here, 2]
    u, v, w = vertices[after, 0] - a, vertices[after, 1] - b, vertices[after, 2] - c
    x, y, z = vertices[before, 0] - a, vertices[before, 1] - b, vertices[before, 2] - c
    across = (v * z - w * y, w * x - u * z, u * y - v * x)
    double = np.sqrt(across[0] ** 2 + across[1] ** 2 + across[2] ** 2)  # twice the area
    angle = np.arctan2(double, u * x + v * y + w * z)
    length = max(double, np.finfo(np.float64).tiny)
    return (
        angle * across[0] / length,
        angle * across[1] / length,
        angle * across[2] / length,
    )


@cache
def _ball(radius: float) -> tuple[NDArray[np.intp], Areas]:
    """Offsets (b, 3) of the voxels in a ball, and their shares (b,) in it: less than 1 at its rim.

    The sum of the shares is the volume of the ball.
    """
    reach = int(np.ceil(radius))
    offsets = np.indices(3 * (2 * reach + 1,)).reshape(3, -1).T - reach
    shares = np.clip(radius + 0.5 - np.linalg.norm(offsets, axis=1), 0, 1)
    shares *= 4 / 3 * np.pi * radius**3 / shares.sum()
    return offsets[shares > 0], shares[shares > 0].astype(np.float32)


# --- the inside of a surface ------------------------------------------------------------------------

# Displacement of the grid lines along each axis, in voxels, that keeps them off the vertices and edges of
# surfaces that are aligned with the grid, where a crossing would be counted twice or not at all.
DISPLACEMENT = (1.3e-7, 2.1e-7, 0.7e-7)


def interior(mesh: TriangleMesh, grid: Grid) -> Mask:
    """The voxels whose centres are inside a surface.

    Along each of the three axes, the winding number of the surface round a voxel is the sum of the
    orientations of the triangles that the grid line crosses before the voxel [1]_. A voxel is inside if the
    winding number is not zero along two axes or three, so that a hole of an open surface is closed where the
    lines along the two other axes do not pass through it.

    References
    ----------
    .. [1] F. Nooruddin and G. Turk, "Simplification and repair of polygonal models using volumetric
       techniques", IEEE Transactions on Visualization and Computer Graphics 9 (2003).
    """
    at = grid.coordinates(mesh.vertices) + DISPLACEMENT
    votes = np.zeros(grid.shape, dtype=np.int8)
    for order in ((1, 2, 0), (0, 2, 1), (0, 1, 2)):
        turned = votes.transpose(order)
        turned += (
            _windings(np.ascontiguousarray(at[:, order]), mesh.faces, turned.shape) != 0
        )
    return votes >= 2


@compiled()
def _windings(at: FloatArray, faces: IntArray, shape: tuple[int, int, int]) -> IntArray:
    """The winding number of a surface round each voxel, along the last axis."""
    # First that of the triangles between a voxel and the one before.
    turns = np.zeros(shape, dtype=np.int32)
    for f in range(len(faces)):
        a, b, c = at[faces[f, 0]], at[faces[f, 1]], at[faces[f, 2]]
        first, last = (
            int(np.ceil(min(a[0], b[0], c[0]))),
            int(np.floor(max(a[0], b[0], c[0]))),
        )
        low, high = (
            int(np.ceil(min(a[1], b[1], c[1]))),
            int(np.floor(max(a[1], b[1], c[1]))),
        )
        for x in range(first, last + 1):
            for y in range(low, high + 1):
                turn, z = _crossing(a, b, c, x, y)
                if turn:
                    turns[x, y, int(np.ceil(z))] += turn
    for x in range(shape[0]):
        for y in range(shape[1]):
            for z in range(1, shape[2]):
                turns[x, y, z] += turns[x, y, z - 1]
    return turns


@inner()
def _crossing(
    a: FloatArray, b: FloatArray, c: FloatArray, x: int, y: int
) -> tuple[int, float]:
    """How the grid line at (x, y) turns round a triangle that it crosses, 1 or −1, and where; else 0."""
    # Twice the signed areas of the triangles of the line and one edge, opposite each corner.
    p = (b[0] - x) * (c[1] - y) - (b[1] - y) * (c[0] - x)
    q = (c[0] - x) * (a[1] - y) - (c[1] - y) * (a[0] - x)
    r = (a[0] - x) * (b[1] - y) - (a[1] - y) * (b[0] - x)
    if not ((p > 0 and q > 0 and r > 0) or (p < 0 and q < 0 and r < 0)):
        return 0, 0.0
    height = (p * a[2] + q * b[2] + r * c[2]) / (p + q + r)
    return (1 if p > 0 else -1), height


HAPT = Descriptor(
    name="hapt",
    make=lambda shape, _: hapt(shape.mesh, shape.number),
    needs=("mesh",),
    has_size=False,
    length=lambda _: WEIGHTS.size,
    metric="histograms",
    spread=0.169,
)


# --- moments --------------------------------------------------------------------------------------


def moments(mesh: TriangleMesh) -> Signature:
    """The standard deviation σ along each principal axis, and the root of m₄ / σ², with m₄ the fourth moment.

    values : (6,) in units of √A, smallest σ first. On an axis of a sphere, both are in the ratio 1 : √(9/5).
    """
    weights, middles, _, axes = _principal(mesh)
    squares = (middles @ axes) ** 2 / weights.sum()
    second, fourth = (
        weights @ powers / weights.sum() for powers in (squares, squares**2)
    )
    second = np.maximum(second, np.finfo(float).eps)  # of a surface in a plane
    return Signature(np.sqrt(np.concatenate([second, fourth / second])), kind="moments")


def in_principal_frame(mesh: TriangleMesh) -> TriangleMesh:
    """The surface of unit area, oriented outwards, with its centre and principal axes as the frame."""
    _, _, centre, axes = _principal(mesh)
    place = (mesh.vertices - centre) @ axes / np.sqrt(mesh.area)
    turned = TriangleMesh(place, mesh.faces)
    return turned if turned.volume >= 0 else TriangleMesh(place, mesh.faces[:, ::-1])


def _principal(
    mesh: TriangleMesh,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Areas (3 m,) and midpoints of edges (3 m, 3), which integrate quadratics exactly, centre and axes.

    Midpoints are relative to the centre (3,); the principal axes are the columns (3, 3).
    """
    areas = mesh.face_areas
    if not 0 < (total := float(areas.sum())) < np.inf:
        raise DegenerateMeshError(
            f"a surface must have a positive area, got an area of {total:g}"
        )
    a, b, c = (mesh.vertices.take(corner, axis=0) for corner in mesh.faces.T)  # (m, 3)
    centre = areas @ (a + b + c) / (3 * total)
    middles = np.concatenate([a + b, b + c, c + a]) / 2 - centre
    weights = np.tile(areas, 3)
    axes = np.linalg.eigh(middles.T @ (weights[:, np.newaxis] * middles))[1]
    return weights / 3, middles, centre, axes


MOMENTS = Descriptor(
    name="moments",
    make=lambda shape, _: moments(shape.mesh),
    needs=("mesh",),
    has_size=False,
    length=lambda _: 6,
    spread=0.55,
)
