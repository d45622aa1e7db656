"""A package that adds one of every kind: each is used by its name, as those of pcretrieve are."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import shapes
from packages import install_addition
from scipy.spatial import ConvexHull

from pcretrieve import PipelineOptions, laplace_beltrami, reconstruct, signature
from pcretrieve.errors import OptionError

MESH = shapes.body(3)

CHAIN = """
[pipeline]
stages = ["cut", "clean", "orient", "hull", "stretch", "spectrum"]

[pipeline.cut]
height = 0.8
"""


@pytest.fixture(autouse=True)
def _installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install_addition(tmp_path / "site", monkeypatch)


def test_a_descriptor() -> None:
    options = PipelineOptions().changed(signature={"method": "girth", "n_values": 5})
    values = signature(MESH, options).values
    assert len(values) == 5
    assert (np.diff(values) > 0).all()


def test_an_element() -> None:
    soft, linear = (laplace_beltrami(MESH, element) for element in ("soft", "linear"))
    assert abs(2 * soft.stiffness - linear.stiffness).max() < 1e-12
    options = PipelineOptions().changed(
        spectral={"element": "soft"}, signature={"method": "shape-dna", "scale": "absolute"}
    )
    linear_options = options.changed(spectral={"element": "linear"})
    np.testing.assert_allclose(
        signature(MESH, options).values, 2 * signature(MESH, linear_options).values, rtol=1e-6
    )


def test_a_surface_method() -> None:
    scan = shapes.points_on(MESH, 4000)
    options = PipelineOptions().changed(surface={"method": "hull"})
    surface = reconstruct(scan, options)
    assert [step.stage for step in surface.provenance] == ["crop", "clean", "orient", "surface"]
    assert surface.volume == pytest.approx(ConvexHull(scan).volume, rel=0.02)
    assert signature(scan, options).deviation is None


def test_filters_in_a_chain(tmp_path: Path) -> None:
    (tmp_path / "chain.toml").write_text(CHAIN)
    scan = shapes.points_on(MESH, 4000)
    surface = reconstruct(scan, tmp_path / "chain.toml")
    assert [step.stage for step in surface.provenance] == ["cut", "clean", "orient", "surface", "stretch"]
    low = scan[scan[:, 2] < 0.8]
    assert surface.provenance[0].sizes == {"points_in": 4000, "points": len(low)}
    assert surface.volume == pytest.approx(2 * ConvexHull(low).volume, rel=0.03)


def test_filters_of_the_command_line(tmp_path: Path) -> None:
    (tmp_path / "chain.toml").write_text(CHAIN)
    np.savetxt(tmp_path / "scan.xyz", shapes.points_on(MESH, 4000))
    path = os.pathsep.join([str(tmp_path / "site"), *filter(None, [os.environ.get("PYTHONPATH")])])

    def run(*arguments: str) -> str:
        command = [sys.executable, "-m", "pcretrieve", *arguments, "--config", "chain.toml"]
        environment = os.environ | {"PYTHONPATH": path}
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    answer = json.loads(run("reconstruct", "scan.xyz", "-o", "body.ply", "--json"))["result"]
    stages = [step["stage"] for step in answer["steps"]]
    assert stages == ["read", "cut", "clean", "orient", "surface", "stretch"]
    surface = reconstruct(tmp_path / "scan.xyz", tmp_path / "chain.toml")
    assert answer["volume"] == pytest.approx(surface.volume, rel=1e-9)
    printed = run("options")
    (tmp_path / "printed.toml").write_text(printed)
    options = PipelineOptions.from_toml(tmp_path / "printed.toml")
    assert options == PipelineOptions.from_toml(tmp_path / "chain.toml")
    assert 'stages = ["cut", "clean", "orient", "surface", "stretch", "spectrum"]' in printed
    assert "# The z coordinate of the plane; unit of the file.\nheight = 0.8\n" in printed


def test_without_the_package_its_names_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    for stage, name in {
        "surface": "method",
        "signature": "method",
        "spectral": "element",
    }.items():
        with pytest.raises(
            OptionError, match=rf"in \[{stage}\], {name}: input should be one of .*, got 'soft'"
        ):
            PipelineOptions().changed(**{stage: {name: "soft"}})
