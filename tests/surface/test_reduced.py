"""Meshes that are used as they are, and have very many faces, are simplified to `surface.max_faces`."""

from __future__ import annotations

import numpy as np
import pytest
import shapes

import pcretrieve as pr
from pcretrieve.pipeline.process import process
from pcretrieve.surface.topology import compact
from pcretrieve.values import Step, TriangleMesh

FINE = shapes.ellipsoid((1, 1.3, 1.9), subdivisions=5)  # 20,480 faces
FEW = 5000


def kept(mode: str, max_faces: int) -> pr.PipelineOptions:
    return pr.PipelineOptions().changed(surface={"mode": mode, "max_faces": max_faces})


def step_of(mesh: TriangleMesh) -> Step:
    (step,) = (step for step in mesh.provenance if step.stage == "simplify")
    return step


@pytest.mark.parametrize("mode", ["auto", "keep"])
def test_a_fine_mesh_has_the_signature_of_a_simplified_one(mode: str) -> None:
    whole = pr.signature(FINE, kept(mode, len(FINE.faces)))
    shape = process(FINE, kept(mode, FEW))
    assert FEW - 2 <= len(shape.mesh.faces) <= FEW
    step = step_of(shape.mesh)
    assert step.sizes == {"faces_in": len(FINE.faces), "faces": len(shape.mesh.faces), "euler": 2}
    assert step.notes == ("simplified, because it had more faces than surface.max_faces",)
    assert step in shape.provenance
    assert shape.area == pytest.approx(FINE.area, rel=1e-3)
    coarse = np.log(pr.signature(FINE, kept(mode, FEW)).values / whole.values)
    assert 0 < np.abs(coarse).max() < 0.08


def test_a_mesh_with_a_hole_stays_one() -> None:
    half = compact(FINE.vertices, FINE.faces[FINE.vertices[FINE.faces][:, :, 2].mean(axis=1) > 0])
    assert half.euler_characteristic == 1
    mesh = pr.reconstruct(half, kept("keep", FEW))
    assert FEW - 100 < len(mesh.faces) <= FEW
    assert step_of(mesh).sizes["euler"] == mesh.euler_characteristic == 1
    assert mesh.area == pytest.approx(half.area, rel=2e-3)
    full, coarse = (pr.signature(half, kept("keep", n)).values for n in (len(half.faces), FEW))
    assert np.abs(np.log(coarse / full)).max() < 0.08


def test_catalogues_of_before_are_of_the_default() -> None:
    default = pr.PipelineOptions()
    assert kept("auto", FEW).digest != default.digest
    older = default.model_dump(exclude={"surface": {"max_faces"}})
    assert pr.PipelineOptions(**older).digest == default.digest == kept("auto", 200_000).digest
