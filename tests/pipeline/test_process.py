"""What holds of the whole way from a scan to its signature."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapes

from pcretrieve import PipelineOptions, PointCloud, TriangleMesh, reconstruct, signature
from pcretrieve.errors import ReconstructionError, ScanReadError
from pcretrieve.pipeline.process import process

POINTS = shapes.points_on(shapes.body(), 8000)

DATA = Path(__file__).parents[2].parent / "shared" / "data"


def test_a_mesh_has_one_signature_in_any_unit_and_place() -> None:
    body = shapes.body()
    values = signature(body).values
    for scale, shift in ((1e-3, 0), (1e3, 0), (1, 1e6)):
        other = TriangleMesh(scale * body.vertices + shift, body.faces)
        np.testing.assert_allclose(signature(other).values, values, rtol=1e-6)


@pytest.mark.parametrize("scan", [POINTS, shapes.body(4)], ids=["cloud", "mesh"])
def test_points_need_no_surface(scan: object) -> None:
    options = PipelineOptions().changed(spectral={"element": "points"})
    shape = process(scan, options)
    stages = [step.stage for step in shape.provenance]
    assert stages[-2:] == ["spectrum", "checks"]
    assert "surface" not in stages
    body = shapes.body(4)
    assert shape.area == pytest.approx(body.area, rel=0.03)
    assert shape.mesh.area == pytest.approx(shape.area, rel=0.03)
    assert shape.mesh.volume == pytest.approx(body.volume, rel=0.05)  # its faces point outwards
    error = np.log(signature(scan, options).values) - np.log(signature(body).values)
    assert np.abs(error[:23]).max() < 0.15  # which grows with the frequency


@pytest.mark.slow
@pytest.mark.parametrize("shift", [1e3, 1e6, 1e9])
def test_a_cloud_far_from_the_origin_is_the_same_body(shift: float) -> None:
    """As map coordinates are; Open3D's single precision alone would lose it, or crash."""
    cloud = PointCloud(POINTS, viewpoints=3 * POINTS)
    here = reconstruct(cloud)
    there = reconstruct(PointCloud(POINTS + shift, viewpoints=3 * POINTS + shift))
    assert there.volume == pytest.approx(here.volume, rel=1e-3)
    np.testing.assert_allclose(there.vertices.mean(axis=0) - shift, here.vertices.mean(axis=0), atol=1e-3)
    np.testing.assert_allclose(np.log(signature(there).values), np.log(signature(here).values), atol=0.02)


def test_an_error_names_its_scan_and_its_stage(tmp_path: Path) -> None:
    (tmp_path / "few.xyz").write_text("1 2 3\n4 5 6\n")
    with pytest.raises(ReconstructionError) as raised:
        reconstruct(tmp_path / "few.xyz")
    assert (raised.value.shape_id, raised.value.stage) == ("few.xyz", "crop")
    assert str(raised.value).startswith("[few.xyz / crop] a scan needs at least 100 points, got 2")
    with pytest.raises(ScanReadError, match=r"^\[gone\.ply / read\] cannot read .*gone\.ply"):
        signature(tmp_path / "gone.ply")


def test_an_empty_cloud() -> None:
    with pytest.raises(ReconstructionError, match="at least 100 points, got 0"):
        reconstruct(np.empty((0, 3)))


@pytest.mark.slow
@pytest.mark.skipif(
    not DATA.is_dir(), reason="needs the Stanford dragon beside the checkout, in ../shared/data"
)
def test_the_dragon_has_a_surface() -> None:
    """Its coils touch, its mouth is full of points, and a quarter of it no scan shows."""
    surface = reconstruct(DATA / "stanford_dragon" / "dragonStandRight.conf")
    assert surface.euler_characteristic == 2
    assert surface.provenance[-1].sizes["invented"] < 0.3
