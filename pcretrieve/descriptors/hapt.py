"""HAPT: histograms of the area projection transform, which measure the girths of the parts of a body.

Move every point of a surface by R along its inward normal. Where the surface is part of a sphere or a tube
of radius R, many points arrive at its centre or on its axis. The multiscale area projection transform (MAPT)
at a point x is the area that arrives within a distance of σ = c R from x, divided by the area 4 π R² of a
sphere: 1 in the centre of a sphere, and about c on the axis of a tube. The descriptor says in how much of the
body it exceeds certain levels, for each radius R.

Poses change it little: limbs remain tubes when they bend. Its errors are not those of spectra.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pcretrieve.descriptors.descriptor import Descriptor
from pcretrieve.descriptors.moments import in_principal_frame
from pcretrieve.errors import DegenerateMeshError
from pcretrieve.points.grid import Grid, interior
from pcretrieve.values import FloatArray, Signature, TriangleMesh

# R, in units of √A with the area A of the surface, each 1.38 times the one before, and the ratio c = σ / R. A
# person of 1.7 m² has arms of .03, thighs of .06 and a head of .07. See docs/decisions.md, HAPT.
RADII = np.array([0.02 * 1.38**step for step in range(5)])
SPREAD = 0.5

# Values of the transform. Higher ones than .9 are found in balls alone.
LEVELS = np.linspace(0.1, 0.9, 9)

# Edge of a voxel, the σ of the smallest radius, and largest distance of sample points; in units of √A.
CELL = 0.01
SPACING = 0.0075

# Memory is limited to about 1 GB: a body of unit area that is long, thin and bent has a large bounding box,
# and long triangles have many sample points, most of which are nearer to each other than the spacing.
MOST_VOXELS = 2**24
MOST_POINTS = 2**23


def hapt(mesh: TriangleMesh) -> Signature:
    """Histograms of the area projection transform [1]_, for five radii.

    The settings that the article leaves open, or varies with the data (see docs/decisions.md, HAPT): radii of
    .02 to .073 √A, relative to the area A because the unit of a file may be unknown; c = 1/2; voxels of .01
    √A; normals interpolated from the vertices; cumulative histograms in units of volume, not of the share of
    the body; and the Hellinger distance in the place of the Jeffrey divergence, to which it is proportional
    for small differences, and which is no metric.

    References
    ----------
    .. [1] A. Giachetti and C. Lovato, "Radial symmetry detection and shape characterization with the
       multiscale area projection transform", Computer Graphics Forum 31 (2012).
    """
    areas = projected_areas(mesh, RADII, SPREAD)  # (r, k)
    counts = [(areas >= level).sum(axis=1) for level in LEVELS]
    values = CELL**3 * np.column_stack(counts).ravel()
    return Signature(values, kind="hapt", metric="histograms")


def projected_areas(mesh: TriangleMesh, radii: FloatArray, spread: float) -> FloatArray:
    """(r, k) the transform for radii (r,), in units of √A, at the centres of all k voxels inside a body."""
    framed = in_principal_frame(mesh)
    grid = _grid(framed, margin=int(np.ceil(spread * radii.max() / CELL)) + 1)
    inside = np.flatnonzero(interior(framed, grid))  # (k,)
    if not len(inside):
        raise DegenerateMeshError(
            f"hapt needs a body with an interior, got a surface that encloses no voxel of {CELL:g} √area: "
            "close its holes, or choose a descriptor of surfaces"
        )
    samples = _samples(framed)
    steps = np.array([grid.shape[1] * grid.shape[2], grid.shape[2], 1])
    transform = np.empty((len(radii), len(inside)))
    for row, radius in zip(transform, radii, strict=True):
        arrived = _arrived(*samples, radius, grid.origin, grid.cell, grid.shape)
        offsets, shares = _ball(spread * radius / CELL)
        row[:] = _gathered(arrived, inside, offsets @ steps, shares) / (4 * np.pi * radius**2)
    return transform


@njit(cache=True)
def _arrived(
    points: FloatArray,
    normals: FloatArray,
    areas: FloatArray,
    radius: float,
    origin: FloatArray,
    cell: float,
    shape: tuple[int, int, int],
) -> FloatArray:
    """The area that arrives in each voxel of a grid, in C order, from a surface that moves inwards."""
    arrived = np.zeros(shape[0] * shape[1] * shape[2])
    for point in range(len(points)):
        place, is_held = 0, True
        for axis in range(3):
            moved = points[point, axis] - radius * normals[point, axis]
            voxel = int(np.rint((moved - origin[axis]) / cell))
            is_held &= 0 <= voxel < shape[axis]
            place = place * shape[axis] + voxel
        if is_held:
            arrived[place] += areas[point]
    return arrived


@njit(cache=True)
def _gathered(
    arrived: FloatArray, inside: NDArray[np.intp], offsets: NDArray[np.intp], shares: FloatArray
) -> FloatArray:
    """(k,) sums of the areas round each of k voxels, each area with the share of its voxel in the ball."""
    gathered = np.zeros(len(inside))
    for row in range(len(inside)):
        for number in range(len(offsets)):
            gathered[row] += shares[number] * arrived[inside[row] + offsets[number]]
    return gathered


def _grid(mesh: TriangleMesh, margin: int) -> Grid:
    """A grid that is its own mirror image, because the directions of principal axes are arbitrary."""
    reach = np.ceil(np.abs(mesh.vertices).max(axis=0) / CELL) + margin  # (3,)
    if (n_voxels := np.prod(2 * reach + 1)) > MOST_VOXELS:
        raise DegenerateMeshError(
            f"hapt needs a body of at most {MOST_VOXELS:,} voxels of {CELL:g} √area, got {n_voxels:,.0f}: "
            "the body is too thin for its length; choose another descriptor"
        )
    n_x, n_y, n_z = (2 * reach + 1).astype(int).tolist()
    return Grid(-reach * CELL, CELL, (n_x, n_y, n_z))


def _samples(mesh: TriangleMesh) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points (p, 3) of a surface, their unit normals (p, 3), and the areas (p,) that they represent.

    These are the centres of the triangles into which each triangle is divided, at most `SPACING` wide.
    """
    corners = mesh.vertices[mesh.faces]  # (m, 3, 3)
    widest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)  # (m,)
    n_parts = np.maximum(1, np.ceil(widest / SPACING))  # (m,) of each edge
    if (n_points := (n_parts**2).sum()) > MOST_POINTS:
        raise DegenerateMeshError(
            f"hapt needs a surface of at most {MOST_POINTS:,} sample points, got {n_points:,.0f}: some "
            "triangles are too long; remesh it"
        )
    normals = _vertex_normals(mesh)[mesh.faces]  # (m, 3, 3)
    areas = mesh.face_areas
    parts = []
    for n in np.unique(n_parts):
        chosen = n_parts == n
        weights = _centres(int(n))  # (n², 3)
        points, directions = (
            np.einsum("sk,mkd->msd", weights, values[chosen]).reshape(-1, 3) for values in (corners, normals)
        )
        parts.append((points, directions, np.repeat(areas[chosen] / n**2, int(n**2))))
    points, directions, shares = (np.concatenate(column) for column in zip(*parts, strict=True))
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    return points, np.divide(directions, lengths, where=lengths > 0, out=directions), shares


def _vertex_normals(mesh: TriangleMesh) -> FloatArray:
    """(n, 3) means of the normals of the faces at each vertex by their angles, not of unit length."""
    # Such normals do not depend on how the surface is triangulated: G. Thürmer and C. Wüthrich, "Computing
    # vertex normals from polygonal facets", Journal of Graphics Tools 3 (1998).
    corners = mesh.vertices[mesh.faces]  # (m, 3, 3)
    after, before = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    height = np.linalg.norm(np.cross(after, before), axis=2)
    angles = np.arctan2(height, (after * before).sum(axis=2))  # (m, 3)
    unit = mesh.area_vectors / np.maximum(mesh.face_areas, np.finfo(float).tiny)[:, np.newaxis]
    weighted = angles[:, :, np.newaxis] * unit[:, np.newaxis]  # (m, 3, 3)
    vertices = mesh.faces.ravel()
    return np.column_stack(
        [np.bincount(vertices, weighted[:, :, axis].ravel(), len(mesh.vertices)) for axis in range(3)]
    )


def _centres(n: int) -> FloatArray:
    """(n², 3) barycentric coordinates of the centres of the triangles that n parts of each edge make."""
    corner = np.column_stack(np.divmod(np.arange(n * n), n))  # (n², 2)
    total = corner.sum(axis=1)
    two = np.concatenate([corner[total < n] + 1 / 3, corner[total < n - 1] + 2 / 3]) / n
    return np.column_stack([two, 1 - two.sum(axis=1)])


def _ball(radius: float) -> tuple[NDArray[np.intp], FloatArray]:
    """Offsets (b, 3) of the voxels in a ball, and their shares (b,) in it: less than 1 at its rim."""
    reach = int(np.ceil(radius))
    offsets = np.indices(3 * (2 * reach + 1,)).reshape(3, -1).T - reach
    shares = np.clip(radius + 0.5 - np.linalg.norm(offsets, axis=1), 0, 1)
    return offsets[shares > 0], shares[shares > 0]


HAPT = Descriptor(
    name="hapt",
    make=lambda shape, _: hapt(shape.mesh),
    needs=("mesh",),
    has_size=False,
    length=lambda _: len(RADII) * len(LEVELS),
    metric="histograms",
    spread=0.012,
)
