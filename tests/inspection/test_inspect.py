"""What an inspection says of scans whose faults are known, and of the next body in a catalogue."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapes

from pcretrieve import PipelineOptions, PointCloud, TriangleMesh, signature
from pcretrieve.checks import Check, Inspection
from pcretrieve.pipeline.inspecting import inspect_scan
from pcretrieve.values import FloatArray

BODY = shapes.body()

# Coarse cells and few faces: fast.
COARSE = {"cell": 0.01, "target_faces": 3000}
OPTIONS = PipelineOptions().changed(surface=COARSE, signature={"method": "r-bihdm"})


def seen_from_far(points: FloatArray) -> PointCloud:
    """A star-shaped body round the origin, each point seen from beyond itself."""
    return PointCloud(points, viewpoints=5 * points)


def check(inspection: Inspection, name: str) -> Check:
    (found,) = [check for check in inspection.checks if check.name == name]
    return found


def test_a_good_scan_passes_and_its_spread_is_the_rms_distance_to_the_mean() -> None:
    """A body seen from all sides, with a dozen outliers at the end."""
    outliers = 0.6 * BODY.diagonal * shapes.points_on(shapes.icosphere(2), 12, seed=7)
    cloud = seen_from_far(np.concatenate([shapes.points_on(BODY, 20_000), outliers]))
    good = inspect_scan(cloud, OPTIONS, n_rescans=2)
    assert good.failure is None
    assert [(bad.name, bad.shown) for bad in good.checks if bad.outcome != "passed"] == []
    assert good.outcome == "passed"
    deviation, spread = good.rescan_errors, good.rescan_error
    assert good.signature is not None and deviation is not None and spread is not None
    np.testing.assert_allclose(
        good.signature.values, signature(cloud, OPTIONS).values, rtol=1e-9
    )
    assert check(good, "Signature").value == spread < 0.15
    assert spread**2 == pytest.approx((deviation**2).sum())
    # Two parts lie on either side of their mean.
    rng = np.random.default_rng(0)
    one, two = (
        np.log(
            signature(
                cloud.select(np.sort(rng.choice(20_012, 18_011, replace=False))), OPTIONS
            ).values
        )
        for _ in range(2)
    )
    np.testing.assert_allclose(deviation, abs(one - two) / 2, atol=1e-9)


def test_a_hole_in_the_scan_is_filled_where_it_is() -> None:
    points, middle, radius = shapes.points_on(BODY, 20_000), BODY.vertices[0], 0.5
    left = points[np.linalg.norm(points - middle, axis=1) > radius]
    seen = inspect_scan(seen_from_far(left), OPTIONS, n_rescans=0)
    assert seen.mesh is not None
    areas, middles = (
        seen.mesh.face_areas,
        seen.mesh.vertices[seen.mesh.faces].mean(axis=1),
    )
    here = np.linalg.norm(middles - middle, axis=1) < 1.2 * radius
    assert areas[seen.filled & here].sum() > 0.9 * areas[seen.filled].sum()
    # Less what is nearer to the rim than two spacings of the points.
    inner = radius - 2 * np.sqrt(BODY.area / len(points))
    assert areas[seen.filled].sum() == pytest.approx(np.pi * inner**2, rel=0.15)
    assert check(seen, "Filled in").value == pytest.approx(
        areas[seen.filled].sum() / areas.sum()
    )
    # The body could stand on a flat cap of the hole; but it is round there, and stands elsewhere.
    assert "Closed base" not in [one.name for one in seen.checks]


def test_what_fails_is_shown_as_far_as_it_came(tmp_path: Path) -> None:
    (tmp_path / "garbage.ply").write_bytes(b"\x00\xff" * 500)
    unread = inspect_scan(tmp_path / "garbage.ply")
    assert unread.failure is not None and unread.failure.stage == "read"
    assert unread.scan is None and unread.steps == ()

    few = inspect_scan(shapes.points_on(BODY, 50))
    assert few.failure is not None and few.failure.stage == "crop"
    assert few.scan is not None and few.cloud is None and few.spacing > 0

    moved = TriangleMesh(BODY.vertices + np.array([7, 0, 0]), BODY.faces)
    two = inspect_scan(
        np.concatenate([shapes.points_on(BODY, 9000), shapes.points_on(moved, 9000)])
    )
    assert two.failure is not None and two.failure.stage == "surface"
    assert two.cloud is not None and two.cloud.normals is not None and two.mesh is None

    strip = inspect_scan(shapes.mobius_strip())
    assert strip.failure is not None and "one-sided" in strip.failure.message
    assert strip.scan is not None and len(strip.scan.points) == len(
        shapes.mobius_strip().vertices
    )
    for seen in (unread, few, two, strip):
        assert seen.outcome == "failed"
        assert seen.failure is not None
        assert f"the {seen.failure.stage} stage failed" in seen.summary
        assert seen.checks[0].outcome == "failed"

    line = np.linspace([0, 0, 0], [1, 2, 3], 500)
    for points in (np.zeros((0, 3)), np.zeros((1, 3)), np.ones((500, 3)), line):
        seen = inspect_scan(points)
        assert seen.failure is not None
        assert seen.scan is not None and len(seen.scan.points) == len(points)
