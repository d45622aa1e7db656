"""The axes of a camera in front of a body that stands upright."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import UPWARD, FloatArray, IntArray, area_vectors, unit_vectors
from pcretrieve.errors import OptionError

# (6, 3) the directions of the axes that are called `UPWARD`.
AXES: FloatArray = np.repeat(np.eye(3), 2, axis=0) * np.tile([[1.0], [-1.0]], (3, 1))

# Tie-breaker for shapes whose principal axes are not unique, such as a sphere: a bias towards the axes of the
# file. As a fraction of the total variance, and as a skewness, it is above rounding errors and not visible.
TIE = 1e-6

# The limbs of a person.
N_LIMBS = 4

# Limits of ways over the surface of a person, relative to the mean of the four from a hand to a foot: the
# shortest of these relative to the longest; from foot to foot; from hand to hand. Round their ends, to this
# distance, legs have more area than arms, but not as much more as of animals. Of 159 people in samples,
# simulated scans and TOSCA, 143 are found, and of 57 animals, hands and centaurs one.
LEAST_EQUAL = 0.89
FOOT_TO_FOOT = (0.79, 1.04)
HAND_TO_HAND = (0.64, 0.88)
END = 0.3
THICKEST = 1.6
FOOT = 0.15


# Places of girths of somebody who stands, as fractions of the height: where the hip is the largest and the
# waist the smallest girth, the chest, and how far below the crotch a thigh is.
HIP = (0.46, 0.48, 0.50, 0.52, 0.54)
WAIST = (0.58, 0.60, 0.62, 0.64, 0.66)
CHEST = 0.68
BELOW_CROTCH = 0.05

# Half of the width of a tape, as a fraction of the height.
TAPE = 0.005

# Somebody stands whose height is this share of the way over the skin from the feet to the head: .87 to .89 in
# samples, and .84 in a lunge; and whose feet are no farther from the ground than this fraction of the height.
UPRIGHT = 0.86
FEET = 0.04

# Arms hang whose way over the skin to the chest is at most so many times as long as it is high: 1.41 to 1.58
# in samples, and 1.70 with hands on the hips.
HANGING = 1.62

# Skin is of an arm whose way from the hand is longer than it is high by at most this fraction of the height:
# .07 is the largest of arms in samples, and .11 the smallest of the trunk, beside an armpit.
DETOUR = 0.09


def upward(axis: str | None) -> FloatArray | None:
    """(3,) the direction of an axis of a file, such as ``-y``; None for None."""
    if axis is None:
        return None
    if axis not in UPWARD:
        raise OptionError(f"up must be one of {', '.join(UPWARD)}, got {axis!r}")
    return np.asarray(AXES[UPWARD.index(axis)])


class Person(NamedTuple):
    """The feet and the hands of a person in any pose: (2,) vertices, and (2, n) ways over the surface."""

    feet: IntArray
    hands: IntArray
    from_feet: FloatArray
    from_hands: FloatArray

    def upwards(self, vertices: FloatArray) -> FloatArray:
        """(3,) the mean of the directions from the feet to the pelvis, and from the pelvis to the chest."""
        chest, pelvis = (
            vertices[ways.max(axis=0).argmin()]
            for ways in (self.from_hands, self.from_feet)
        )
        parts = np.stack([chest - pelvis, pelvis - vertices[self.feet].mean(axis=0)])
        return unit_vectors(unit_vectors(parts).sum(axis=0))

    def forwards(self, vertices: FloatArray) -> FloatArray:
        """(3,) from the middle of each foot to its end, which are the toes."""
        near = self.from_feet < FOOT * self.from_feet[0, self.feet[1]]  # (2, n)
        return np.asarray(
            sum(vertices[self.feet] - [vertices[one].mean(axis=0) for one in near])
        )


def person_of(vertices: FloatArray, faces: IntArray) -> Person | None:
    """A surface as that of a person: its four ends are two pairs, equally far from each other."""
    numbers, ways = _ends(vertices, faces)
    apart = ways[:, numbers]
    if not 0 < apart.max() < np.inf:
        return None  # a single point, or several parts
    pairings = (([0, 1], [2, 3]), ([0, 2], [1, 3]), ([0, 3], [1, 2]))
    pairs = min(
        pairings, key=lambda both: sum(float(apart[tuple(pair)]) for pair in both)
    )
    areas = np.linalg.norm(area_vectors(vertices, faces), axis=1)
    near = [ways[pair].min(axis=0)[faces[:, 0]] < END * apart.max() for pair in pairs]
    (arms, hands), (legs, feet) = sorted(
        zip([areas[one].sum() for one in near], pairs, strict=True)
    )
    across = apart[np.ix_(feet, hands)]
    foot_to_foot, hand_to_hand = (
        apart[tuple(pair)] / across.mean() for pair in (feet, hands)
    )
    if (
        across.min() < LEAST_EQUAL * across.max()
        or legs > THICKEST * arms
        or not FOOT_TO_FOOT[0] < foot_to_foot < FOOT_TO_FOOT[1]
        or not HAND_TO_HAND[0] < hand_to_hand < HAND_TO_HAND[1]
    ):
        return None
    return Person(numbers[feet], numbers[hands], ways[feet], ways[hands])


def _ends(vertices: FloatArray, faces: IntArray) -> tuple[IntArray, FloatArray]:
    """The (4,) ends of a body, from its middle, then from all before, the farthest; and ways from each."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    graph = csr_array((lengths, edges.T), shape=(len(vertices),) * 2)
    middle = np.linalg.norm(vertices - vertices.mean(axis=0), axis=1).argmin()
    far = dijkstra(graph, directed=False, indices=[middle])[0]
    ends: list[int] = []
    rows: list[FloatArray] = []
    for _ in range(N_LIMBS):
        ends.append(int(far.argmax()))
        rows.append(dijkstra(graph, directed=False, indices=ends[-1:])[0])
        far = np.minimum(far if len(rows) > 1 else np.inf, rows[-1])
    return np.array(ends, np.int32), np.stack(rows)


def body_axes(
    vertices: FloatArray, faces: IntArray, up: FloatArray | None = None
) -> FloatArray:
    """(3, 3) the axes of a camera in front of a surface of positive area, as from `principal_axes`.

    If up is not given, people are upright in any pose. People look ahead.
    """
    person = person_of(vertices, faces)
    if up is None and person is not None:
        up = person.upwards(vertices)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    areas = np.linalg.norm(area_vectors(vertices, faces), axis=1)  # (m,)
    # The midpoints of the edges, each with a third of the area, integrate quadratics over a triangle exactly.
    points = np.concatenate([(c + a) / 2, (a + b) / 2, (b + c) / 2])  # (3m, 3)
    axes = principal_axes(points, np.tile(areas, 3) / (3 * areas.sum()), up)
    turned = person is not None and person.forwards(vertices) @ axes[2] < 0
    return axes * [[-1.0], [1.0], [-1.0]] if turned else axes


def tape_measures(
    vertices: FloatArray, faces: IntArray, up: FloatArray | None = None
) -> dict[str, float]:
    """Height and girths of a person who stands with hanging arms, in their unit; nothing of other bodies.

    Without `up`, it is found from the body, within some degrees, which changes a height by up to 20 mm.
    """
    from scipy.spatial import ConvexHull

    person = person_of(vertices, faces)
    if person is None:
        return {}
    right, up, towards = body_axes(vertices, faces, up)
    along = vertices @ up
    height, along = np.ptp(along), (along - along.min()) / np.ptp(along)
    feet, hands = person.from_feet / height, person.from_hands / height
    over_skin = feet.mean(axis=0)[abs(hands[0] - hands[1]) < 0.2 * hands.max()].max()
    above_hands = along - along[person.hands, np.newaxis]  # (2, n)
    chest = hands.max(axis=0).argmin()
    hangs = hands[:, chest].sum() < HANGING * above_hands[:, chest].sum()
    if UPRIGHT * over_skin > 1 or along[person.feet].max() > FEET or not hangs:
        return {}
    flat = vertices @ np.stack([right, towards], axis=1)  # (n, 2)
    trunk = (hands > above_hands + DETOUR).all(axis=0)

    def girth(level: float, chosen: NDArray[np.bool_] = trunk) -> float:
        """A tape is not hollow: it follows the convex hull, whose border SciPy calls area."""
        return float(ConvexHull(flat[chosen & (abs(along - level) < TAPE)]).area)

    thigh = along[feet.max(axis=0).argmin()] - BELOW_CROTCH
    left, other = (trunk & (leg == feet.min(axis=0)) for leg in feet)
    return {
        "height": float(height),
        "chest": girth(CHEST),
        "waist": min(map(girth, WAIST)),
        "hip": max(map(girth, HIP)),
        "thigh": (girth(thigh, left) + girth(thigh, other)) / 2,
    }


def principal_axes(
    points: FloatArray, weights: FloatArray, up: FloatArray | None = None
) -> FloatArray:
    """The axes of a camera in front of a body, by the principal axes of weighted points.

    The direction of view is the axis of least variance, of those that are perpendicular to up. If up is not
    given, it is the more skewed of the other two, against its skewness: so a body stands on its legs.

    weights, up: (n,), with the sum 1, and (3,), of length 1.
    Returns (3, 3): orthonormal, right-handed rows: the directions to the right, upwards, and towards the
        camera; as near as possible to the axes x, y and z where the principal axes are not unique.
    """
    points = points - weights @ points
    variance = weights @ (points**2).sum(axis=1)
    points = points / np.sqrt(variance if variance > 0 else 1.0)  # total variance 1
    covariance = (weights[:, np.newaxis] * points).T @ points + TIE * np.diag(
        [1.0, 2.0, 0.0]
    )  # (3, 3)
    if up is None:
        towards, *others = np.linalg.eigh(covariance)[1].T
        middle, longest = ((_skewness(points, weights, axis), axis) for axis in others)
        skewness, up = middle if abs(middle[0]) > abs(longest[0]) + TIE else longest
        up = -up if skewness > TIE * up[1] else up
    else:
        level = np.eye(3) - np.outer(up, up)
        # The axis up gets more than the total variance, so that the first axis is perpendicular to it.
        towards = np.linalg.eigh(level @ covariance @ level + 2 * np.outer(up, up))[1][
            :, 0
        ]
    right = np.cross(up, towards)
    sides = (
        _skewness(points, weights, right) + TIE * right[0],
        _skewness(points, weights, towards) + TIE * towards[2],
    )
    if max(sides, key=abs) < 0:
        right, towards = -right, -towards
    return np.stack([right, up, towards])


def _skewness(points: FloatArray, weights: FloatArray, axis: FloatArray) -> float:
    along = points @ axis
    squares = along * along
    return float(weights @ (squares * along) / np.maximum(weights @ squares, TIE) ** 1.5)
