"""What holds of the way from a scan to its signature: presets, places, units, errors, what is logged."""

from __future__ import annotations

import logging
import pickle
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes
from commands import run

import pcretrieve as pr
from pcretrieve import (
    Catalogue,
    PipelineOptions,
    PointCloud,
    TriangleMesh,
    reconstruct,
    signature,
)
from pcretrieve.errors import InputError, ReconstructionError, ScanReadError, ShapeError
from pcretrieve.formats import ScanLike, write_cloud, write_mesh
from pcretrieve.options import PRESETS
from pcretrieve.pipeline.process import moved, process, stages
from pcretrieve.values.topology import defects

POINTS = shapes.points_on(shapes.body(), 8000)
HAND = Path(__file__).parents[2] / "scans" / "hand-1" / "hand-1_fist.ply"
DATA = Path(__file__).parents[2].parent / "shared" / "data"


def test_a_mesh_has_one_signature_in_any_unit_and_place() -> None:
    body = shapes.body()
    values = signature(body).values
    for scale, shift in ((1e-3, 0), (1e3, 0), (1, 1e6)):
        other = TriangleMesh(scale * body.vertices + shift, body.faces)
        np.testing.assert_allclose(signature(other).values, values, rtol=1e-6)


@pytest.fixture(scope="module")
def surface() -> TriangleMesh:
    return reconstruct(POINTS)


def test_the_signature_of_the_surface_of_a_scan_is_that_of_the_scan(
    surface: TriangleMesh,
) -> None:
    assert len(surface.others) == 1
    expected = signature(POINTS)
    assert expected.errors is not None
    assert signature(surface) == expected


def test_a_surface_carries_the_others_of_its_scan_to_other_processes(
    surface: TriangleMesh,
) -> None:
    sent = pickle.loads(pickle.dumps(surface))
    assert sent == surface and sent.others == surface.others


def test_each_step_of_a_surface_with_others_is_told_once(surface: TriangleMesh) -> None:
    told = [step.stage for step in process(surface).provenance]
    assert told == ["crop", "clean", "orient", "surface", "surface", "spectrum", "checks"]


def test_options_of_surfaces_hold_for_those_of_a_scan_too(surface: TriangleMesh) -> None:
    few = reconstruct(surface, {"surface": {"max_faces": 2000}})
    assert [len(mesh.faces) <= 2000 for mesh in (few, *few.others)] == [True, True]
    # Points that are sampled from the surface are those of a new cloud, which passes all stages.
    *_, last = stages(surface, PipelineOptions().changed(spectral={"element": "points"}))
    assert last.mesh is None and last.cloud is not None
    assert [step.stage for step in last.cloud.provenance].count("clean") == 2


def test_a_changed_surface_carries_none_of_the_scan(surface: TriangleMesh) -> None:
    assert replace(surface, provenance=()).others == ()


def test_a_scan_that_passed_some_stages_passes_the_others_only() -> None:
    scattered = PointCloud(np.vstack([POINTS, [[40, 40, 40]]]))
    expected = signature(scattered)
    cropped = pr.crop(scattered)
    assert signature(cropped).distance(expected) < 1e-3
    cloud = pr.orient(pr.clean(cropped))
    assert [step.stage for step in cloud.provenance] == ["crop", "clean", "orient"]
    assert signature(cloud).distance(expected) < 1e-3
    assert len(cloud.points) < len(POINTS) and cloud.normals is not None
    outwards = cloud.points - POINTS.mean(axis=0)
    assert ((cloud.normals * outwards).sum(axis=1) > 0).mean() > 0.8


def test_filters_take_clouds_of_open3d_and_say_what_they_cannot_take() -> None:
    cloud = pr.crop(POINTS)
    given: tuple[Callable[[], Any], ...]
    given = cloud.to_open3d, lambda: cloud.to_open3d(tensor=True)
    for made in given:
        np.testing.assert_allclose(pr.crop(made()).points, cloud.points, rtol=1e-6)
    with pytest.raises(InputError, match="a scan must be a path, an \\(n, 3\\) array"):
        pr.crop(5)  # type: ignore[arg-type]
    with pytest.raises(
        ReconstructionError, match=r"\[clean\] a scan needs at least 100 points"
    ):
        pr.clean(POINTS[:50])
    with pytest.raises(ReconstructionError, match="needs a scan with normals"):
        pr.orient(POINTS, {"scan": {"orientation": "given"}})


def compactness(mesh: TriangleMesh) -> tuple[float, float]:
    return mesh.volume / mesh.area**1.5, mesh.euler_characteristic


def test_a_function_of_a_mesh_is_a_descriptor(surface: TriangleMesh) -> None:
    made = signature(POINTS, method=compactness)
    assert (made.kind, made.metric, len(made)) == ("compactness", "values", 2)
    each = np.array([compactness(mesh) for mesh in (surface, *surface.others)])
    np.testing.assert_allclose(made.values, each.mean(axis=0))
    assert made.errors is not None and made.errors[1] == 0
    with pytest.raises(
        ShapeError, match="the descriptor 'no_mesh' failed, AttributeError"
    ):

        def no_mesh(mesh: TriangleMesh) -> float:
            return float(mesh.nothing)  # type: ignore[attr-defined]

        signature(shapes.body(), method=no_mesh)


def test_a_descriptor_of_ones_own_needs_no_package() -> None:
    own = pr.Descriptor(
        "heat-trace",
        lambda shape, options: pr.Signature(
            np.exp(-shape.spectrum.eigenvalues[:9]), "heat-trace"
        ),
        needs=("spectrum",),
        length=lambda options: 9,
    )
    body = shapes.body()
    assert signature(body, method=own).kind == "heat-trace"
    with pytest.raises(
        ShapeError, match="the descriptor 'heat-trace' must give 8 values"
    ):
        signature(body, method=replace(own, length=lambda options: 8))


@pytest.mark.parametrize("scan", [POINTS, shapes.body(4)], ids=["cloud", "mesh"])
def test_points_need_no_surface(scan: ScanLike) -> None:
    form = {"method": "r-bihdm"}
    options = PipelineOptions().changed(spectral={"element": "points"}, signature=form)
    shape = process(scan, options)
    passed = [step.stage for step in shape.provenance]
    assert passed[-2:] == ["spectrum", "checks"]
    assert "surface" not in passed
    body = shapes.body(4)
    assert shape.area == pytest.approx(body.area, rel=0.03)
    assert shape.mesh.area == pytest.approx(shape.area, rel=0.03)
    assert shape.mesh.volume == pytest.approx(
        body.volume, rel=0.05
    )  # its faces point outwards
    error = np.log(signature(scan, options).values) - np.log(
        signature(body, {"signature": form}).values
    )
    assert np.abs(error[:23]).max() < 0.15  # which grows with the frequency


# Prints the largest memory of a process that processes one scan; kB.
PEAK = """
import re, sys
from pathlib import Path
from pcretrieve.pipeline.process import process

process(sys.argv[1])
print(re.search("VmHWM:(.*) kB", Path("/proc/self/status").read_text())[1])
"""


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["ply", "pcd", "xyz"])
def test_five_million_points_take_a_gigabyte(tmp_path: Path, suffix: str) -> None:
    points = shapes.points_on(shapes.body(), 5_000_000, noise=0.001)
    path = tmp_path / f"body.{suffix}"
    if suffix == "xyz":
        np.savetxt(path, points, fmt="%.6f")
    else:
        write_cloud(PointCloud(points), path)
    output = subprocess.run(
        [sys.executable, "-c", PEAK, path], check=True, capture_output=True, text=True
    )
    assert int(output.stdout) < 1e6


@pytest.mark.slow
@pytest.mark.parametrize("shift", [1e3, 1e6, 1e9])
def test_a_cloud_far_from_the_origin_is_the_same_body(shift: float) -> None:
    """As map coordinates are; Open3D's single precision alone would lose it, or crash."""
    cloud = PointCloud(POINTS, viewpoints=3 * POINTS)
    here = reconstruct(cloud)
    there = reconstruct(PointCloud(POINTS + shift, viewpoints=3 * POINTS + shift))
    assert there.volume == pytest.approx(here.volume, rel=1e-3)
    np.testing.assert_allclose(
        there.vertices.mean(axis=0) - shift, here.vertices.mean(axis=0), atol=1e-3
    )
    far, near = (
        signature(one, {"signature": {"method": "r-bihdm"}}).values
        for one in (there, here)
    )
    np.testing.assert_allclose(np.log(far), np.log(near), atol=0.02)


def test_sensors_move_with_their_points() -> None:
    by, above = np.array([1.0, -2, 3]), np.array([0.0, 0, 5])
    there = moved(PointCloud(POINTS, viewpoints=POINTS + above), by)
    assert there.viewpoints is not None
    np.testing.assert_allclose(there.points, POINTS + by)
    np.testing.assert_allclose(there.viewpoints, POINTS + above + by)


def test_an_error_names_its_scan_and_its_stage(tmp_path: Path) -> None:
    (tmp_path / "few.xyz").write_text("1 2 3\n4 5 6\n")
    with pytest.raises(ReconstructionError) as raised:
        reconstruct(tmp_path / "few.xyz")
    assert (raised.value.shape_id, raised.value.stage) == ("few.xyz", "crop")
    assert str(raised.value).startswith(
        "[few.xyz / crop] a scan needs at least 100 points, got 2"
    )
    with pytest.raises(
        ScanReadError, match=r"^\[gone\.ply / read\] cannot read .*gone\.ply"
    ):
        signature(tmp_path / "gone.ply")


@pytest.mark.slow
@pytest.mark.skipif(
    not DATA.is_dir(), reason="needs the Stanford scans, in ../shared/data"
)
def test_the_dragon_has_a_surface() -> None:
    """Its coils touch, its mouth is full of points, and a quarter of it no scan shows."""
    surface = reconstruct(DATA / "stanford_dragon" / "dragonStandRight.conf")
    assert surface.euler_characteristic == 2
    assert surface.provenance[-1].sizes["invented"] < 0.3


@pytest.mark.parametrize(
    "preset", sorted(set(PRESETS) - {"clean-mesh", "paper", "classic"})
)
def test_each_preset_makes_a_closed_surface_of_a_scan(preset: str) -> None:
    shape = process(HAND, PipelineOptions.of(preset))
    assert len(shape.surfaces) == 2
    assert not defects(shape.mesh)
    assert shape.mesh.volume > 0
    if preset == "body-scanner":
        assert shape.mesh.euler_characteristic == 2


def test_poisson_makes_the_same_body_and_says_what_it_does_not_use() -> None:
    options = PipelineOptions().changed(
        surface={"method": "poisson", "gap": 0.03, "genus": "sphere"}
    )
    shape = process(POINTS, options)
    assert not defects(shape.mesh)
    assert shape.mesh.volume == pytest.approx(shapes.body().volume, rel=0.05)
    assert len(shape.surfaces) == 1
    notes = [note for step in shape.provenance for note in step.notes]
    assert "surface.method = 'poisson' does not use surface.genus, surface.gap" in notes
    assert (
        "the method poisson makes one surface, so that the signature has no error bar"
        in notes
    )
    described = signature(POINTS, options)
    assert described.errors is None
    assert np.isfinite(described.values).all()


def test_each_stage_is_logged_once_with_its_repairs(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    scan = tmp_path / "body.xyz"
    np.savetxt(scan, [*POINTS, [300.0, 0, 0]])
    with caplog.at_level(logging.INFO, logger="pcretrieve.pipeline"):
        shape = process(scan, PipelineOptions())
    records = [
        record for record in caplog.records if record.name == "pcretrieve.pipeline"
    ]
    logged = [
        record.getMessage().split()[1]
        for record in records
        if record.levelno == logging.INFO
    ]
    assert logged == [step.stage for step in shape.provenance]
    assert logged[-4:] == ["surface", "surface", "spectrum", "checks"]
    repairs = [
        record.getMessage() for record in records if record.levelno == logging.WARNING
    ]
    assert repairs == [
        f"body.xyz: {step.stage}: {note}"
        for step in shape.provenance
        for note in step.notes
    ]
    assert any(
        "dropped 1 of 8001 points more than 20 median distances" in repair
        for repair in repairs
    )


def test_bodies_of_one_size_have_one_size_in_the_signature_whatever_unit_their_files_have(
    tmp_path: Path,
) -> None:
    """The same body in metres, and in millimetres in a file without a unit."""
    body, metres, millimetres = (
        shapes.body(2),
        tmp_path / "metres.glb",
        tmp_path / "millimetres.off",
    )
    write_mesh(body, metres)
    write_mesh(TriangleMesh(1000 * body.vertices, body.faces), millimetres)
    sized = {"signature": {"method": "r-bihdm", "size_weight": 6}}
    in_metres = signature(metres, sized).values
    # A file that has a unit is not converted again.
    for file in (metres, millimetres):
        np.testing.assert_allclose(
            signature(file, {**sized, "scan": {"unit": "mm"}}).values,
            in_metres,
            rtol=1e-4,
        )
    assert signature(millimetres, sized).values[-1] > 1e6 * in_metres[-1]

    catalogue = tmp_path / "bodies.sqlite"
    run("ingest", metres, millimetres, "-c", catalogue, "--unit", "mm", "--workers", 1)
    with Catalogue(catalogue) as store:
        records = [store.record(shape_id) for shape_id in ("metres", "millimetres")]
    assert [record.metres_per_unit for record in records] == [1, 1]
    assert records[0].area == pytest.approx(records[1].area, rel=1e-4)


def test_a_failure_tells_what_the_reader_left_out(tmp_path: Path) -> None:
    """One side of a body, whose file has a reading that is none."""
    cap = shapes.points_on(shapes.icosphere(3), 3000)
    rows = [*(cap[cap[:, 2] > 0.2]).tolist(), ["nan"] * 3]
    (tmp_path / "a.xyz").write_text("\n".join(" ".join(map(str, row)) for row in rows))
    with pytest.raises(ReconstructionError) as raised:
        pr.reconstruct(tmp_path / "a.xyz")
    assert "scan the sides that are missing" in raised.value.message
    assert "; dropped 1 of " in raised.value.message


def test_points_on_all_sides_get_no_advice_to_scan_others() -> None:
    """Points in a cube, not on it: their normals point anywhere, and no surface through them is closed."""
    points = np.random.default_rng(0).uniform(-1, 1, (6000, 3))
    with pytest.raises(
        ReconstructionError, match="their normals contradict each other: scan with less"
    ):
        pr.reconstruct(points)


def test_a_failure_of_one_view_says_that_it_is_one_and_names_merge() -> None:
    ball = shapes.icosphere(3)
    sensor = np.array([0.0, 0.0, 4.0])
    front = shapes.points_on(ball, 6000)
    front = front[front @ sensor > 1]
    for sensors, is_one in ((None, False), ([sensor], True), ([sensor, -sensor], False)):
        given = None if sensors is None else np.resize(sensors, front.shape)
        with pytest.raises(ReconstructionError) as raised:
            pr.reconstruct(PointCloud(front, viewpoints=given))
        words = "this is one view of the body: join it with views of its other sides"
        assert (words in raised.value.message) == is_one, raised.value.message
