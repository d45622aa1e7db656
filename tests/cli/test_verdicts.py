"""What the commands say of shapes that are doubtful or unusable."""

from __future__ import annotations

import json
from pathlib import Path

import shapes
from click.testing import CliRunner, Result

from pcretrieve import write_mesh
from pcretrieve.cli.main import cli
from pcretrieve.values import TriangleMesh


def run(*arguments: object) -> Result:
    result = CliRunner().invoke(cli, [str(word) for word in arguments])
    assert result.exit_code == 0, result.output
    return result


def test_ingest_sums_them_up_and_a_query_says_so(tmp_path: Path) -> None:
    ball, body = shapes.icosphere(3), shapes.body(3)
    write_mesh(TriangleMesh(ball.vertices, ball.faces[12:]), tmp_path / "open.off")
    write_mesh(body, tmp_path / "whole.off")
    catalogue = tmp_path / "c.sqlite"
    scans = tmp_path / "open.off", tmp_path / "whole.off"
    done = run("ingest", *scans, "-c", catalogue, "--surface", "keep", "--workers", 1, "--json")
    assert "1 doubtful, 0 unusable by the checks of their scans: " in done.stderr
    advice = done.stderr.split("`")[1].split()
    assert advice == ["pcretrieve", "list", "--doubtful", "-c", str(catalogue)]
    assert "closed surface: " in run(*advice[1:]).stdout
    assert json.loads(done.stdout)["result"]["doubtful"] == ["open"]
    write_mesh(TriangleMesh(body.vertices, body.faces[12:]), tmp_path / "other.off")
    asked = run("query", "-c", catalogue, tmp_path / "other.off")
    assert "other.off is doubtful, ± 0.3: closed surface: " in asked.stderr
    assert [line.split()[4] for line in asked.stdout.splitlines() if "  doubtful, ± " in line] == ["open"]
