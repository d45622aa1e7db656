"""Thumbnails: their content, and their invariances."""

from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from benchmarks.poses import POSES
from benchmarks.simulation import body, make_subject
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from scipy.spatial.transform import Rotation
from shapes import cube, icosphere, joined

from pcretrieve.draw import axes as draw_axes, pictures as drawing
from pcretrieve.draw.pictures import MARGIN
from pcretrieve.values import FloatArray, Step, TriangleMesh


def thumbnail(mesh: TriangleMesh, **more: float) -> bytes:
    drawn = drawing.thumbnail(mesh.vertices, mesh.faces, **more)  # type: ignore[arg-type]
    return b"" if drawn is None else drawn.png


def surface(vertices: ArrayLike, faces: ArrayLike) -> TriangleMesh:
    points, corners = np.reshape(vertices, (-1, 3)), np.reshape(faces, (-1, 3))
    return TriangleMesh(points.astype(np.float64), corners.astype(np.int32))


def box(
    centre: tuple[float, float, float], sides: tuple[float, float, float]
) -> TriangleMesh:
    unit = cube()
    return surface((unit.vertices - 0.5) * sides + centre, unit.faces)


def pear() -> TriangleMesh:
    """A smooth body without any symmetry, its extents and skewnesses well apart."""
    ball = icosphere(5)
    x, y, z = ball.vertices.T
    moved = np.stack(
        [
            1.1 * x + 0.35 * y**2,
            2 * y * (1.3 + 0.6 * y),
            0.6 * z + 0.2 * x**2 + 0.1 * x * y,
        ],
        axis=1,
    )
    return TriangleMesh(moved, ball.faces)


def horse() -> TriangleMesh:
    legs = [
        box((x, -0.9, z), (0.15, 1.2, 0.1)) for x in (-0.9, 0.9) for z in (-0.15, 0.15)
    ]
    return joined(
        box((0, 0, 0), (2.2, 0.7, 0.5)), box((1.3, 0.4, 0), (0.4, 0.5, 0.3)), *legs
    )


def person() -> TriangleMesh:
    legs = [box((x, -1.2, 0), (0.2, 1.4, 0.15)) for x in (-0.2, 0.2)]
    return joined(
        box((0, 0, 0), (0.7, 1.2, 0.4)), box((0, 0.8, 0), (0.3, 0.3, 0.3)), *legs
    )


def any_turn(seed: int) -> Rotation:
    return Rotation.from_quat(np.random.default_rng(seed).standard_normal(4))


def turned(mesh: TriangleMesh, rotation: Rotation) -> TriangleMesh:
    return replace(mesh, vertices=mesh.vertices @ rotation.as_matrix().T)


def pixels(png: bytes) -> NDArray[np.int64]:
    """(size, size, 4) red, green, blue and alpha, 0 to 255."""
    return np.asarray(Image.open(BytesIO(png)).convert("RGBA"), dtype=np.int64)


def on_white(png: bytes) -> FloatArray:
    """(size, size, 3) in [0, 1]."""
    colours, alpha = np.split(pixels(png) / 255, [3], axis=2)
    return alpha * colours + (1 - alpha)


def covered(png: bytes) -> NDArray[np.bool_]:
    return pixels(png)[:, :, 3] > 0


def rows_and_columns(png: bytes) -> list[NDArray[np.intp]]:
    """The numbers of rows and of columns of a picture with something in them."""
    seen = covered(png)
    return [np.flatnonzero(seen.any(axis=axis)) for axis in (1, 0)]


def test_the_longer_side_fills_the_frame_less_its_margin() -> None:
    for mesh in (pear(), horse(), person()):
        rows, columns = rows_and_columns(thumbnail(mesh, size=200))
        longer = max((rows, columns), key=np.ptp)
        assert abs(longer[0] - 200 * MARGIN) <= 1
        assert abs(longer[-1] + 1 - 200 * (1 - MARGIN)) <= 1
        for along in (rows, columns):
            assert abs(along[0] + along[-1] + 1 - 200) <= 2  # centred


def test_turning_does_not_change_the_picture() -> None:
    for mesh in (pear(), horse()):
        before = on_white(thumbnail(mesh))
        for seed in range(5):
            after = on_white(thumbnail(turned(mesh, any_turn(seed))))
            assert np.abs(after - before).mean() < 0.002


def test_bodies_stand_on_their_legs_and_their_pictures_tell() -> None:
    rotation = any_turn(1)
    for mesh in (turned(each, rotation) for each in (horse(), person())):
        drawn = drawing.thumbnail(mesh.vertices, mesh.faces)
        assert drawn is not None
        assert drawn.up @ rotation.apply([0, 1, 0]) > np.cos(np.radians(20))


def test_people_are_upright_in_every_pose() -> None:
    subject = make_subject("person", np.random.default_rng(3))
    for seed, pose in enumerate(
        ("stand", "sit", "run", "point", "kick", "crouch", "bow")
    ):
        mesh, rotation = body(subject, POSES["person"][pose]), any_turn(seed)
        _, up, towards = draw_axes.body_axes(turned(mesh, rotation).vertices, mesh.faces)
        assert towards @ rotation.apply([0, 0, 1]) > -0.3, f"{pose} is seen from behind"
        assert up @ rotation.apply([0, 1, 0]) > np.cos(np.radians(35)), pose


def test_what_is_up_can_be_said() -> None:
    rotation = any_turn(2)
    mesh, up = turned(person(), rotation), rotation.apply([1.0, 0.0, 0.0])
    axes = draw_axes.body_axes(mesh.vertices, mesh.faces, up)
    np.testing.assert_allclose(axes[1], up)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)
    np.testing.assert_allclose(
        np.abs(axes[2] @ rotation.as_matrix()), [0, 0, 1], atol=1e-3
    )  # the broad side
    drawn = drawing.thumbnail(mesh.vertices, mesh.faces, up=up)
    assert drawn is not None
    np.testing.assert_allclose(drawn.up, up)
    rows, columns = rows_and_columns(drawn.png)
    assert np.ptp(columns) > 1.5 * np.ptp(rows)


def test_a_scan_stands_on_the_ground_that_was_removed() -> None:
    mesh = person()
    assert mesh.up is None
    crop = Step("crop", 0.1, {"up_x": 0.0, "up_y": 0.0, "up_z": -1.0})
    scanned = replace(
        mesh, provenance=(Step("read", 0.1), crop, Step("reconstruct", 0.1))
    )
    np.testing.assert_array_equal(scanned.up, [0, 0, -1])


def test_a_surface_without_area_cannot_be_drawn() -> None:
    for mesh in (
        surface([], []),
        surface([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]]),
    ):
        assert drawing.thumbnail(mesh.vertices, mesh.faces) is None


def test_a_cloud_looks_like_its_surface() -> None:
    mesh = pear()
    points = mesh.vertices[mesh.faces].mean(axis=1)
    here, there = (
        covered(drawing.cloud_thumbnail(cloud)) for cloud in (points, 1000 * points + 5)
    )
    assert 0.1 < here.mean() < 0.8
    np.testing.assert_array_equal(here, there)
