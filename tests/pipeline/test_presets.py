"""Each preset, and each method of reconstruction, makes a surface and a signature of a real scan."""

from __future__ import annotations

from pathlib import Path

import pytest
import shapes

from pcretrieve import PipelineOptions, signature
from pcretrieve.options import PRESETS
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
