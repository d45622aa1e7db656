"""What an inspection says of scans whose faults are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapes

from pcretrieve import PipelineOptions, PointCloud, TriangleMesh, signature
from pcretrieve.checks import Check, Inspection
from pcretrieve.errors import InputError, OptionError
from pcretrieve.pipeline.inspecting import inspect_scan, signature_spread
from pcretrieve.values import FloatArray

BODY = shapes.body()

# Coarse cells and few faces: fast.
COARSE = {"cell": 0.01, "target_faces": 3000}
OPTIONS = PipelineOptions().changed(surface=COARSE)
BUNNY = Path(__file__).parents[3] / "shared" / "data" / "stanford_bunny" / "bun000.ply"


def seen_from_far(points: FloatArray) -> PointCloud:
    """A star-shaped body round the origin, each point seen from beyond itself."""
    return PointCloud(points, viewpoints=5 * points)


def check(inspection: Inspection, name: str) -> Check:
    (found,) = [check for check in inspection.checks if check.name == name]
    return found


@pytest.fixture(scope="module")
def good() -> Inspection:
    """A body seen from all sides, with a dozen outliers at the end."""
    outliers = 0.6 * BODY.diagonal * shapes.points_on(shapes.icosphere(2), 12, seed=7)
    points = np.concatenate([shapes.points_on(BODY, 20_000), outliers])
    return inspect_scan(seen_from_far(points), OPTIONS, n_rescans=2)


def test_a_good_scan_passes(good: Inspection) -> None:
    assert good.failure is None
    assert [(bad.name, bad.shown) for bad in good.checks if bad.verdict != "passed"] == []
    assert good.verdict == "passed"
    assert good.spread is not None and 0 < good.spread < 0.15
    assert check(good, "Signature").value == good.spread


def test_outliers_are_what_was_dropped(good: Inspection) -> None:
    assert (good.dropped | good.cut_away)[-12:].all()
    assert good.dropped.mean() < 0.02


def test_points_checks_and_steps_count_the_same_points() -> None:
    """Ten points for each voxel, far from the origin, with strays, outliers, a patch of noise and a floor."""
    rng = np.random.default_rng(0)
    points = shapes.points_on(BODY, 60_000)
    patch = points[rng.choice(60_000, 300)] + rng.normal(0, 0.1, (300, 3))
    strays = 0.6 * BODY.diagonal * shapes.points_on(shapes.icosphere(2), 12, seed=7)
    floor = np.column_stack([rng.uniform(-2, 2, (8000, 2)), np.full(8000, points[:, 2].min())])
    scan = 1000 * np.concatenate([points, patch, strays, floor]) + [4e5, 5e6, 100]
    seen = inspect_scan(scan, OPTIONS, n_rescans=0)
    n, n_cut, n_dropped = len(scan), int(seen.cut_away.sum()), int(seen.dropped.sum())
    assert n_cut > 7900 and n_dropped > 30
    assert seen.cloud is not None and len(seen.cloud.points) < 0.7 * n
    assert check(seen, "Points").shown.startswith(f"{n - n_cut - n_dropped:,} points, averaged to")
    assert check(seen, "Background").shown.startswith(f"{n_cut:,} of {n:,} points cut away, ")
    assert check(seen, "Outliers").shown.startswith(f"{n_dropped:,} of {n - n_cut:,} points dropped, ")
    notes = [note for step in seen.steps if step.stage == "clean" for note in step.notes]
    assert notes == [f"dropped {n_dropped} of {n - n_cut} points as outliers"]


def test_background_is_what_was_cut_away() -> None:
    """A floor beneath the body, and a reading without an answer for each tenth of its points."""
    points = shapes.points_on(BODY, 12_000)
    at = np.random.default_rng(0).uniform(-2, 2, (8000, 2))
    floor = np.column_stack([at, np.full(len(at), points[:, 2].min())])
    nothing = 65.535 * np.ones((2000, 3))
    seen = inspect_scan(np.concatenate([nothing, points, floor]), OPTIONS, n_rescans=0)
    assert seen.cut_away[:2000].all()
    assert seen.cut_away[14_000:].mean() > 0.99
    assert seen.cut_away[2000:14_000].mean() < 0.02
    assert not (seen.cut_away & seen.dropped).any()
    background = check(seen, "Background")
    assert background.verdict == "passed"
    assert background.shown == f"{seen.cut_away.sum():,} of 22,000 points cut away, 46 %"
    assert "readings without an answer; " in background.words
    assert "of the ground on which the body stands" in background.words


def test_lengths_are_those_of_the_scan(good: Inspection) -> None:
    assert good.mesh is not None and good.cloud is not None
    np.testing.assert_allclose(good.mesh.vertices.max(axis=0), BODY.vertices.max(axis=0), atol=0.03)
    np.testing.assert_allclose(good.cloud.points.max(axis=0), BODY.vertices.max(axis=0), atol=0.03)
    apart = check(good, "Points").value
    assert apart is not None
    assert good.spacing == pytest.approx(apart * good.cloud.diagonal)


def test_the_signature_is_that_of_the_pipeline() -> None:
    scan = seen_from_far(shapes.points_on(BODY, 8000))
    seen, direct = inspect_scan(scan, OPTIONS, n_rescans=0).signature, signature(scan, OPTIONS)
    assert seen is not None
    np.testing.assert_allclose(seen.values, direct.values, rtol=1e-9)
    assert (seen.kind, seen.digest) == (direct.kind, direct.digest)


def test_a_hole_in_the_scan_is_filled_where_it_is() -> None:
    points, middle, radius = shapes.points_on(BODY, 20_000), BODY.vertices[0], 0.5
    left = points[np.linalg.norm(points - middle, axis=1) > radius]
    seen = inspect_scan(seen_from_far(left), OPTIONS, n_rescans=0)
    assert seen.mesh is not None
    areas, middles = seen.mesh.face_areas, seen.mesh.vertices[seen.mesh.faces].mean(axis=1)
    here = np.linalg.norm(middles - middle, axis=1) < 1.2 * radius
    assert areas[seen.filled & here].sum() > 0.9 * areas[seen.filled].sum()
    assert areas[seen.filled].sum() == pytest.approx(
        np.pi * radius**2, rel=0.3
    )  # less what is next to the rim
    # The body can stand on the cap of the hole.
    filled, base = check(seen, "Filled in").value, check(seen, "Closed base").value
    assert filled is not None and base is not None
    assert filled + base == pytest.approx(areas[seen.filled].sum() / areas.sum())
    assert base > 0.9 * (filled + base)
    assert check(seen, "Closed base").verdict == "look"


def test_a_one_sided_scan_fails_a_check() -> None:
    points = shapes.points_on(shapes.ellipsoid(), 20_000)
    seen = inspect_scan(seen_from_far(points[points[:, 0] > 0]), OPTIONS, n_rescans=0)
    sides = check(seen, "Sides seen")
    assert sides.verdict == "failed"
    assert "single view" in sides.words
    assert "sides seen" in seen.summary


def test_noise_is_measured() -> None:
    sphere = shapes.icosphere(4)
    for noise in (0.001, 0.004):
        points = shapes.points_on(sphere, 30_000, noise=noise)
        found = check(inspect_scan(seen_from_far(points), OPTIONS, n_rescans=0), "Noise").value
        assert found is not None
        # The mean of a voxel's points, or of two neighbours, has less than each.
        assert 0.5 * noise < found < 1.2 * noise


def test_normals_that_are_turned_over() -> None:
    """A fifth of the normals inside out: a pair of neighbours disagrees with probability 2 · 0.2 · 0.8."""
    points = shapes.points_on(shapes.icosphere(5), 8000)
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    normals[np.random.default_rng(0).random(len(points)) < 0.2] *= -1
    options = OPTIONS.changed(scan={"orientation": "given", "voxel": 0})
    seen = inspect_scan(PointCloud(points, normals=normals), options, n_rescans=0)
    found = check(seen, "Normals")
    assert found.verdict == "failed"
    assert found.value == pytest.approx(0.32, abs=0.01)


def test_a_ring_has_a_handle_unless_it_is_cut() -> None:
    kept = inspect_scan(shapes.torus())
    assert check(kept, "Handles").value == 1
    assert check(kept, "Handles").verdict == "look"
    options = OPTIONS.changed(surface={"genus": "sphere"})
    cut = inspect_scan(shapes.points_on(shapes.torus(), 20_000), options, n_rescans=0)
    assert check(cut, "Handles").value == 0
    assert len(cut.cuts) >= 1
    assert check(cut, "Cuts and bridges").value == len(cut.cuts) + len(cut.bridges)
    around = np.hypot(np.hypot(cut.cuts[:, 0], cut.cuts[:, 1]) - 1, cut.cuts[:, 2])
    assert around.max() < 0.4  # in the tube


def test_a_mesh_that_is_kept_has_nothing_but_its_surface() -> None:
    seen = inspect_scan(BODY)
    assert (seen.scan, seen.cloud, seen.spread, seen.failure) == (None, None, None, None)
    assert seen.mesh is not None and len(seen.mesh.faces) == len(BODY.faces)
    assert [found.name for found in seen.checks] == ["Closed surface", "Handles", "One body"]
    assert seen.signature is not None


def test_a_mesh_with_holes_is_sampled_or_has_a_check() -> None:
    holed = TriangleMesh(BODY.vertices, BODY.faces[10:])
    assert inspect_scan(holed, OPTIONS, n_rescans=0).scan is not None
    kept = inspect_scan(holed, PipelineOptions().changed(surface={"mode": "keep"}))
    assert check(kept, "Closed surface").verdict == "look"
    assert "boundary edges" in check(kept, "Closed surface").shown


def test_what_fails_is_shown_as_far_as_it_came(tmp_path: Path) -> None:
    (tmp_path / "garbage.ply").write_bytes(b"\x00\xff" * 500)
    unread = inspect_scan(tmp_path / "garbage.ply")
    assert unread.failure is not None and unread.failure.stage == "read"
    assert unread.scan is None and unread.steps == ()

    few = inspect_scan(shapes.points_on(BODY, 50))
    assert few.failure is not None and few.failure.stage == "crop"
    assert few.scan is not None and few.cloud is None and few.spacing > 0

    moved = TriangleMesh(BODY.vertices + np.array([7, 0, 0]), BODY.faces)
    two = inspect_scan(np.concatenate([shapes.points_on(BODY, 9000), shapes.points_on(moved, 9000)]))
    assert two.failure is not None and two.failure.stage == "surface"
    assert two.cloud is not None and two.cloud.normals is not None and two.mesh is None

    strip = inspect_scan(shapes.mobius_strip())
    assert strip.failure is not None and "one-sided" in strip.failure.message
    assert strip.scan is not None and len(strip.scan.points) == len(shapes.mobius_strip().vertices)
    for seen in (unread, few, two, strip):
        assert seen.verdict == "failed"
        assert seen.failure is not None
        assert f"the {seen.failure.stage} stage failed" in seen.summary
        assert seen.checks[0].verdict == "failed"


def test_messages_keep_the_names_of_files_as_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A relative path may start a message, and a file name with another first letter is another file."""
    (tmp_path / "garbage.ply").write_bytes(b"\x00\xff" * 500)
    monkeypatch.chdir(tmp_path)
    unread = inspect_scan("garbage.ply")
    assert unread.failure is not None and unread.failure.message.startswith("garbage.ply")
    assert unread.checks[0].words == unread.failure.message


@pytest.mark.parametrize(
    "points",
    [np.zeros((0, 3)), np.zeros((1, 3)), np.ones((500, 3)), np.linspace([0, 0, 0], [1, 2, 3], 500)],
    ids=["none", "one", "equal", "line"],
)
def test_points_that_are_no_body(points: FloatArray) -> None:
    seen = inspect_scan(points)
    assert seen.failure is not None
    assert seen.scan is not None and len(seen.scan.points) == len(points)


@pytest.mark.skipif(
    not BUNNY.is_file(), reason="needs the Stanford bunny beside the checkout, in ../shared/data"
)
def test_a_single_view_of_a_scanner() -> None:
    seen = inspect_scan(BUNNY, n_rescans=0)
    assert seen.name == "bun000.ply"
    assert check(seen, "Sides seen").verdict == "failed"


# --- the error bar ------------------------------------------------------------------------------------

CLOUD = seen_from_far(shapes.points_on(BODY, 5000, noise=0.003))


def test_spread_is_the_rms_distance_to_the_mean() -> None:
    described, deviation, spread = signature_spread(CLOUD, OPTIONS, n=2)
    np.testing.assert_allclose(described.values, signature(CLOUD, OPTIONS).values, rtol=1e-9)
    assert deviation.shape == described.values.shape
    assert spread > 0
    assert spread**2 == pytest.approx((deviation**2).sum())
    # Two parts lie on either side of their mean.
    rng = np.random.default_rng(0)
    one, two = (
        np.log(signature(CLOUD.select(np.sort(rng.choice(5000, 4500, replace=False))), OPTIONS).values)
        for _ in range(2)
    )
    np.testing.assert_allclose(deviation, abs(one - two) / 2, atol=1e-9)


def test_spread_depends_on_its_seed_alone() -> None:
    first, again, other = (signature_spread(CLOUD, OPTIONS, n=2, seed=seed)[2] for seed in (1, 1, 2))
    assert first == again != other


def test_a_mesh_that_is_kept_does_not_move() -> None:
    described, deviation, spread = signature_spread(BODY)
    np.testing.assert_array_equal(described.values, signature(BODY).values)
    assert (deviation.max(), spread) == (0, 0)


def test_options_out_of_range() -> None:
    with pytest.raises(OptionError, match="at least 2 rescans, got 1"):
        signature_spread(CLOUD, n=1)
    with pytest.raises(OptionError, match="at least 2 rescans, got 1"):
        inspect_scan(CLOUD, n_rescans=1)
    with pytest.raises(OptionError, match="share must lie between 0 and 1, got 1"):
        signature_spread(CLOUD, share=1)
    with pytest.raises(InputError, match="a scan must be a path"):
        inspect_scan({"points": 3})
