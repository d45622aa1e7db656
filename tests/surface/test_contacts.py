"""Contact layers: parts of a body that touch are separated, and nothing else is."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from pcretrieve.points.grid import distances
from pcretrieve.surface.parts import CONTINUED, DETOUR, contact_layer, rims, walls

Mask = NDArray[np.bool_]
N = 30


def block() -> Mask:
    """A slab of voxels, whose shape does not show that it is folded."""
    inside = np.zeros((N, N, 12), dtype=bool)
    inside[3:-3, 3:-3, 3:-3] = True
    return inside


def fold(reach: int) -> Mask:
    """Links that cross the surfels of points half way up the block, `reach` voxels deep from its side."""
    x, z = np.meshgrid(np.arange(3, 3 + reach), np.arange(12), indexing="ij")
    points = np.column_stack([x.ravel(), np.full(x.size, N / 2), z.ravel()]).astype(float)
    return walls(points, np.tile([0.0, 1.0, 0.0], (len(points), 1)), block().shape)


def parted(inside: Mask, wall: Mask, continued: Mask | None = None) -> Mask:
    continued = np.zeros_like(wall) if continued is None else continued
    return contact_layer(inside, wall, continued, distances(~inside, np.inf))


def sheet(height: float, up: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points of a plane at a height, with normals up or down."""
    x, z = np.meshgrid(np.arange(8.0, 20.0), np.arange(8.0, 20.0), indexing="ij")
    points = np.column_stack([x.ravel(), np.full(x.size, height), z.ravel()])
    return points, np.tile([0.0, up, 0.0], (len(points), 1))


def rims_of(*sheets: tuple[NDArray[np.float64], NDArray[np.float64]]) -> NDArray[np.float64]:
    """Centres of the surfels between sheets of points."""
    at, normals = (np.concatenate(part) for part in zip(*sheets, strict=True))
    occupied = np.zeros((28, 28, 28), dtype=bool)
    occupied[tuple(np.rint(at).astype(int).T)] = True
    middles, directions = rims(at, normals, distances(occupied, np.inf))
    np.testing.assert_allclose(np.abs(directions), np.tile([0.0, 1.0, 0.0], (len(middles), 1)))
    return middles


def test_a_body_without_points_in_it_has_no_contacts() -> None:
    assert not parted(block(), np.zeros((3, *block().shape), dtype=bool)).any()


@pytest.mark.parametrize("reach", [10, 14, 18])
def test_a_fold_is_parted_in_one_layer_as_deep_as_it_goes(reach: int) -> None:
    found = parted(block(), fold(reach))
    layers = np.flatnonzero(found.any(axis=(0, 2)))
    assert len(layers) == 1
    assert abs(layers[0] - N / 2) <= 1
    # Near the end of the fold the detour is short, and the parts are not separated.
    depth = np.flatnonzero(found.any(axis=(1, 2))).max() - 2
    assert reach - DETOUR / 2 <= depth <= reach + 2
    legs, n = ndimage.label((block() & ~found)[3 : 3 + reach - DETOUR // 2])
    assert n == 2
    assert legs[0, 5, 6] != legs[0, -5, 6]


def test_signs_of_normals_do_not_matter() -> None:
    rng = np.random.default_rng(0)
    at, normals = rng.uniform(4, 20, (50, 3)), rng.standard_normal((50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    np.testing.assert_array_equal(walls(at, normals, (24, 24, 24)), walls(at, -normals, (24, 24, 24)))


def test_noise_parts_nothing() -> None:
    inside = block()
    wall = np.random.default_rng(0).random((3, *inside.shape)) < 0.5
    assert not parted(inside, wall).any()


def test_points_that_face_each_other_across_a_narrow_gap_are_a_rim() -> None:
    middles = rims_of(sheet(12.0, 1.0), sheet(14.0, -1.0))
    assert len(middles) >= 100
    np.testing.assert_allclose(middles[:, 1], 13.0)


@pytest.mark.parametrize(
    "sheets",
    [
        [sheet(12.0, 1.0)],
        [sheet(12.0, -1.0), sheet(14.0, 1.0)],  # the two sides of a thin part
        [sheet(12.0, 1.0), sheet(14.0, 1.0)],  # a surface that two views do not place alike
        [sheet(12.0, 1.0), sheet(18.0, -1.0)],  # a wide gap
    ],
)
def test_other_points_are_no_rim(sheets: list[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> None:
    assert not len(rims_of(*sheets))


def test_a_contact_whose_middle_no_sensor_saw_is_parted_from_its_rim() -> None:
    seen = fold(11)
    seen[:, 6:13, :, 5:7] = False  # a gap of two voxels between the points near the outside
    assert len(np.unique(parts(parted(block(), seen)))) == 1
    rim = np.array([[x, N / 2, z] for x in range(3, 14) for z in (3, 8)], dtype=float)
    continued = walls(rim, np.tile([0.0, 1.0, 0.0], (len(rim), 1)), block().shape, CONTINUED)
    assert len(np.unique(parts(parted(block(), seen, continued)))) == 2


def test_a_wall_that_ends_inside_the_body_parts_nothing() -> None:
    rim = np.array([[3.0, N / 2, z] for z in range(3, 9)])
    wall = np.zeros((3, *block().shape), dtype=bool)
    continued = walls(rim, np.tile([0.0, 1.0, 0.0], (len(rim), 1)), block().shape, CONTINUED)
    assert not parted(block(), wall, continued).any()


def parts(layer: Mask) -> NDArray[np.intp]:
    """Numbers of the pieces into which a layer parts the outer half of the fold."""
    pieces, _ = ndimage.label((block() & ~layer)[3:11])
    return np.asarray(pieces[pieces > 0])
