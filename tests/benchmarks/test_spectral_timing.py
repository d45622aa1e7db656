"""The benchmark of the spectral core: its meshes are surfaces, and it runs."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import shapes

from pcretrieve.benchmarks.spectral import Boundary, square_errors
from pcretrieve.benchmarks.surfaces import bumpy_sphere, quartered
from pcretrieve.surface import defects

SCRIPT = Path(__file__).parents[2] / "scripts" / "benchmark_spectral"


def test_the_bumpy_sphere_is_closed_and_right_side_out() -> None:
    mesh = bumpy_sphere(500)
    assert len(mesh.vertices) == 500
    assert len(mesh.faces) == 2 * 500 - 4
    corners = mesh.vertices[mesh.faces]
    assert np.linalg.det(corners).sum() / 6 > 1
    assert not defects(mesh)


def test_quartering_keeps_the_surface() -> None:
    mesh = shapes.body(2)
    finer = quartered(mesh)
    assert len(finer.faces) == 4 * len(mesh.faces)
    assert len(finer.vertices) == len(mesh.vertices) + 3 * len(mesh.faces) // 2
    np.testing.assert_allclose(np.sort(finer.face_areas), np.sort(np.repeat(mesh.face_areas / 4, 4)))


def test_cubic_elements_have_order_six_on_the_square() -> None:
    bounds: dict[Boundary, float] = {"neumann": 1e-6, "dirichlet": 1e-5}
    for boundary, largest in bounds.items():
        errors, orders = square_errors((3, 5), boundary)
        assert 0 < errors[1] < largest, "at 36 vertices"
        assert 5.8 < orders[0] < 6.2


def test_it_prints_the_time_of_a_signature(tmp_path: Path) -> None:
    ended = subprocess.run(
        [sys.executable, SCRIPT, "--part", "signature", "--data", tmp_path], capture_output=True, text=True
    )
    assert ended.returncode == 0, ended.stderr
    assert re.fullmatch(
        r"mesh of 5000 vertices -> r-bihdm: median \d+\.\d{3} s, best \d+\.\d{3} s\n", ended.stdout
    )
