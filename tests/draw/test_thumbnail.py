"""Thumbnails: their content, and their invariances."""

from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from pcretrieve import draw
from pcretrieve.draw import MARGIN
from pcretrieve.errors import DegenerateMeshError
from pcretrieve.values import FloatArray, Step, TriangleMesh


def thumbnail(mesh: TriangleMesh, **more: float) -> bytes:
    return draw.thumbnail(mesh.vertices, mesh.faces, **more)  # type: ignore[arg-type]


def body_axes(mesh: TriangleMesh) -> FloatArray:
    return draw.body_axes(mesh.vertices, mesh.faces)


CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float) / 2
CUBE_SIDES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]


def surface(vertices: ArrayLike, faces: ArrayLike) -> TriangleMesh:
    return TriangleMesh(
        np.asarray(vertices, dtype=np.float64).reshape(-1, 3),
        np.asarray(faces, dtype=np.int32).reshape(-1, 3),
    )


def box(centre: tuple[float, float, float], sides: tuple[float, float, float]) -> TriangleMesh:
    return surface(CUBE * sides + centre, [side[:k] + side[k + 1 :] for side in CUBE_SIDES for k in (1, 3)])


def joined(*meshes: TriangleMesh) -> TriangleMesh:
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return TriangleMesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, first, strict=False)]),
    )


def sphere(n: int = 60) -> TriangleMesh:
    """n circles of latitude, 2n meridians."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, n), np.linspace(0, 2 * np.pi, 2 * n), indexing="ij")
    vertices = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], axis=-1)
    corner = np.arange(n * 2 * n).reshape(n, 2 * n)
    a, b, c, d = (
        part.ravel() for part in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1])
    )
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return TriangleMesh(vertices.reshape(-1, 3), faces)


def pear() -> TriangleMesh:
    """A smooth body without any symmetry, its extents and skewnesses well apart."""
    x, y, z = sphere().vertices.T
    moved = np.stack(
        [1.1 * x + 0.35 * y**2, 2 * y * (1.3 + 0.6 * y), 0.6 * z + 0.2 * x**2 + 0.1 * x * y], axis=1
    )
    return TriangleMesh(moved, sphere().faces)


def horse() -> TriangleMesh:
    legs = [box((x, -0.9, z), (0.15, 1.2, 0.1)) for x in (-0.9, 0.9) for z in (-0.15, 0.15)]
    return joined(box((0, 0, 0), (2.2, 0.7, 0.5)), box((1.3, 0.4, 0), (0.4, 0.5, 0.3)), *legs)


def person() -> TriangleMesh:
    legs = [box((x, -1.2, 0), (0.2, 1.4, 0.15)) for x in (-0.2, 0.2)]
    return joined(box((0, 0, 0), (0.7, 1.2, 0.4)), box((0, 0.8, 0), (0.3, 0.3, 0.3)), *legs)


def any_turn(seed: int) -> Rotation:
    return Rotation.from_quat(np.random.default_rng(seed).standard_normal(4))


def turned(mesh: TriangleMesh, rotation: Rotation) -> TriangleMesh:
    return replace(mesh, vertices=mesh.vertices @ rotation.as_matrix().T)


def pixels(png: bytes) -> NDArray[np.int64]:
    """(size, size, 4) red, green, blue and alpha, 0 to 255."""
    return np.asarray(Image.open(BytesIO(png)).convert("RGBA"), dtype=np.int64)


def on_white(png: bytes) -> FloatArray:
    """(size, size, 3) in [0, 1]."""
    picture = pixels(png) / 255
    alpha = picture[:, :, 3:]
    return alpha * picture[:, :, :3] + (1 - alpha)


def test_a_png_of_the_size_asked_for() -> None:
    for size in (1, 33, 160):
        with Image.open(BytesIO(thumbnail(pear(), size=size))) as picture:
            picture.load()
            assert picture.format == "PNG"
            assert picture.size == (size, size)


def test_sphere_covers_pi_quarters_of_its_box() -> None:
    alpha = pixels(thumbnail(sphere()))[:, :, 3] / 255
    assert alpha.mean() == pytest.approx(np.pi / 4 * (1 - 2 * MARGIN) ** 2, rel=0.005)
    assert not alpha[[0, 0, -1, -1], [0, -1, 0, -1]].any()


def test_the_longer_side_fills_the_frame_less_its_margin() -> None:
    for mesh in (pear(), horse(), person()):
        seen = pixels(thumbnail(mesh, size=200))[:, :, 3] > 0
        rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
        longer = max((rows, columns), key=np.ptp)
        assert abs(longer[0] - 200 * MARGIN) <= 1
        assert abs(longer[-1] + 1 - 200 * (1 - MARGIN)) <= 1
        for along in (rows, columns):
            assert abs(along[0] + along[-1] + 1 - 200) <= 2  # centred


def test_place_and_size_do_not_change_the_picture() -> None:
    mesh = pear()
    elsewhere = replace(mesh, vertices=1000 * mesh.vertices + [3e4, -2e4, 1e4])
    np.testing.assert_allclose(on_white(thumbnail(elsewhere)), on_white(thumbnail(mesh)), atol=0.02)


def test_turning_does_not_change_the_picture() -> None:
    for mesh in (pear(), horse()):
        before = on_white(thumbnail(mesh))
        for seed in range(5):
            after = on_white(thumbnail(turned(mesh, any_turn(seed))))
            assert np.abs(after - before).mean() < 0.002


def test_a_mirrored_body_gives_a_mirrored_picture() -> None:
    mesh = pear()
    mirrored = TriangleMesh(mesh.vertices * [-1, 1, 1], mesh.faces[:, ::-1])
    alpha, other = (pixels(thumbnail(m, azimuth=0, elevation=0))[:, :, 3] for m in (mesh, mirrored))
    assert np.abs(other - alpha).mean() > 5
    np.testing.assert_allclose(other, alpha[:, ::-1], atol=1)


def test_the_back_has_the_outline_of_the_front_mirrored() -> None:
    front, back = (pixels(thumbnail(pear(), azimuth=a, elevation=0))[:, :, 3] for a in (0, 180))
    assert (back == front[:, ::-1]).mean() > 0.999


def test_the_viewer_sees_the_top_from_above() -> None:
    """A tall block shows its full width from the front, and its square top from straight above."""
    block = box((0, 0, 0), (1.5, 3, 1.5))
    front, top = (pixels(thumbnail(block, azimuth=0, elevation=e))[:, :, 3] > 0 for e in (0, 90))
    assert front.mean() == pytest.approx((1 - 2 * MARGIN) ** 2 / 2, rel=0.03)
    assert top.mean() == pytest.approx((1 - 2 * MARGIN) ** 2, rel=0.03)


def test_an_inside_out_surface_looks_the_same() -> None:
    mesh = pear()
    assert thumbnail(replace(mesh, faces=mesh.faces[:, ::-1])) == thumbnail(mesh)


def test_vertices_without_a_face_do_not_count() -> None:
    mesh = pear()
    assert thumbnail(surface([*mesh.vertices, [99, 99, 99]], mesh.faces)) == thumbnail(mesh)


def test_light_comes_from_the_upper_left() -> None:
    brightness = pixels(thumbnail(sphere(), size=100))[:, :, 0]
    assert brightness[25, 30] > brightness[50, 50] > brightness[80, 60] > 0


def test_edges_have_the_colour_of_what_they_bound() -> None:
    triangle = surface([[0, 0, 0], [3, 0, 0], [0, 2, 0]], [[0, 1, 2]])
    picture = pixels(thumbnail(triangle, azimuth=0, elevation=0))
    partly = (picture[:, :, 3] > 0) & (picture[:, :, 3] < 255)
    assert partly.any()
    assert len(np.unique(picture[picture[:, :, 3] > 0][:, :3], axis=0)) == 1


def test_axes_are_right_handed_and_turn_with_the_body() -> None:
    mesh, rotation = pear(), any_turn(3)
    axes = body_axes(mesh)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)
    np.testing.assert_allclose(body_axes(turned(mesh, rotation)), rotation.apply(axes), atol=1e-4)


def test_the_viewer_looks_at_the_broad_side() -> None:
    axes = body_axes(turned(box((0, 0, 0), (2, 3, 1)), Rotation.from_euler("x", 90, degrees=True)))
    np.testing.assert_allclose(np.abs(axes[2]), [0, 1, 0], atol=1e-9)


def test_bodies_stand_on_their_legs() -> None:
    for mesh in (horse(), person()):
        rotation = any_turn(1)
        assert body_axes(turned(mesh, rotation))[1] @ rotation.apply([0, 1, 0]) > np.cos(np.radians(20))


def test_people_with_raised_arms_of_unlike_lengths_stand() -> None:
    """Left and right differ by the arms, but less than top and bottom, and front and back."""
    feet, arms = box((0, -1.9, 0.2), (0.5, 0.2, 0.6)), box((0.1, 1.2, 0), (1.6, 0.3, 0.3))
    rotation = any_turn(4)
    axes = body_axes(turned(joined(box((0, 0, 0), (0.4, 4, 0.3)), feet, arms), rotation))
    assert axes[1] @ rotation.apply([0, 1, 0]) > np.cos(np.radians(20))


def test_what_is_up_can_be_said() -> None:
    rotation = any_turn(2)
    mesh, up = turned(person(), rotation), rotation.apply([1.0, 0.0, 0.0])
    axes = draw.body_axes(mesh.vertices, mesh.faces, up)
    np.testing.assert_allclose(axes[1], up)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)
    np.testing.assert_allclose(np.abs(axes[2] @ rotation.as_matrix()), [0, 0, 1], atol=1e-3)  # the broad side
    lying = pixels(draw.thumbnail(mesh.vertices, mesh.faces, up=up))[:, :, 3] > 0
    rows, columns = np.flatnonzero(lying.any(axis=1)), np.flatnonzero(lying.any(axis=0))
    assert np.ptp(columns) > 1.5 * np.ptp(rows)


def test_a_smaller_picture_of_a_picture_is_about_that_which_is_drawn() -> None:
    for size in (32, 88, 128):
        picture = thumbnail(person())
        smaller, direct = draw.resized(picture, size), thumbnail(person(), size=size)
        assert pixels(smaller).shape == pixels(direct).shape == (size, size, 4)
        alpha, expected = (pixels(one)[:, :, 3].astype(float) for one in (smaller, direct))
        assert np.abs(alpha - expected).mean() < 255 * 0.01
        inside = (alpha == 255) & (expected == 255)
        colours = (pixels(one)[inside][:, :3].astype(float) for one in (smaller, direct))
        assert np.abs(np.subtract(*colours)).mean() < 4
        assert abs(len(smaller) - len(direct)) < 0.3 * len(direct)
        np.testing.assert_array_equal(
            draw.direction_upwards(smaller), draw.direction_upwards(thumbnail(person()))
        )


def test_a_picture_is_not_made_larger() -> None:
    picture = thumbnail(person(), size=50)
    assert draw.resized(picture, 50) == draw.resized(picture, 51) == picture


def test_a_picture_says_how_it_was_drawn() -> None:
    rotation = any_turn(3)
    mesh = turned(person(), rotation)
    picture = thumbnail(mesh)
    direction = draw.direction_upwards(picture)
    assert direction is not None
    np.testing.assert_allclose(direction, body_axes(mesh)[1], atol=1e-4)
    assert draw.direction_upwards(picture.replace(b"drawing 1", b"drawing 0")) is None


def test_the_axis_along_which_most_bodies_stand() -> None:
    z, y = np.array([0, 0, 1.0]), np.array([0, 1.0, 0])
    near_z = Rotation.from_rotvec([0.4, 0, 0]).apply(z)
    rng = np.random.default_rng(0)
    others = rng.normal(size=(40, 3))
    others /= np.linalg.norm(others, axis=1, keepdims=True)
    common_axis = draw.common_axis
    np.testing.assert_array_equal(common_axis(np.stack([*[near_z] * 30, *others])), z)
    np.testing.assert_array_equal(common_axis(np.stack([-z] * 10)), -z)
    assert common_axis(others) is None, "bodies in any direction"
    assert common_axis(np.stack([z] * 20 + [y] * 10)) is None, "two axes"
    assert common_axis(np.stack([z] * 9)) is None, "too few bodies"
    assert common_axis(np.empty((0, 3))) is None


def test_a_scan_stands_on_the_ground_that_was_removed() -> None:
    mesh = person()
    assert mesh.up is None
    sizes = {"up_x": 0.0, "up_y": 0.0, "up_z": -1.0}
    scanned = replace(
        mesh, provenance=(Step("read", 0.1), Step("crop", 0.1, sizes), Step("reconstruct", 0.1))
    )
    np.testing.assert_array_equal(scanned.up, [0, 0, -1])


def test_without_a_preference_the_axes_are_those_of_the_file() -> None:
    np.testing.assert_allclose(body_axes(box((5, 5, 5), (1, 1, 1))), np.eye(3), atol=1e-6)


def test_a_surface_without_area_cannot_be_drawn() -> None:
    for mesh in (
        surface([], []),
        surface([[0, 0, 0], [1, 0, 0], [0, 1, 0]], []),
        surface([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]]),
        surface([[7, 7, 7]] * 3, [[0, 1, 2]]),
    ):
        with pytest.raises(DegenerateMeshError, match=r"must have area to be drawn, got \d faces") as caught:
            thumbnail(mesh)
        assert caught.value.stage == "thumbnail"


def test_a_cloud_looks_like_its_surface() -> None:
    mesh = pear()
    corners = mesh.vertices[mesh.faces[mesh.face_areas > 0]]
    points = corners.mean(axis=1)
    seen = pixels(draw.cloud_thumbnail(points, size=80))[:, :, 3] > 0
    assert 0.1 < seen.mean() < 0.8
    np.testing.assert_array_equal(seen, pixels(draw.cloud_thumbnail(1000 * points + 5, size=80))[:, :, 3] > 0)


def test_a_cloud_of_one_point_has_a_picture() -> None:
    assert pixels(draw.cloud_thumbnail(np.ones((1, 3))))[:, :, 3].any()
