"""How the points of a scan and its surface lie to each other: distances, and the holes between the points.

A `Fit` measures, and the checks judge: each value is computed once, when a check or a picture first asks
for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import grid_points
from pcretrieve.arrays.open3d import RayScene
from pcretrieve.points.density import local_spacings
from pcretrieve.points.neighbors import (
    SPACING_NEIGHBORS,
    Neighborhoods,
    nearest,
)
from pcretrieve.values import FloatArray, Mask, PointCloud, TriangleMesh, unit_vectors
from pcretrieve.values.topology import components

# Number of points of the raw scan by which its density is compared from place to place.
DENSITY_POINTS = 10_000

# Least distance between points, in median spacings, where densities are compared.
LEAST_APART = 0.01

# Distance to the nearest point beyond which a face was filled in, in median distances between nearest
# neighbours, and, where points are sparse, in spacings there. If points are distributed uniformly over a
# surface, their nearest neighbours are half a spacing apart, and the share of the surface beyond is 1e-6.
FILLED = 4
FILLED_OF_SPARSE = 2

# The same beyond which a face may close a cut limb or a hole.
BARE = 1.75
BARE_OF_SPARSE = 0.6

# Fraction of the surface that is nearer to a point than what "Gaps" measures.
COVERED = 0.95

# A hole is a patch of faces that are farther from all points than this, relative to the length of the body.
# It counts if the radius of the largest ball in it is the second length.
IN_HOLE = 0.012
LEAST_HOLE = 0.015

# Number of holes that are looked at, the largest first.
N_HOLES = 10

# Number of steps along the side of a face between places where a hole is measured. Faces are as long as a
# hundredth of a body, which a limit on holes must not depend on.
STEPS = 6

# What is nearer to the middle of a hole, in radii, belongs to it.
NEAR_HOLE = 2

# Number of faces in the middle of a hole whose light is measured.
N_MIDDLE = 16

# Number of rays for ambient occlusion, and the height above a face from which they are cast, relative to the
# diagonal: beyond single precision.
N_RAYS = 64
ABOVE = 1e-3

# Sensors see into the shade if points are hardly farther apart there than on all surface: by less than this
# factor. It is 1.17 to 2.2 where cameras stood on some sides, 1.03 at most where points are uniform.
SHADED = 1.1

# Number of faces that are compared, and the least number of them that are in the shade.
N_SHADES = 500
LEAST_SHADED = 5

# Cosine of the largest angle between directions that sensors see equally well.
FACING = 0.7

# Least share of the surface that tells whether sensors see the direction that it faces.
LEAST_FACING = 0.005

# Sensors do not see a direction if points are farther apart on all surface that faces it than on the rest, by
# this factor: 1.4 to 3 under a body on a turntable, hardly ever more than 1.15 where sensors stood on all
# sides.
UNSEEN = 1.2

# All sensors stood beside the body if the density of points, along some axis, is this share of the mean: .6
# to .88 on a turntable, and .88 or more where they stood on all sides.
BESIDE = 0.88

# How far the ends of the body along this axis reach, where hair is and soles are; relative to the length.
AT_END = 0.1

# Largest size of ends that sensors do not see, in hair or under feet, where no limb is missing; the largest
# area of what closes them, relative to the surface; and how far the body reaches beyond them, relative to the
# length, unless it is on a turntable: .09 and more beyond a leg that is cut. See docs/decisions.md, what
# sensors cannot see.
IN_HAIR = 0.03
SOLE = 0.02
LAST = 0.05

# An end is no cut limb if the cosine between its axis and the normals round it has a larger mean: it is 0
# round a cut limb, .35 and more round a crown without hair, 1 round a shallow hole.
TILTED = 0.35

# A face closes a cut limb only if the cosine between its normal and that of the nearest point is smaller: in
# a smooth hole these agree.
TURNED = 0.8

# Its least distance to the nearest point, in median spacings, and the least share of the light that reaches
# it, unlike the folds of a lap.
CLOSING = 1.9
OPEN_END = 0.65

# Least likeness of a rim to that of a limb: what a thin sheet has.
SHEET = 0.07

# Largest distance of faces to the middle of what closes one limb, relative to the diagonal.
NEAR_END = 0.045

# Number of places that may close a limb, the largest first.
N_ENDS = 10

Faces = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Hole:
    """A patch of the surface far from all points.

    faces: (k,) intp.
    middle: (3,) float64, the place farthest from all points.
    radius: its distance to the nearest point, relative to the length of the body.
    light: share of the light from a uniform sky that reaches the middle, from 0 to 1.
    is_expected: whether the sensors could not see it: a body on a turntable is seen neither from above nor
        from below.
    """

    faces: Faces
    middle: FloatArray
    radius: float
    light: float
    is_expected: bool


@dataclass(frozen=True, slots=True, eq=False)
class End:
    """Where the surface was closed across a limb.

    middle: (3,) float64.
    size: root of its area relative to that of the surface, weighted by the root of how flat the end is, and
        by how like its rim is to that of a limb.
    """

    middle: FloatArray
    size: float


@dataclass(frozen=True, eq=False)
class Fit:
    """How the points of a scan and its surface lie to each other; lengths are in the unit of the file.

    cloud: the filtered points, with normals if they were oriented.
    around: the neighbours of some of them, the places where distances are measured.
    mesh: the surface.
    scan: the points before they were thinned.
    base: (p, 3) float64, points of the base on which the body stands, where no points were measured.
    """

    cloud: PointCloud
    around: Neighborhoods
    mesh: TriangleMesh
    scan: PointCloud
    base: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))

    # --- lengths ----------------------------------------------------------------------------------------

    @cached_property
    def places(self) -> FloatArray:
        """(k, 3) some of the points, at regular steps."""
        return self.cloud.points[self.around.near[:, 0]]

    @cached_property
    def spacing(self) -> float:
        """Median distance from a point to its nearest neighbour."""
        return between(self.around)

    @cached_property
    def length(self) -> float:
        """Distance of two points that are about as far apart as any; the height of a person who stands.

        The diagonal of the box changes with the axes, and would make a hole of one scan larger than the same
        hole of another.
        """
        points = self.places
        end = points[np.linalg.norm(points - points.mean(axis=0), axis=1).argmax()]
        longest = 0.0
        for _ in range(3):  # to the farthest point and on
            apart = np.linalg.norm(points - end, axis=1)
            end, longest = points[apart.argmax()], float(apart.max())
        return longest

    # --- faces ------------------------------------------------------------------------------------------

    @cached_property
    def middles(self) -> FloatArray:
        """(m, 3) middles of the faces."""
        return np.ascontiguousarray(self.mesh.corners.sum(axis=1).T / 3)

    @cached_property
    def areas(self) -> FloatArray:
        """(m,) areas of the faces."""
        return self.mesh.face_areas

    @cached_property
    def normals(self) -> FloatArray:
        """(m, 3) unit normals of the faces; 0 where they have no area."""
        areas = self.areas[:, np.newaxis]
        return self.mesh.area_vectors / np.where(areas > 0, areas, 1)

    @cached_property
    def to_points(self) -> tuple[FloatArray, Faces]:
        """(m,) distance of each face to the nearest point, and (m,) the number of this point."""
        distance, number = nearest(self.cloud.points, self.middles, 1)
        return distance[:, 0], number[:, 0]

    @cached_property
    def local_spacing(self) -> FloatArray:
        """(m,) spacing of the points beside each face that may be bare; 0 at others."""
        distance, near = self.to_points
        found, some = np.zeros(len(distance)), distance > BARE * self.spacing
        around = nearest(
            self.cloud.points, self.cloud.points[near[some]], SPACING_NEIGHBORS + 1
        )
        found[some] = local_spacings(Neighborhoods(*around))
        return found

    @cached_property
    def filled(self) -> Mask:
        """(m,) faces without a point nearby."""
        farthest = np.maximum(
            FILLED * self.spacing, FILLED_OF_SPARSE * self.local_spacing
        )
        return self.to_points[0] > farthest

    @cached_property
    def bare(self) -> Mask:
        """(m,) faces that may close a cut limb or a hole."""
        farthest = np.maximum(BARE * self.spacing, BARE_OF_SPARSE * self.local_spacing)
        return self.to_points[0] > farthest

    @cached_property
    def on_base(self) -> Mask:
        """(m,) filled faces that are nearer to the base than to a point."""
        found = self.filled.copy()
        if not len(self.base):
            return np.zeros_like(found)
        to_base = nearest(self.base, self.middles[found], 1)[0][:, 0]
        found[found] = to_base < self.to_points[0][found]
        return np.asarray(found)

    def share(self, faces: Mask | Faces) -> float:
        """The area of some faces relative to the whole."""
        return float(self.areas[faces].sum() / self.areas.sum())

    # --- points and surface -----------------------------------------------------------------------------

    @cached_property
    def gap(self) -> float:
        """Distance to the nearest point that `COVERED` of the surface do not exceed; the base is left out."""
        distance = np.where(self.on_base, 0, self.to_points[0])
        (covered,) = _quantiles(
            distance, np.where(self.on_base, 0, self.areas), (COVERED,)
        )
        return float(covered)

    @cached_property
    def to_surface(self) -> FloatArray:
        """(k,) distances of `places` to the surface."""
        # Open3D computes them in single precision, so the points are moved near the origin.
        scene = RayScene(self.mesh.vertices - self.places.mean(axis=0), self.mesh.faces)
        return scene.distance(self.places - self.places.mean(axis=0))

    @cached_property
    def _beside(self) -> tuple[FloatArray, FloatArray]:
        """(m,) spacing of some points of the scan beside each face, and (m,) distance to the nearest one."""
        step = max(1, len(self.scan.points) // DENSITY_POINTS)
        points = np.ascontiguousarray(self.scan.points[::step])
        distance, near = nearest(points, self.middles, 1)
        beside, number = np.unique(near, return_inverse=True)
        around = nearest(points, points[beside], min(SPACING_NEIGHBORS + 1, len(points)))
        return local_spacings(Neighborhoods(*around))[number.ravel()], distance[:, 0]

    @cached_property
    def apart(self) -> FloatArray:
        """(m,) how far some points of the scan are apart at each face, which may lie in a hole."""
        return np.maximum(*self._beside).clip(min=LEAST_APART * self.spacing)

    @cached_property
    def unevenness(self) -> float:
        """Spacing of the scan that three quarters of the surface do not exceed, relative to one quarter."""
        low, high = _quantiles(self._beside[0], self.areas, (0.25, 0.75))
        return float(high / low) if low > 0 else 1.0

    # --- holes ------------------------------------------------------------------------------------------

    @cached_property
    def _sky(self) -> RayScene:
        """The surface with points, which hides folds; dents that close a hole hide nothing."""
        seen = self.mesh.faces[~self.bare]
        return RayScene(self.mesh.vertices - self.places.mean(axis=0), seen)

    def light(self, faces: Faces) -> FloatArray:
        """(k,) shares of the light from a uniform sky that reach faces: 1 − the ambient occlusion."""
        normals = self.normals[faces]
        origins = self.middles[faces] - self.places.mean(axis=0)
        origins = origins + ABOVE * self.cloud.diagonal * normals
        rays = unit_vectors(np.random.default_rng(0).standard_normal((N_RAYS, 3)))
        cosines = normals @ rays.T  # (k, r)
        directions = np.sign(cosines)[:, :, np.newaxis] * rays
        reached = self._sky.cast(
            np.repeat(origins, N_RAYS, axis=0), directions.reshape(-1, 3)
        )[0]
        weights = np.abs(cosines)
        is_free = np.isinf(reached).reshape(weights.shape)
        return np.asarray((weights * is_free).sum(axis=1) / weights.sum(axis=1))

    @cached_property
    def far(self) -> Faces:
        """Faces in holes of any size."""
        far = np.maximum(IN_HOLE * self.length, BARE * self.spacing)
        return np.flatnonzero((self.to_points[0] > far) & (self.areas > 0))

    @cached_property
    def _far_parts(self) -> list[Faces]:
        """The connected components of `far`, in order of descending area."""
        return parts(self.mesh, self.far)

    @cached_property
    def _hole_of(self) -> Faces:
        """(m,) number of the component of `far` in which each face is; -1 for others."""
        found = np.full(len(self.areas), -1)
        for number, faces in enumerate(self._far_parts):
            found[faces] = number
        return found

    @cached_property
    def holes(self) -> tuple[Hole, ...]:
        """The large holes of the scan, in order of descending area."""
        patches = self._far_parts[:N_HOLES]
        if not patches:
            return ()
        corners = [self.mesh.vertices[self.mesh.faces[faces]] for faces in patches]
        inner = [grid_points(each, STEPS) for each in corners]
        apart = nearest(self.cloud.points, np.concatenate(inner), 1)[0][:, 0]
        large = []
        for faces, places, distance in zip(
            patches, inner, _split(apart, inner), strict=True
        ):
            radius = float(distance.max() / self.length)
            if radius >= LEAST_HOLE:
                large.append((faces, places[distance.argmax()], radius))
        if not large:
            return ()
        deepest = [
            faces[np.argsort(-self.to_points[0][faces])[:N_MIDDLE]]
            for faces, _, _ in large
        ]
        lights = _split(self.light(np.concatenate(deepest)), deepest)
        return tuple(
            Hole(
                faces,
                middle,
                radius,
                float(np.average(light, weights=self.areas[seen])),
                self._is_expected(faces, middle, radius),
            )
            for (faces, middle, radius), seen, light in zip(
                large, deepest, lights, strict=True
            )
        )

    def _is_expected(self, faces: Faces, middle: FloatArray, radius: float) -> bool:
        """Whether the sensors could not see into a hole, whose radius is relative to the length."""
        reach = NEAR_HOLE * radius * self.length
        return self.is_at_end(middle) or self.is_unseen(faces, middle, reach)

    @cached_property
    def _shades(self) -> tuple[Faces, FloatArray]:
        """Some faces outside of holes, by their area, and the light that reaches them."""
        near = np.flatnonzero(self._hole_of < 0)
        shares = self.areas[near] / self.areas[near].sum()
        some = np.random.default_rng(0).choice(near, N_SHADES, p=shares)
        return some, self.light(some)

    def sees_shades(self, light: float) -> bool:
        """Whether points lie as densely as elsewhere where less than this light reaches the surface."""
        faces, lights = self._shades
        apart = self.apart[faces]
        is_shaded = lights < light
        if is_shaded.sum() < LEAST_SHADED:
            return False
        return bool(np.median(apart[is_shaded]) < SHADED * np.median(apart))

    def axis(self, faces: Faces) -> FloatArray:
        """(3,) the unit vector along the sum of the area vectors of some faces; 0 if that is."""
        axis = self.areas[faces] @ self.normals[faces]
        return np.asarray(
            axis / max(float(np.linalg.norm(axis)), np.finfo(np.float64).tiny)
        )

    def is_unseen(self, faces: Faces, middle: FloatArray, radius: float) -> bool:
        """Whether points are far apart on all surface that faces the way some faces do.

        The holes in which these faces lie do not count, nor what is nearer to their middle than the radius.
        """
        own = np.isin(self._hole_of, self._hole_of[faces]) & (self._hole_of >= 0)
        elsewhere = ~own & (np.linalg.norm(self.middles - middle, axis=1) > radius)
        facing = elsewhere & (self.normals @ self.axis(faces) > FACING)
        if self.share(facing) < LEAST_FACING:
            return False
        return self._median_apart(facing) > UNSEEN * self._median_apart(elsewhere)

    @cached_property
    def _by_apart(self) -> Faces:
        """All faces in order of ascending `apart`."""
        return np.argsort(self.apart)

    def _median_apart(self, faces: Mask) -> float:
        """How far points are apart on some faces, in the median of their area."""
        order = self._by_apart[faces[self._by_apart]]
        (median,) = _quantiles(self.apart, self.areas, (0.5,), order)
        return float(median)

    @cached_property
    def _blind_axis(self) -> FloatArray | None:
        """(3,) the direction along which no sensor looked, if all stood beside the body.

        Second moments of the normals, weighted by the density of points and by the area alone, have the
        smallest ratio along it. Holes do not count, so that one cut limb makes no axis.
        """
        from scipy.linalg import eigh

        near = self._hole_of < 0
        normals, areas = self.normals[near], self.areas[near]
        weights = areas / self.apart[near] ** 2
        seen = (normals * weights[:, np.newaxis]).T @ normals / weights.sum()
        there = (normals * areas[:, np.newaxis]).T @ normals / areas.sum()
        ratios, axes = eigh(seen, there + np.finfo(np.float64).eps * np.eye(3))
        return axes[:, 0] / np.linalg.norm(axes[:, 0]) if ratios[0] < BESIDE else None

    def is_at_end(self, place: FloatArray) -> bool:
        """Whether a place is at an end of the body that sensors beside it see badly: a crown, or a sole."""
        if self._blind_axis is None:
            return False
        along = (self.places - place) @ self._blind_axis
        return bool(min(along.max(), -along.min()) < AT_END * self.length)

    @cached_property
    def ends(self) -> tuple[End, ...]:
        """Where the surface may have been closed across limbs; none of points without normals."""
        if self.cloud.normals is None:
            return ()
        far, _, is_closing = self._closing
        caps = parts(self.mesh, far[is_closing])[:N_ENDS]
        found = [end for cap in caps if (end := self._end(cap)) is not None]
        limbs: list[End] = []
        for end in sorted(found, key=lambda one: -one.size):
            # One cut may be closed in several pieces.
            if all(
                np.linalg.norm(limb.middle - end.middle) > self._near_end
                for limb in limbs
            ):
                limbs.append(end)
        return tuple(limbs)

    @cached_property
    def _near_end(self) -> float:
        """Within which distance faces close one limb."""
        return NEAR_END * self.cloud.diagonal

    @cached_property
    def _closing(self) -> tuple[Faces, Mask, Mask]:
        """Faces (k,) without points; whether each is turned away from the nearest one, and closes a limb."""
        normals = np.asarray(self.cloud.normals)
        distance, near = self.to_points
        far = np.flatnonzero(self.bare & (self.areas > 0) & ~self.on_base)
        is_turned = np.einsum("ij,ij->i", self.normals[far], normals[near[far]]) < TURNED
        is_closing = is_turned & (distance[far] > CLOSING * self.spacing)
        is_closing[is_closing] = self.light(far[is_closing]) > OPEN_END
        return far, is_turned, is_closing

    def _end(self, cap: Faces) -> End | None:
        """The end of the limb that connected faces may close; None if they close no limb."""
        far, is_turned, is_closing = self._closing
        middle = np.average(self.middles[cap], axis=0, weights=self.areas[cap])
        apart = np.linalg.norm(self.middles[far] - middle, axis=1)
        is_near = apart < self._near_end
        faces = far[is_near & is_turned]
        if not len(faces):
            return None
        axis = self.axis(faces)
        rim = np.unique(self.to_points[1][far[is_near]])
        normals = np.asarray(self.cloud.normals)[rim]
        if (normals @ axis).mean() > TILTED:
            return None
        middle = np.average(self.middles[faces], axis=0, weights=self.areas[faces])
        offsets = self.cloud.points[rim] - middle
        likeness = max(rim_of_limb(normals, offsets, axis), SHEET)
        closing = far[is_near & is_closing]
        area = np.linalg.norm(self.areas[closing] @ self.normals[closing])
        flatness = area / self.areas[far[is_near]].sum()
        size = likeness * np.sqrt(flatness * area / self.areas.sum())
        is_small = size < IN_HAIR and self.share(cap) < SOLE
        return None if is_small and self._is_hidden(faces, middle) else End(middle, size)

    def _is_hidden(self, faces: Faces, middle: FloatArray) -> bool:
        """Whether faces end the body where sensors see badly: in hair beside a turntable, or under feet."""
        if self._blind_axis is not None:
            return self.is_at_end(middle)
        reach = ((self.places - middle) @ self.axis(faces)).max()
        is_last = bool(reach < LAST * self.length)
        return is_last and self.is_unseen(faces, middle, self._near_end)


def between(around: Neighborhoods) -> float:
    """Median distance from a point to its nearest neighbour."""
    return float(np.median(around.distance[:, 1]))


def _quantiles(
    values: FloatArray,
    weights: FloatArray,
    shares: Sequence[float],
    order: Faces | None = None,
) -> FloatArray:
    """(q,) values that these shares of the weights do not exceed.

    order: the numbers of the values that count, in ascending order of these; by default, all.
    """
    order = np.argsort(values) if order is None else order
    summed = np.cumsum(weights[order])
    at = np.searchsorted(summed, np.multiply(shares, summed[-1]))
    return np.asarray(values[order[at.clip(max=len(order) - 1)]])


def _split(values: FloatArray, parts: Sequence[NDArray[Any]]) -> list[FloatArray]:
    """The values of each part of what was measured at once."""
    return np.split(values, np.cumsum([len(part) for part in parts], dtype=np.intp)[:-1])


def parts(mesh: TriangleMesh, faces: Faces) -> list[Faces]:
    """The connected components of some faces, in order of descending area."""
    if not len(faces):
        return []
    label = components(TriangleMesh(mesh.vertices, mesh.faces[faces]))
    return [faces[label == number] for number in range(label.max() + 1)]


def rim_of_limb(normals: FloatArray, offsets: FloatArray, axis: FloatArray) -> float:
    """How like points, by normals and offsets (r, 3) from their middle, are to those round a limb cut off.

    They lie on all sides of its axis, and so do their normals, which are perpendicular to it: twice the
    second eigenvalue of the covariance of such directions is 1, and 0 for those of folds and thin sheets.
    Of the normals its root counts, because it is small if the limb is not round.
    """
    both = [_across(directions, axis) for directions in (normals, offsets)]
    both[1] = unit_vectors(both[1])
    spread = np.linalg.eigvalsh([2 * np.cov(across.T, bias=True) for across in both])[
        :, 1
    ].clip(0)
    return float(np.sqrt(spread[0]) * spread[1] * (1 - np.abs(normals @ axis).mean()))


def _across(directions: FloatArray, axis: FloatArray) -> FloatArray:
    """(r, 3) vectors without their part along a unit vector."""
    return directions - np.outer(directions @ axis, axis)
