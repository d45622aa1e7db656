"""Filters: averaging keeps the shape, outliers are removed, and invalid scans are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapes
from scipy.spatial import cKDTree

from pcretrieve.errors import ReconstructionError
from pcretrieve.options import ScanOptions
from pcretrieve.points import clean
from pcretrieve.points.clean import outliers
from pcretrieve.values import FloatArray, PointCloud

OPTIONS = ScanOptions()
VOXEL = 0.02
COARSE = ScanOptions(voxel=VOXEL)
BODY = PointCloud(shapes.points_on(shapes.body(3), 6000))


def gaps(gallery: FloatArray, points: FloatArray) -> FloatArray:
    """(n,) distance of each point to the nearest of the gallery."""
    distance, _ = cKDTree(gallery).query(points)
    return np.asarray(distance)


def test_one_point_is_left_of_each_voxel_and_none_moves_beyond_it() -> None:
    thinned = clean(BODY, COARSE)[0]
    cell = VOXEL * BODY.diagonal
    assert gaps(BODY.points, thinned.points).max() <= np.sqrt(3) * cell
    assert thinned.provenance[-1].sizes["points_thinned"] < 0.5 * len(BODY.points)
    assert np.quantile(gaps(thinned.points, BODY.points), 0.99) <= np.sqrt(3) * cell


def test_outliers_go_and_the_body_stays() -> None:
    rng = np.random.default_rng(0)
    strays = 3 * BODY.diagonal * (rng.random((20, 3)) - 0.5)
    far_from_body = gaps(BODY.points, strays) > 0.1 * BODY.diagonal
    cleaned = clean(
        PointCloud(np.concatenate([BODY.points, strays[far_from_body]])), OPTIONS
    )[0]
    assert gaps(BODY.points, cleaned.points).max() < 0.02 * BODY.diagonal
    assert gaps(cleaned.points, BODY.points).max() < 0.02 * BODY.diagonal
    assert any("as outliers" in note for note in cleaned.provenance[-1].notes)
    assert (
        clean(BODY, OPTIONS)[0].provenance[-1].sizes["outliers"] == 0
    )  # of an exact surface, none


def test_strays_of_a_dense_scan_are_few_of_its_points_but_many_of_its_voxels() -> None:
    rng = np.random.default_rng(0)
    surface = rng.normal(size=(200_000, 3))
    surface /= np.linalg.norm(surface, axis=1)[:, None]
    strays = 3 * (rng.random((2_000, 3)) - 0.5)
    cloud = PointCloud(np.concatenate([surface, strays]))
    is_far = np.abs(np.linalg.norm(strays, axis=1) - 1) > 0.15
    dropped = outliers(cloud, ScanOptions(voxel=0.01))
    assert dropped[len(surface) :][is_far].mean() > 0.95
    assert dropped[: len(surface)].mean() < 1e-3


def test_strays_beside_a_sparse_side_go_and_its_points_stay() -> None:
    rng = np.random.default_rng(0)
    dense = shapes.points_on(shapes.body(3), 40_000)
    body = dense[(dense[:, 0] < 0) | (rng.random(len(dense)) < 0.05)]
    strays = (rng.random((80, 3)) - 0.5) * 1.2 * np.ptp(dense, axis=0) + dense.mean(
        axis=0
    )
    strays = strays[gaps(dense, strays) > 0.03 * BODY.diagonal]
    cleaned = clean(PointCloud(np.concatenate([body, strays])), ScanOptions(voxel=0))[
        0
    ].points
    assert gaps(cleaned, strays).min() > 0
    assert gaps(cleaned, body).max() == 0


def test_each_point_keeps_a_sensor_that_saw_its_voxel() -> None:
    left = BODY.points[:, 0] < 0
    sensors = np.where(left[:, None], [-9.0, 0, 0], [9.0, 0, 0])
    cleaned = clean(replace(BODY, viewpoints=sensors), COARSE)[0]
    cell = VOXEL * BODY.diagonal
    clear = np.abs(cleaned.points[:, 0]) > cell
    assert cleaned.viewpoints is not None
    np.testing.assert_array_equal(
        cleaned.viewpoints[clear, 0], 9 * np.sign(cleaned.points[clear, 0])
    )


def test_no_sensor_is_between_two_that_saw_one_voxel() -> None:
    sensors = np.random.default_rng(0).choice([-9.0, 9.0], (len(BODY.points), 1)) * [
        1,
        0,
        0,
    ]
    viewpoints = clean(replace(BODY, viewpoints=sensors), COARSE)[0].viewpoints
    assert viewpoints is not None
    assert set(map(tuple, viewpoints.tolist())) == {(-9, 0, 0), (9, 0, 0)}


RANDOM = np.random.default_rng(0).random((500, 3))


def test_what_is_no_body() -> None:
    for points, words in (
        (RANDOM[:99], "a scan needs at least 100 points, got 99: scan more densely"),
        (np.ones((500, 3)), "all 500 are equal"),
        (np.outer(RANDOM[:, 0], [1, 2, 3]) + 5, "lie on a line"),
        (
            RANDOM @ [[1, 0, 1], [0, 1, 1], [0, 0, 0]],
            "lie in a plane: scan it from several sides",
        ),
    ):
        with pytest.raises(ReconstructionError, match=words) as raised:
            clean(PointCloud(points), OPTIONS)
        assert raised.value.stage == "clean"
    with pytest.raises(
        ReconstructionError, match=r"got \d+: scan more densely, or lower scan\.voxel"
    ):
        clean(BODY, ScanOptions(voxel=0.3))
