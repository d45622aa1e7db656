"""Each preset, and each method of reconstruction, makes a surface and a signature of a real scan."""

from __future__ import annotations

from pathlib import Path

import pytest
import shapes

from pcretrieve import PipelineOptions, signature
from pcretrieve.descriptors import describe
from pcretrieve.options import PRESETS, SurfaceOptions
from pcretrieve.pipeline.process import process
from pcretrieve.surface import defects

SCAN = Path(__file__).parents[2] / "scans" / "hand-1" / "hand-1_fist.ply"


@pytest.mark.parametrize("preset", sorted(set(PRESETS) - {"clean-mesh", "paper", "classic"}))
def test_each_preset_makes_a_closed_surface_of_a_scan(preset: str) -> None:
    shape = process(SCAN, PipelineOptions.preset(preset))
    assert len(shape.surfaces) == 2
    assert not defects(shape.mesh)
    assert shape.mesh.volume > 0
    if preset == "body-scanner":
        assert shape.mesh.euler_characteristic == 2


def test_the_preset_for_clean_meshes_keeps_the_surface() -> None:
    body = shapes.body(3)
    shape = process(body, PipelineOptions.preset("clean-mesh"))
    assert len(shape.mesh.vertices) == len(body.vertices)  # in another order
    assert shape.mesh.area == pytest.approx(body.area, rel=1e-12)
    assert signature(body, "clean-mesh").values.shape == (118,)
    assert signature(body, "paper").values.shape == (23,)


def test_the_classic_chain_runs_by_its_own_stages() -> None:
    options = PipelineOptions.preset("classic")
    shape = process(SCAN, options)
    stages = {step.stage: step for step in shape.provenance}
    assert {"remesh", "surface"} <= set(stages)
    assert len(shape.surfaces) == 1
    assert not defects(shape.mesh)
    assert len(describe(shape, options.signature).values) == options.signature.n_values
    assert options.retrieval.whitening == "pca"


def test_poisson_makes_the_same_body_and_says_what_it_does_not_use() -> None:
    options = PipelineOptions().changed(surface={"method": "poisson", "gap": 0.03, "genus": "sphere"})
    scan = shapes.points_on(shapes.body(), 8000)
    shape = process(scan, options)
    assert not defects(shape.mesh)
    assert shape.mesh.volume == pytest.approx(shapes.body().volume, rel=0.05)
    assert len(shape.surfaces) == 1
    notes = [note for step in shape.provenance for note in step.notes]
    assert "surface.method = 'poisson' does not use surface.genus, surface.gap" in notes
    assert "the method poisson makes one surface, so that the signature has no error bar" in notes
    described = signature(scan, options)
    assert described.deviation is None
    assert (described.values > 0).all()


def test_only_changed_options_of_the_other_method_are_unused() -> None:
    assert SurfaceOptions().unused == SurfaceOptions(method="poisson").unused == ()
    assert SurfaceOptions(poisson_depth=8, gap=0.03).unused == ("surface.poisson_depth",)
    assert SurfaceOptions(method="poisson", poisson_depth=8, cell=0.01).unused == ("surface.cell",)
