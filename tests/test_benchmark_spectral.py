"""The benchmark of the spectral core: its meshes are surfaces, and it runs."""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes

from pcretrieve.surface import defects
from pcretrieve.types import TriangleMesh

SCRIPT = Path(__file__).parents[1] / "scripts" / "benchmark_spectral"


@pytest.fixture(scope="module")
def script() -> dict[str, Any]:
    return runpy.run_path(str(SCRIPT))


def test_the_bumpy_sphere_is_closed_and_right_side_out(script: dict[str, Any]) -> None:
    mesh: TriangleMesh = script["bumpy"](500)
    assert len(mesh.vertices) == 500
    assert len(mesh.faces) == 2 * 500 - 4
    corners = mesh.vertices[mesh.faces]
    assert np.linalg.det(corners).sum() / 6 > 1
    assert not defects(mesh)


def test_quartering_keeps_the_surface(script: dict[str, Any]) -> None:
    mesh = shapes.body(2)
    finer: TriangleMesh = script["quartered"](mesh)
    assert len(finer.faces) == 4 * len(mesh.faces)
    assert len(finer.vertices) == len(mesh.vertices) + 3 * len(mesh.faces) // 2
    np.testing.assert_allclose(np.sort(finer.face_areas), np.sort(np.repeat(mesh.face_areas / 4, 4)))


def test_cubic_elements_have_order_six_on_the_square(script: dict[str, Any]) -> None:
    for boundary, largest in (("neumann", 1e-6), ("dirichlet", 1e-5)):
        errors, orders = script["square_errors"]((3, 5), boundary)
        assert 0 < errors[1] < largest, "at 36 vertices"
        assert 5.8 < orders[0] < 6.2


def test_it_prints_the_time_of_a_signature() -> None:
    ended = subprocess.run(
        [sys.executable, SCRIPT, "--part", "signature"], capture_output=True, text=True, env=dict(os.environ)
    )
    assert ended.returncode == 0, ended.stderr
    assert "mesh of 5000 vertices -> r-bihdm: median 0." in ended.stdout
