"""PTX files: grids of readings with the pose of their sensor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scan_files import cloud
from scipy.spatial.transform import Rotation

from pcretrieve.formats import members_of
from pcretrieve.ingestion.views import read_views

SENSOR = np.array([10.0, -20.0, 3.0])
TURN = Rotation.from_euler("zyx", [0.4, -0.2, 1.1])
SPHERE = np.array([0.2, 0.1, 5.0]), 1.0  # centre and radius, in the frame of the sensor
SIZE = 40, 30


def sphere_readings() -> NDArray[np.float64]:
    """(n, 3) readings of a sphere before a wall, in the frame of the sensor; zero for no answer."""
    u, v = np.meshgrid(np.linspace(-0.4, 0.4, SIZE[0]), np.linspace(-0.3, 0.3, SIZE[1]), indexing="ij")
    rays = np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    center, radius = SPHERE
    along = rays @ center
    inside = along**2 - center @ center + radius**2
    distance = np.where(inside > 0, along - np.sqrt(np.maximum(inside, 0)), 8.0 / rays[:, 2])
    distance[rays[:, 0] > 0.35] = 0
    return rays * distance[:, None]


def header(turn: Rotation, sensor: NDArray[np.float64], size: tuple[int, int] = SIZE) -> str:
    """The ten lines of a header; points are rows, so that the matrix is transposed."""
    rows = [*([size[0]], [size[1]], sensor), *turn.as_matrix().T]
    rows += [[*row, 0] for row in turn.as_matrix().T] + [[*sensor, 1]]
    return "".join(" ".join(f"{value:.9g}" for value in row) + "\n" for row in rows)


def body(readings: NDArray[np.float64]) -> str:
    return "".join("{:.9g} {:.9g} {:.9g} 0.5 1 2 3\n".format(*row) for row in readings)


def test_points_normals_and_the_sensor_in_the_common_frame(tmp_path: Path) -> None:
    readings = sphere_readings()
    (tmp_path / "a.ptx").write_text(header(TURN, SENSOR) + body(readings))
    found = cloud(tmp_path / "a.ptx")
    assert found.viewpoints is not None
    assert found.normals is not None
    np.testing.assert_allclose(found.viewpoints, np.tile(SENSOR, (len(found.points), 1)))
    own = (found.points - SENSOR) @ TURN.as_matrix()  # in the frame of the sensor
    center, radius = SPHERE
    outward = (own - center) / np.linalg.norm(own - center, axis=1, keepdims=True)
    on_sphere = np.abs(np.linalg.norm(own - center, axis=1) - radius) < 1e-6
    on_wall = np.abs(own[:, 2] - 8) < 1e-6
    assert (on_sphere | on_wall).all()
    assert on_sphere.sum() > 250
    normals = found.normals @ TURN.as_matrix()
    # Away from the silhouette, where the surface is seen from the side.
    inner = on_sphere & (own[:, 2] < center[2] - 0.7)
    assert np.einsum("ij,ij->i", normals[inner], outward[inner]).min() > 0.99
    np.testing.assert_allclose(normals[on_wall], np.tile([0, 0, -1.0], (on_wall.sum(), 1)), atol=1e-6)
    assert np.einsum("ij,ij->i", found.normals, SENSOR - found.points).min() >= 0
    n_missing = int((~readings.any(axis=1)).sum())
    assert (
        found.provenance[0].notes[0] == f"dropped {n_missing} of {len(readings)} readings without an answer"
    )


def test_several_scans_of_one_file_are_joined_in_their_common_frame(tmp_path: Path) -> None:
    readings = sphere_readings()
    one = header(TURN, SENSOR) + body(readings)
    other = header(Rotation.identity(), np.zeros(3)) + body(readings)
    (tmp_path / "one.ptx").write_text(one)
    (tmp_path / "both.ptx").write_text(one + other)
    alone, both = cloud(tmp_path / "one.ptx"), cloud(tmp_path / "both.ptx")
    n = len(alone.points)
    assert len(both.points) == 2 * n
    assert both.viewpoints is not None
    np.testing.assert_array_equal(both.points[:n], alone.points)
    np.testing.assert_allclose(both.points[n:] @ TURN.as_matrix().T + SENSOR, alone.points, atol=1e-6)
    np.testing.assert_array_equal(both.viewpoints[n:], np.zeros((n, 3)))
    first, second = members_of(tmp_path / "both.ptx")
    assert [path.name for path in (first, second)] == ["both.ptx#1", "both.ptx#2"]
    np.testing.assert_array_equal(cloud(first).points, alone.points)
    np.testing.assert_array_equal(cloud(second).points, both.points[n:])
    assert members_of(tmp_path / "one.ptx") == ()


def test_scans_of_one_file_are_views_that_are_placed_if_their_sensors_are(tmp_path: Path) -> None:
    readings = body(sphere_readings())
    placed = header(TURN, SENSOR) + readings + header(Rotation.identity(), np.zeros(3)) + readings
    (tmp_path / "placed.ptx").write_text(placed)
    (tmp_path / "loose.ptx").write_text(2 * (header(Rotation.identity(), np.zeros(3)) + readings))
    np.testing.assert_array_equal(read_views([tmp_path / "placed.ptx"]).poses, [np.eye(4), np.eye(4)])
    loose = read_views([tmp_path / "loose.ptx"])
    assert len(loose.clouds) == 2
    assert loose.poses is None


def test_readings_that_stand_alone_are_dropped_with_a_note(tmp_path: Path) -> None:
    """Between a body and its background a sensor measures points on neither surface."""
    readings = sphere_readings()
    stray = 17 * SIZE[1] + 15
    readings[stray] *= 0.5
    (tmp_path / "a.ptx").write_text(header(Rotation.identity(), np.zeros(3)) + body(readings))
    found = cloud(tmp_path / "a.ptx")
    assert np.linalg.norm(found.points - readings[stray], axis=1).min() > 0.5
    assert "points without three neighbours on a surface" in found.provenance[0].notes[1]
