"""Contacts: places where two parts of a body touch, found by geodesic distances inside the body.

Two parts that touch, such as a calf folded against its thigh, do not always form a handle, so that the
topology of the voxels does not show the contact. But the points between them separate the two parts, and the
shortest path inside the body that avoids the points, through the knee, is long.

Sensors do not see the middle of a contact, so that the points between the parts have holes. But they see its
rim, where the two surfaces face each other across a narrow gap. The wall between the parts is continued from
the rim into the contact, in the plane of symmetry of the two surfaces.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import unit_vectors
from pcretrieve.errors import ReconstructionError
from pcretrieve.options import SurfaceOptions
from pcretrieve.points.voxels import Voxels, components, distances
from pcretrieve.values import FloatArray, Grid, Mask
from pcretrieve.values.compiled import compiled, inlined, inner

# Radius of the surfel, an oriented disk, that represents a point; in voxels.
DISK = 2.0

# Smallest magnitude of the component of a normal along an axis for its surfel to cross links along this axis.
LEAST_LEAN = 0.3

# Smallest difference of geodesic distances, in steps, by which two adjacent voxels belong to two parts that
# touch. Larger than the detour around the surfels at the rim of a fold, which extend two voxels beyond it.
DETOUR = 6

# Largest distance between two points that face each other across the gap at the rim of a contact, in voxels,
# and smallest cosine of the angle between one normal and the opposite of the other, and of the angle between
# their difference and the line from point to point.
RIM = 4.0
OPPOSITE = 0.3
ACROSS = 0.6

# Probes on the normal of a point at which another surface is looked for, in voxels, and the largest distance
# of a point from such a probe, relative to the distance of the probe.
PROBES = (2.0, 3.0)
FACED = 0.9

# Radius of the surfels that continue the wall inwards from a rim, in voxels, and the smallest difference of
# geodesic distances of two voxels that these surfels separate. It is larger than the detour around such a
# surfel that ends inside the body.
CONTINUED = 6.0
LONG_DETOUR = 14

# Largest number of voxels in contact layers, relative to the boundary voxels of the body. More of them are
# caused by noise, and all are then ignored.
MOST_CONTACTS = 0.08


@compiled()
def walls(
    at: FloatArray, normals: FloatArray, shape: tuple[int, int, int], radius: float = DISK
) -> Mask:
    """(3, a, b, c) mask: for each axis and voxel, whether the link to the next voxel crosses a surfel.

    at, normals: (n, 3) float64, positions of the surfels, in voxels, and unit normals of either sign.
    """
    walls = np.zeros((3, shape[0], shape[1], shape[2]), dtype=np.bool_)
    links = walls.reshape(3, -1)
    for i in range(len(at)):
        for axis in range(3):
            if abs(normals[i, axis]) >= LEAST_LEAN:
                _cross(links[axis], at[i], normals[i], axis, shape, radius)
    return walls


@inlined()
def _cross(
    links: Mask,
    at: FloatArray,
    normal: FloatArray,
    axis: int,
    shape: tuple[int, int, int],
    radius: float,
) -> None:
    """Mark the links along an axis that cross a surfel: those that meet its plane within the disk."""
    step = (shape[1] * shape[2], shape[2], 1)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    rise, slope = -normal[first] / normal[axis], -normal[second] / normal[axis]
    columns = _within(at[first], radius, shape[first])
    rows = _within(at[second], radius, shape[second])
    for a in range(columns[0], columns[1]):
        for b in range(rows[0], rows[1]):
            da, db = a - at[first], b - at[second]
            along = rise * da + slope * db
            c = int(np.floor(at[axis] + along))
            # Without branches, of which many would be mispredicted.
            meets = da * da + db * db + along * along <= radius * radius
            meets &= 0 <= c < shape[axis]
            c = min(max(c, 0), shape[axis] - 1)
            links[a * step[first] + b * step[second] + c * step[axis]] |= meets


@inner()
def _within(place: float, radius: float, n: int) -> tuple[int, int]:
    """The first of n voxels on a line within a radius of a place, and the one after the last."""
    return max(0, int(np.ceil(place - radius))), min(n, int(np.floor(place + radius)) + 1)


def rims(
    at: FloatArray, normals: FloatArray, to_points: Voxels
) -> tuple[FloatArray, FloatArray]:
    """Surfels half way between points that face each other across the narrow gap at the rim of a contact.

    at, normals: (n, 3) float64, positions of the points, in voxels, and unit normals out of the body.
    to_points: distance of each voxel to the nearest point; in voxels.
    Returns middles, directions: (k, 3) float64, positions and unit normals of the surfels; at most one in
        each voxel. They lie in the plane of symmetry of the two points and their normals.
    """
    from scipy.spatial import cKDTree

    faces = np.zeros(len(at), dtype=bool)
    most = np.array(to_points.shape) - 1
    for probe in PROBES:
        x, y, z = np.clip(np.rint(at + probe * normals).astype(np.intp), 0, most).T
        faces |= to_points[x, y, z] < FACED * probe
    at, normals = at[faces], normals[faces]
    if not len(at):
        return at, normals
    i, j = cKDTree(at).query_pairs(RIM, output_type="ndarray").T
    opposite = np.einsum("ij,ij->i", normals[i], normals[j]) < -OPPOSITE
    i, j = i[opposite], j[opposite]
    directions = unit_vectors(normals[i] - normals[j])  # (p, 3)
    lines = at[j] - at[i]
    across = np.einsum("ij,ij->i", lines, directions) > ACROSS * np.linalg.norm(
        lines, axis=1
    )
    middles = (at[i] + at[j])[across] / 2
    _, first = np.unique(np.floor(middles), axis=0, return_index=True)
    return middles[first], directions[across][first]


def contact_layer(inside: Mask, walls: Mask, continued: Mask, to_points: Voxels) -> Mask:
    """The voxels to be removed so that parts of a body that touch are separated.

    Geodesic distances are computed from the end of one limb along links that cross no surfel. A voxel is in
    the layer if its distance exceeds that of an adjacent voxel by `DETOUR`: it is a boundary voxel of the
    part that is farther from the limb. A voxel that is not reached is in the layer if two voxels around it
    differ as much in their distance. This is repeated with the surfels that continue the walls inwards from
    the rims of contacts, and with `LONG_DETOUR`.

    inside: voxels that may belong to the body; False on the border of the grid.
    walls, continued: (3, a, b, c) bool, the links that cross a surfel of a point, and one from `rims`.
    to_points: distance of each voxel to the nearest point; in voxels.
    Returns (a, b, c) bool: the voxels of the layer. All False if there are so many that noise is the cause.
    """
    middle = int((to_points * inside).argmax())
    found, n_boundary = _contacts(inside, _from_limb(inside, walls, middle), DETOUR)
    most = MOST_CONTACTS * n_boundary
    if found.sum() > most:
        return np.zeros_like(found)
    if continued.any():
        further, _ = _contacts(
            inside, _from_limb(inside, walls | continued, middle), LONG_DETOUR
        )
        further |= found
        found = further if further.sum() <= most else found
    return found


def _from_limb(inside: Mask, walls: Mask, middle: int) -> NDArray[np.int32]:
    """Geodesic distances from the end of the limb that is farthest from the middle of the body."""
    # The middle is not a suitable source: two legs that touch are at equal distances from it.
    return _away(inside, walls, int(_away(inside, walls, middle).argmax()))


@compiled()
def _away(inside: Mask, walls: Mask, source: int) -> NDArray[np.int32]:
    """Steps from a source to each voxel by breadth-first search that crosses no surfel; −1 elsewhere."""
    _, n_y, n_z = inside.shape
    allowed = inside.ravel()
    wall = (walls[0].ravel(), walls[1].ravel(), walls[2].ravel())
    step = (n_y * n_z, n_z, 1)
    away = np.full(allowed.size, -1, dtype=np.int32)
    queue = np.empty(allowed.size, dtype=np.int64)
    away[source] = 0
    queue[0] = source
    first, last = 0, 1
    while first < last:
        cell = queue[first]
        first += 1
        for axis in range(3):
            for side in range(2):
                other = cell + step[axis] if side else cell - step[axis]
                if (
                    away[other] >= 0
                    or not allowed[other]
                    or wall[axis][cell if side else other]
                ):
                    continue
                away[other] = away[cell] + 1
                queue[last] = other
                last += 1
    return away.reshape(inside.shape)


@compiled()
def _contacts(inside: Mask, away: NDArray[np.int32], detour: int) -> tuple[Mask, int]:
    """Voxels at which the distance jumps: to a 6-neighbour or, if not reached, around the voxel.

    And the number of boundary voxels: inside, and 18-adjacent to a voxel outside.
    """
    n_x, n_y, n_z = inside.shape
    found, n_boundary = np.zeros(inside.shape, dtype=np.bool_), 0
    for x in range(1, n_x - 1):
        for y in range(1, n_y - 1):
            for z in range(1, n_z - 1):
                if not inside[x, y, z]:
                    continue
                here = away[x, y, z]
                near, far, bare = 1 << 30, here, False
                for u in range(-1, 2):
                    for v in range(-1, 2):
                        for w in range(-1, 2):
                            bare |= (
                                abs(u) + abs(v) + abs(w) < 3
                                and not inside[x + u, y + v, z + w]
                            )
                            there = away[x + u, y + v, z + w]
                            if there < 0 or (here >= 0 and abs(u) + abs(v) + abs(w) > 1):
                                continue
                            near = min(near, there)
                            if here < 0:
                                far = max(far, there)
                found[x, y, z] = far - near >= detour
                n_boundary += bare
    return found, n_boundary


# Smallest number of voxels, and largest depth below the surface, of a groove: a component of a contact layer
# that no points face each other across, from within this distance; lengths in voxels.
LEAST_GROOVE = 22
SHALLOW = 2.5
FACED_WITHIN = 3.0


def without_grooves(
    layer: Mask, inside: Mask, at: FloatArray, normals: FloatArray, to_points: Voxels
) -> Mask:
    """A contact layer without the grooves that surfels cut into a body where it is concave.

    A surfel at a concave edge, such as that between a shaft and its flange, extends into the body beyond the
    edge, so that the shortest path round it is long. Where two parts touch, points face each other across the
    gap, or the layer is deep.

    at, normals, to_points: as in `rims`.
    """
    pieces, sizes = components(layer, corners=True)
    is_groove = sizes >= LEAST_GROOVE
    is_groove[0] = False
    if not is_groove.any():
        return layer
    from scipy.spatial import cKDTree

    cells = np.argwhere(is_groove[pieces])
    piece = pieces[tuple(cells.T)]
    is_groove[piece[inside[_around(cells, SHALLOW, inside.shape)].all(axis=1)]] = False
    cells = cells[is_groove[piece]]
    # Points farther away face each other across none of these; a voxel more, because places are rounded.
    nearby = np.zeros_like(inside)
    nearby[_around(cells, FACED_WITHIN + RIM / 2 + 1, inside.shape)] = True
    x, y, z = np.rint(at).astype(np.intp).T
    near = nearby[x, y, z]
    middles, _ = rims(at[near], normals[near], to_points)
    if len(middles):
        apart, _ = cKDTree(middles).query(cells, distance_upper_bound=FACED_WITHIN)
        is_groove[pieces[tuple(cells[np.isfinite(apart)].T)]] = False
    left: Mask = layer & ~is_groove[pieces]
    return left


def _around(
    cells: NDArray[np.intp], radius: float, shape: tuple[int, ...]
) -> tuple[NDArray[np.intp], ...]:
    """The indices, (k, o) along each axis, of the voxels within a radius of each of (k, 3) cells."""
    n = int(radius)
    offsets = np.indices((2 * n + 1,) * 3).reshape(3, -1).T - n
    offsets = offsets[(offsets**2).sum(axis=1) <= radius**2]
    places = cells[:, np.newaxis] + offsets
    return tuple(np.moveaxis(places.clip(0, np.subtract(shape, 1)), -1, 0))


# Smallest fraction of the points in a component for it to be connected to the body.
LEAST_PIECE = 0.002


def joined(
    inside: Mask,
    points: FloatArray,
    grid: Grid,
    options: SurfaceOptions,
    notes: list[str],
) -> tuple[Mask, NDArray[np.intp]]:
    """Connect the large components of a set of voxels, and fill its cavities.

    A component with at least `LEAST_PIECE` of the points is connected to the body by a cylinder of voxels if
    it is near enough; other components are removed.

    Returns body, bridges: the body, 6-connected and without cavities; and (j, 3) int, the voxels that were
        added to connect components.
    """
    nowhere = np.zeros((0, 3), dtype=np.intp)
    pieces, sizes = components(inside, corners=False)
    if len(sizes) == 1:
        return inside, nowhere
    support = _counted(pieces, grid.coordinates(points), len(sizes)) / len(points)
    sizes[0] = 0
    body = pieces == sizes.argmax()
    support[0] = support[sizes.argmax()] = 0
    bridges = []
    for piece in np.argsort(-support)[: int((support > LEAST_PIECE).sum())]:
        start, end, distance = _nearest_voxels(pieces == piece, body)
        gap = distance * grid.cell
        if gap > options.bridge * np.linalg.norm(np.ptp(points, axis=0)):
            if support[piece] > options.max_discarded:
                raise ReconstructionError(
                    f"the scan holds two bodies or more: a second piece has {support[piece]:.0%} of the "
                    "points; cut them apart, or raise surface.max_discarded"
                )
            notes.append(
                f"dropped a piece with {support[piece]:.1%} of the points, {gap:.3g} away"
            )
            continue
        thickness = float(distances(pieces != piece, np.inf).max())
        tube = _tube(start, end, radius=min(3.0, max(1.5, thickness)))
        bridges.append(tube[~body[tuple(tube.T)] & (pieces[tuple(tube.T)] != piece)])
        body |= pieces == piece
        body[tuple(tube.T)] = True
        notes.append(
            f"joined a piece with {support[piece]:.1%} of the points across a gap of {gap:.3g}"
        )
    del pieces  # before another large array is made
    hollow, sizes = components(~body, corners=True)
    solid = body if len(sizes) == 2 else hollow != hollow[0, 0, 0]
    return solid, np.concatenate([nowhere, *bridges])


def _nearest_voxels(
    piece: Mask, body: Mask
) -> tuple[NDArray[np.intp], NDArray[np.intp], float]:
    """The voxels of a piece and of the body that are nearest to each other, and their distance in voxels."""
    from scipy.ndimage import distance_transform_edt

    depth, nearest = distance_transform_edt(~body, return_indices=True)
    cells = np.argwhere(piece)
    start = cells[depth[tuple(cells.T)].argmin()]
    end = nearest[:, start[0], start[1], start[2]].astype(np.intp)
    return start, end, float(depth[tuple(start)])


def _counted(pieces: NDArray[np.int32], at: FloatArray, n: int) -> NDArray[np.intp]:
    """The number of points of each component: in its voxels or, if they are in none, adjacent to them."""
    cells = np.rint(at).astype(np.intp)
    piece = pieces[tuple(cells.T)]
    bare = cells[piece == 0]
    around = np.indices((3, 3, 3)).reshape(3, -1, 1) - 1  # (3, 27, 1)
    piece[piece == 0] = pieces[tuple(bare.T[:, None] + around)].max(axis=0)
    return np.bincount(piece, minlength=n)


def _tube(
    start: NDArray[np.intp], end: NDArray[np.intp], *, radius: float
) -> NDArray[np.intp]:
    """(k, 3) voxels at a distance of at most `radius` from the segment between two voxels; in voxels."""
    low = np.minimum(start, end) - int(radius) - 1
    box = (
        np.indices(np.abs(end - start) + 2 * int(radius) + 3).reshape(3, -1).T + low
    )  # (b, 3)
    along = (end - start).astype(np.float64)
    share = np.clip((box - start) @ along / max(along @ along, 1e-9), 0, 1)  # (b,)
    apart = np.linalg.norm(box - start - share[:, None] * along, axis=1)
    return np.asarray(box[apart <= radius], dtype=np.intp)
