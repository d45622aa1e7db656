"""The figures of the README are printed for the sets that are there."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import shapes

from pcretrieve.benchmarks.surfaces import bumpy_sphere
from pcretrieve.formats import write_mesh
from pcretrieve.values import TriangleMesh

SCRIPT = Path(__file__).parents[2] / "scripts" / "benchmark_figures"


def write_set(folder: Path, meshes: dict[str, list[TriangleMesh]]) -> None:
    folder.mkdir()
    lines = ["file,class"]
    for label, own in meshes.items():
        for number, mesh in enumerate(own):
            write_mesh(mesh, folder / f"{label}{number}.off")
            lines.append(f"{label}{number}.off,{label}")
    (folder / "labels.csv").write_text("\n".join(lines))


def test_both_sets_are_evaluated_and_the_missing_one_is_said(tmp_path: Path) -> None:
    eggs = {
        f"egg{number}": [
            shapes.moved(shapes.ellipsoid((1, 1, 1 + number / 2), subdivisions=3), copy) for copy in range(2)
        ]
        for number in range(5)
    }
    write_set(tmp_path / "shrec11", eggs)
    bumpy = bumpy_sphere(2000)
    write_set(tmp_path / "tosca", {"bumpy": [bumpy, shapes.moved(bumpy, 1)]})
    ended = subprocess.run(
        [sys.executable, SCRIPT, "--data", tmp_path, "--samples", tmp_path / "none"],
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 0, ended.stderr
    head, *lines = ended.stdout.splitlines()
    assert head.split() == ["figure", "measured"]
    measured = {line[:58].rstrip(): line[59:] for line in lines}
    assert f"stanford_dragon: left out, {tmp_path / 'stanford_dragon'} is not there" in lines
    assert measured["SHREC'11 L=23 relative D2 no whitening"].startswith("NN 1.0000 FT 1.0000")
    assert measured["TOSCA scans with a closed manifold surface"] == "100.0% of 2"
    assert measured["TOSCA rebuilt from noisy scans"].startswith("NN 1.0000")
    assert measured["  Euler characteristic 2"] == "100%"
    error = measured["  log-signature error against the clean mesh, relative"]
    assert 0 < float(error.removeprefix("median ")) < 0.5
    assert "peak" in measured["30k points -> signature, whole command, one core"]
