"""`signature`, `reconstruct` and `inspect` of a folder of scans; and what commands say that take long."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import shapes
from click.testing import CliRunner, Result

from pcretrieve import read_scan
from pcretrieve.cli.main import cli
from pcretrieve.formats import write_mesh
from pcretrieve.values import TriangleMesh

LENGTHS = {"a": 1.5, "b": 2.0, "c": 3.0}


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, [*map(str, arguments)])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three eggs, of which the first takes longest, and a file that cannot be read."""
    (tmp_path / "scans" / "more").mkdir(parents=True)
    for name, length in LENGTHS.items():
        egg = shapes.ellipsoid((1, 1, length), subdivisions=5 if name == "a" else 3)
        write_mesh(egg, tmp_path / "scans" / ("more" if name == "c" else "") / f"{name}.off")
    (tmp_path / "scans" / "bad.off").write_text("OFF\n")
    return tmp_path / "scans"


def test_signatures_are_those_of_the_single_scans_in_their_order(folder: Path) -> None:
    done = run("signature", folder, "--workers", "2")
    assert done.exit_code == 3
    assert done.stderr.startswith("signature: 4 scans\n")
    assert "failed: [bad / read]" in done.stderr
    lines = [line.split("\t") for line in done.stdout.splitlines()]
    assert [Path(line[0]).stem for line in lines] == ["a", "b", "c"]
    for path, *values in lines:
        assert run("signature", path).stdout.strip().split("\t")[1:] == values


def test_each_scan_of_a_folder_is_reconstructed(folder: Path, tmp_path: Path) -> None:
    done = run("reconstruct", folder, "-o", tmp_path / "meshes", "--suffix", ".obj", "--json")
    assert done.exit_code == 3
    assert {path.name for path in (tmp_path / "meshes").iterdir()} == {"a.obj", "b.obj", "c.obj"}
    by_name = {Path(found["scan"]).stem: found for found in json.loads(done.stdout)["result"]}
    assert by_name["bad"]["error"] == "ScanReadError"
    for name, length in LENGTHS.items():
        mesh = read_scan(tmp_path / "meshes" / f"{name}.obj")
        assert isinstance(mesh, TriangleMesh)
        assert np.ptp(mesh.vertices, axis=0)[2] == pytest.approx(2 * length, rel=0.01)
        assert by_name[name]["faces"] == len(mesh.faces)
    assert f"3 surfaces are in {tmp_path / 'meshes'}, 1 scans failed" in done.stderr


def test_results_are_not_put_among_the_scans(folder: Path) -> None:
    for command in ("reconstruct", "inspect"):
        refused = run(command, folder, "-o", folder / "results")
        assert "whose files are read: name another folder with -o" in str(refused.exception)
    assert not (folder / "results").exists()
    assert run("inspect", folder).exit_code == 2
