"""What the commands say of shapes that are doubtful or unusable."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import shapes
from click.testing import CliRunner, Result

from pcretrieve import Catalogue, PipelineOptions, write_mesh
from pcretrieve.catalogue import Content, Record
from pcretrieve.cli.main import cli
from pcretrieve.descriptors import describe
from pcretrieve.pipeline.process import process
from pcretrieve.values import TriangleMesh, Verdict

OPTIONS = PipelineOptions()
VERDICTS = {
    "a1": Verdict("sound", 0.05),
    "a2": Verdict("doubtful", 0.4, ("gaps: wide",)),
    "a3": None,
    "b1": Verdict("sound", 0.05),
    "b2": Verdict("sound", 0.05),
    "b3": Verdict("unusable", 2.0, ("closed ends: many",)),
}


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six ellipsoids of two classes, the first letter of their names."""
    location = tmp_path_factory.mktemp("verdicts") / "c.sqlite"
    with Catalogue(location, create=True) as store:
        for number, (name, verdict) in enumerate(VERDICTS.items()):
            shape = process(shapes.ellipsoid((1, 0.5 + 0.05 * number, 0.4), 3))
            content = Content(replace(shape, verdict=verdict), describe(shape, OPTIONS.signature).values)
            store.put(Record(name, f"/{name}.off", f"hash {name}", label=name[0]), content)
    return location


def run(*arguments: object) -> Result:
    result = CliRunner().invoke(cli, [str(word) for word in arguments])
    assert result.exit_code == 0, result.output
    return result


def test_doubtful_shapes_are_listed_with_their_reasons(path: Path) -> None:
    _, *doubtful = run("list", "-c", path, "--doubtful").stdout.splitlines()
    assert [line.split()[:2] for line in doubtful] == [["a2", "doubtful"], ["b3", "unusable"]]
    assert doubtful[0].endswith("  doubtful, ± 0.4: gaps: wide")
    everything = json.loads(run("list", "-c", path, "--json").stdout)["result"]
    assert [row["verdict"] and row["verdict"]["judgement"] for row in everything] == [
        verdict and verdict.judgement for verdict in VERDICTS.values()
    ]
    assert "not judged" in run("show", "-c", path, "a3").stdout
    assert "doubtful, ± 0.4: gaps: wide" in run("show", "-c", path, "a2").stdout


def test_a_result_comes_with_its_verdict(path: Path) -> None:
    found = {line.split()[4]: line for line in run("query", "-c", path, "a1").stdout.splitlines()}
    assert found["b3"].endswith("  unusable, ± 2")
    assert found["a3"].endswith(".off") and found["b1"].endswith(".off")
    (answer,) = json.loads(run("query", "-c", path, "a1", "--json").stdout)["result"]
    (row,) = [row for row in answer["results"] if row["id"] == "a2"]
    assert row["verdict"] == {"judgement": "doubtful", "uncertainty": 0.4, "reasons": ["gaps: wide"]}


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
