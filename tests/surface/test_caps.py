"""Which holes are capped, and which caps are a base: drawn cases just within and just beyond each limit."""

from __future__ import annotations

import numpy as np
import pytest
import shapes

from pcretrieve.arrays import vertex_normals
from pcretrieve.surface.caps import (
    DEEP,
    FARTHEST_GAP,
    NO_CAP,
    Capped,
    _ends,
    _on_points,
    base_of,
    capped,
    ends_a_part,
    limbs_continued,
    outwards_at_rims,
    slope_of,
)
from pcretrieve.surface.field import normals_of
from pcretrieve.values import FloatArray, PointCloud, Step, TriangleMesh, unit_vectors

N = 11  # vertices of a side of the sheet

DOWN = np.array([0.0, 0.0, -1.0])


def capped_faces(ring: float, middle: float, spacing: float = 0.001) -> int:
    """The number of faces of caps of a square sheet, of which nine vertices are far from all points.

    ring, middle: distances from the points of the middle vertex and of the eight round it; as spacing,
        relative to the diagonal.
    """
    number = np.arange(N * N).reshape(N, N)
    places = np.stack(np.meshgrid(*[np.linspace(0, 1, N)] * 2, indexing="ij"), axis=-1)
    vertices = np.append(places.reshape(-1, 2), np.zeros((N * N, 1)), axis=1)
    a, b, c, d = (
        part.ravel()
        for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    )
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    # Each vertex is nearest to its own point, which is above it.
    height = np.zeros((N, N))
    height[4:7, 4:7] = ring
    height[5, 5] = middle
    points = vertices + np.sqrt(2) * height.reshape(-1, 1) * [0, 0, 1]
    cloud = PointCloud(points, normals=np.tile([0.0, 0.0, 1.0], (len(points), 1)))
    assert cloud.diagonal == pytest.approx(np.sqrt(2), rel=2e-3)
    found = capped(
        TriangleMesh(vertices, faces.astype(np.int32)),
        cloud,
        spacing=spacing * np.sqrt(2),
    )
    return int((found.cap != NO_CAP).sum())


# Faces round one vertex, and round the nine of a square.
ONE, NINE = 6, 30


def test_a_hole_is_capped_from_nearly_a_fiftieth_of_the_diagonal() -> None:
    assert [capped_faces(0.015, middle) for middle in (0.0175, 0.0185)] == [0, NINE]


def test_a_hole_begins_a_80th_of_the_diagonal_or_two_spacings_from_the_points() -> None:
    assert [capped_faces(ring, 0.04) for ring in (0.0115, 0.0125)] == [ONE, NINE]
    assert [capped_faces(ring, 0.04, spacing=0.01) for ring in (0.0195, 0.0205)] == [
        ONE,
        NINE,
    ]


def test_of_rim_vertices_beside_one_point_the_nearest_moves_there() -> None:
    """Both would make faces without area, which no patch can be faired with."""
    vertices = np.array([[0.2, 0, 0], [0, 0.1, 0], [1, 0.2, 0], [5.0, 0, 0]])
    cloud = PointCloud(np.array([[0.0, 0, 0], [1, 0, 0], [5, 5, 0]]))
    is_rim, near = np.array([True, True, True, False]), np.array([0, 0, 1, 2])
    moved = _on_points(vertices, is_rim, cloud, near)
    np.testing.assert_array_equal(moved, [[0.2, 0, 0], [0, 0, 0], [1, 0, 0], [5, 0, 0]])


def seat(
    slope: float = 0.0, tilt: float = 0.0, *, up: FloatArray | None = None, **cloud: float
) -> list[int]:
    """The numbers of the caps of a base: of a square pyramid, 0, and of a small triangle, 1.

    slope: of the sides of the pyramid, whose apex is in the body; tilt: of the triangle; angles.
    """
    corners = 0.4 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    apex = [[0, 0, 0.4 * np.tan(slope)]]
    across = 0.1 * np.array([[0, 1, 0], [np.cos(tilt), 0, np.sin(tilt)], [0, -1, 0]])
    across[:, 2] += 0.5
    vertices = np.concatenate([corners, apex, across])
    faces = [[1, 0, 4], [2, 1, 4], [3, 2, 4], [0, 3, 4], [5, 6, 7]]
    surface = TriangleMesh(vertices, np.array(faces, dtype=np.int32))
    assert (surface.area_vectors @ DOWN > 0).all()
    caps = np.array([0, 0, 0, 0, 1])
    found = base_of(surface, caps, np.ones(5, dtype=np.bool_), body(**cloud, up=up))
    return sorted({int(number) for number in caps[found]})


def body(
    *,
    beneath: float = 0.0,
    depth: float = 0.2,
    aside: float = 0.0,
    up: FloatArray | None = None,
) -> PointCloud:
    """A thousand points above a seat in the plane z = 0, but for a share of them.

    depth: of that share; relative to the diagonal. aside: how far the mean of the points is along x.
    """
    points = np.random.default_rng(0).uniform([-1, -1, 0.2], [1, 1, 2.0], size=(1000, 3))
    diagonal = np.sqrt(4 + 4 + 9)
    points[: round(1000 * beneath), 2] = -depth * diagonal
    points[:, :2] -= points[:, :2].mean(axis=0)
    points[:, 0] = points[:, 0] / 10 + aside
    # The corners of the box.
    points[-2:] = [[-1, -1, -1], [1, 1, 2]]
    ground = (
        {}
        if up is None
        else dict(zip(("up_x", "up_y", "up_z"), up.tolist(), strict=True))
    )
    cloud = PointCloud(points, provenance=(Step("crop", 0.0, ground),))
    assert cloud.diagonal == pytest.approx(diagonal)
    return cloud


def test_a_cap_is_flat_if_seven_tenths_of_its_area_face_one_way() -> None:
    """The area of a pyramid's base is the cosine of the slope of its sides, times their area."""
    assert [seat(np.arccos(flat)) for flat in (1.0, 0.71, 0.69)] == [[0, 1], [0, 1], [1]]


def test_caps_of_a_base_are_parallel_up_to_a_cosine_of_nine_tenths() -> None:
    assert [seat(0.0, np.arccos(cosine)) for cosine in (1.0, 0.91, 0.89)] == [
        [0, 1],
        [0, 1],
        [0],
    ]


def test_a_body_stands_if_three_tenths_of_its_points_are_beneath() -> None:
    """As the lower legs of somebody who sits, which must not be more."""
    assert [seat(beneath=share) for share in (0.0, 0.29, 0.31)] == [[0, 1], [0, 1], []]
    # What is known is not asked: the ground was removed from the scan.
    assert seat(beneath=0.31, up=-DOWN) == [0, 1]


def test_a_body_without_ends_has_no_base_though_its_ground_is_known() -> None:
    surface, none = TriangleMesh(np.eye(3), np.array([[0, 1, 2]])), np.array([NO_CAP])
    assert not base_of(surface, none, none != NO_CAP, body(up=-DOWN)).any()


def test_points_within_a_fiftieth_of_the_diagonal_touch_the_ground() -> None:
    for depth, stands in ((0.0195, True), (0.0205, False)):
        assert seat(beneath=0.5, depth=depth) == ([0, 1] if stands else [])


def test_a_body_stands_if_its_mean_is_above_its_base() -> None:
    assert [seat(aside=aside) for aside in (0.39, 0.41)] == [[0, 1], []]


def is_end(tilt: float, steepness: float) -> bool:
    """Whether a body of revolution ends in a hole: the cosine of its normals at the rim, and its growth."""
    angle, along = np.meshgrid(np.linspace(0, 2 * np.pi, 60), np.linspace(-1, 0, 21))
    cosine = tilt + steepness * along
    around = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    normals = np.concatenate(
        [np.sqrt(1 - cosine**2)[..., np.newaxis] * around, cosine[..., np.newaxis]],
        axis=-1,
    )
    points = np.concatenate([around, along[..., np.newaxis]], axis=-1).reshape(-1, 3)
    rim = points[np.isclose(points[:, 2], 0)]
    return ends_a_part(
        *slope_of(rim, np.array([0.0, 0.0, 1.0]), points, normals.reshape(-1, 3))
    )


def test_normals_that_the_flood_fill_turned_count_as_the_others() -> None:
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 60), np.linspace(-0.9, 0.0, 30))
    width = np.sqrt(1 - height**2)
    points = np.stack(
        [width * np.cos(angle), width * np.sin(angle), height], axis=-1
    ).reshape(-1, 3)
    rim, up = points[points[:, 2] == 0], np.array([0.0, 0.0, 1.0])
    turned = np.where(points[:, 2:] > -0.3, -points, points)
    assert slope_of(rim, up, points, turned) == slope_of(rim, up, points, points)


@pytest.mark.parametrize(("length", "is_mended"), [(3.0, True), (1.0, False)])
def test_normals_round_a_deep_hole_point_away_from_its_axis(
    length: float, is_mended: bool
) -> None:
    """But not if the hole is as deep as the body, as that of a face: there, they may face the hole."""
    whole = shapes.ellipsoid((1, 1, length), subdivisions=4)
    in_hole = whole.vertices[:, 2] > 0
    closed = np.where(in_hole[:, np.newaxis], whole.vertices * [1, 1, 0], whole.vertices)
    cap = np.where(in_hole[whole.faces].any(axis=1), 0, NO_CAP)
    found = Capped(TriangleMesh(closed, whole.faces), cap, cap > 0)
    points = whole.vertices[~in_hole]
    outwards = unit_vectors(points / np.square([1, 1, length]))
    turned = np.where(points[:, 2:] > -0.3 * length, -outwards, outwards)
    normals = normals_of(outwards_at_rims(found, PointCloud(points, normals=turned)))
    assert np.array_equal(normals, outwards if is_mended else turned)


def two_legs() -> tuple[FloatArray, FloatArray]:
    """Points and normals of two tubes along z, 1 to the left and to the right of it."""
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 60), np.linspace(-1, 2, 61))
    normals = np.stack(
        [np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1
    ).reshape(-1, 3)
    leg = 0.5 * normals + np.outer(height.ravel(), [0, 0, 1])
    aside = np.array([1, 0, 0])
    return np.concatenate([leg - aside, leg + aside]), np.tile(normals, (2, 1))


RIM_BETWEEN_LEGS = np.array([[0.5, 0, 0], [-0.5, 0, 0], [0, 0.5, 0], [0, -0.5, 0]])


def test_a_hole_between_two_legs_ends_no_part() -> None:
    # Their normals face the axis of the hole, as if the flood fill had turned them.
    points, normals = two_legs()
    x, z = np.meshgrid(np.linspace(-1, 1, 61), np.linspace(0, 0.3, 11))
    skin = np.stack([x, np.full_like(x, 0.5), z], axis=-1).reshape(-1, 3)
    points = np.concatenate([points, skin, skin * [1, -1, 1]])
    facing = np.tile([[0.0, 1, 0], [0, -1, 0]], (1, skin.shape[0])).reshape(-1, 3)
    found = slope_of(
        RIM_BETWEEN_LEGS, np.array([0, 0, 1.0]), points, np.concatenate([normals, facing])
    )
    assert not ends_a_part(*found)
    assert found[0] > DEEP, "it becomes no dome"


def test_nor_does_a_gap_between_two_parts_where_the_flood_fill_turned_normals() -> None:
    points, normals = two_legs()
    turned = normals * np.sign(points[:, :1] * normals[:, :1] + 1e-9)  # away from the gap
    found = slope_of(RIM_BETWEEN_LEGS, np.array([0, 0, 1.0]), points, turned)
    assert not ends_a_part(*found)


def test_a_tube_ends_in_its_hole_and_a_ball_does_not() -> None:
    assert is_end(tilt=0, steepness=0)
    assert is_end(tilt=-0.2, steepness=0), "a neck, below which the shoulders face up"
    assert not is_end(tilt=0.7, steepness=0.6), "the crown"
    assert not is_end(tilt=0, steepness=0.8), "a ball, cut at its widest place"


def test_a_limb_ends_up_to_a_quarter_of_tilt_and_of_steepness() -> None:
    # Points in a band below the rim are at it, where the tilt is .15 steepnesses less in the mean.
    assert [is_end(tilt=tilt, steepness=0) for tilt in (0.24, 0.26)] == [True, False]
    assert [is_end(tilt=0, steepness=growth) for growth in (0.24, 0.26)] == [True, False]


# --- limbs with a gap -------------------------------------------------------------------------------------


def limb(*, gap: float, turned: bool = False) -> PointCloud:
    """Points of a tube along z, of the radius .1 and the length 2, with a gap in its middle.

    turned: whether normals at the gap point inwards.
    """
    n = 20_000
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(n)
    along = (2 * np.arange(n) + 1) / n - 1
    around = np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], axis=1)
    points = 0.1 * around + np.outer(along, [0, 0, 1])
    sign = np.where(turned & (np.abs(along) < gap / 2 + 0.04), -1, 1)
    kept = np.abs(along) >= gap / 2
    return PointCloud(points[kept], normals=(sign[:, np.newaxis] * around)[kept])


@pytest.mark.parametrize("turned", [False, True])
def test_a_limb_goes_on_across_a_gap(turned: bool) -> None:
    cloud = limb(gap=0.4, turned=turned)
    whole = limbs_continued(cloud, 0.008)
    made = whole.points[len(cloud.points) :]
    assert np.ptp(made[:, 2]) == pytest.approx(0.4, abs=0.05)
    np.testing.assert_allclose(np.linalg.norm(made[:, :2], axis=1), 0.1, atol=0.01)
    assert (normals_of(whole) * whole.points)[:, :2].sum(axis=1).min() > 0


def test_ends_that_face_away_from_each_other_are_not_joined() -> None:
    cloud = limb(gap=0.0)
    assert limbs_continued(cloud, 0.008) is cloud


def test_two_ends_of_one_piece_are_not_joined() -> None:
    """As the hands of a person who holds them towards each other: a ring, all but .9 of its angle."""
    straight = limb(gap=0.0)
    x, y, z = straight.points.T
    angle, reach = (np.pi - 0.45) * z, 0.4 + x
    ring = np.column_stack([reach * np.cos(angle), reach * np.sin(angle), y])
    away = ring - 0.4 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    cloud = PointCloud(ring, normals=10 * away)
    one, other = _ends(cloud, 0.008)
    assert one.gap(other) == np.inf
    assert one.gap(other._replace(piece=1 + one.piece)) < FARTHEST_GAP
    assert limbs_continued(cloud, 0.008) is cloud


def test_a_gap_that_is_longer_than_eight_radii_stays() -> None:
    cloud = limb(gap=0.9)
    assert limbs_continued(cloud, 0.008) is cloud


def test_a_balloon_whose_rim_is_nearest_to_one_point_is_no_hole() -> None:
    """All but the pole of a ball is far from the points; numpy would warn of its axis."""
    cloud = PointCloud(np.array([[0.0, 0, 1], [0, 0, 20]]), np.array([[0.0, 0, 1]] * 2))
    found = capped(shapes.icosphere(3), cloud, spacing=0.01)
    assert (found.cap != NO_CAP).any() and not found.base.any()
    np.testing.assert_array_equal(outwards_at_rims(found, cloud).normals, cloud.normals)


def test_a_wide_hole_whose_rim_flares_does_not_swell_to_a_ball() -> None:
    # As under somebody who sits: a fair patch would go on as the rim does, and hang below as half of a ball.
    ball = shapes.icosphere(4)
    low = np.clip((-0.35 - ball.vertices[:, 2:]) / 0.25, 0, 1)
    mesh = TriangleMesh(ball.vertices * (1 + 1.5 * low**2 * [1, 1, 0]), ball.faces)
    kept = ball.vertices[:, 2] > -0.6
    normals = vertex_normals(mesh.vertices, mesh.faces)
    cloud = PointCloud(mesh.vertices[kept], normals=normals[kept])
    found = capped(mesh, cloud, spacing=0.05)
    in_cap = found.cap != NO_CAP
    flat = np.linalg.norm(found.surface.area_vectors[in_cap].sum(axis=0))
    assert found.surface.face_areas[in_cap].sum() < 1.4 * flat
