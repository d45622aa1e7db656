"""`--labels` with the name of a layout: from the files to the measures, with published ones beside them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import shapes
from click.testing import CliRunner, Result

import pcretrieve as pr
from pcretrieve.cli.main import cli
from pcretrieve.evaluation import PUBLISHED
from pcretrieve.ingestion.labels import LAYOUTS


def run(*arguments: object, code: int = 0) -> Result:
    result = CliRunner().invoke(cli, [str(word) for word in arguments])
    assert result.exit_code == code, result.output
    return result


@pytest.fixture(scope="module")
def eggs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eggs of two kinds named as in TOSCA, with the numbers of a `.cla` file."""
    place = tmp_path_factory.mktemp("eggs")
    for number in range(4):
        mesh = shapes.ellipsoid((1 + 0.1 * (number % 2), 1, 1 + number // 2), subdivisions=3)
        pr.write_mesh(mesh, place / f"{'flat' if number < 2 else 'long'}{number}.off")
    (place / "test.cla").write_text("PSB 1\n2 4\n\nA 0 2\n0\n1\n\nB 0 2\n2\n3\n")
    run("ingest", place, "--labels", "tosca", "-c", place / "eggs.sqlite", "--workers", 1)
    return place


def test_published_measures_are_below_ours(eggs: Path) -> None:
    asked = ("evaluate", "-c", eggs / "eggs.sqlite", "--per-class")
    ours = run(*asked, "--labels", eggs / "test.cla").stdout.splitlines()
    result = run(*asked, "--labels", "shrec11")
    lines = result.stdout.splitlines()
    assert lines[: len(ours)] == ours
    assert len(lines) == len(ours) + len(PUBLISHED["shrec11"])
    assert lines[-1] == (
        "1.0000  0.9710  0.9830  0.7300  0.9940       -  published: R-BiHDM, L = 23 (Ye and Yu, table 3)"
    )
    assert result.stderr.endswith(f"shrec11: {LAYOUTS['shrec11'].protocol}\n")
    found = json.loads(run(*asked, "--labels", "shrec11", "--json").stdout)["result"]
    assert [row["method"] for row in found["published"]] == [row.method for row in PUBLISHED["shrec11"]]
    assert found["published"][0]["map"] is None


def test_the_help_names_all_layouts() -> None:
    shown = run("ingest", "--help").output.replace("\n", " ")
    assert all(name in shown for name in LAYOUTS)
