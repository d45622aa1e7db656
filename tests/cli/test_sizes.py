"""Sizes of bodies are compared in one unit, or not at all, by every command."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import shapes
from click.testing import CliRunner, Result

import pcretrieve as pr
from pcretrieve.cli.main import cli
from pcretrieve.errors import InputError
from pcretrieve.formats import write_mesh
from pcretrieve.values import TriangleMesh

# Areas that differ by a factor of 1.44, of bodies of one form, which only their sizes tell apart.
HEIGHTS = {"small": 1.0, "large": 1.2}
SIZED = ("--size-weight", "6")
SAY_THE_UNIT = r"say the unit of the query by --unit \(scan.unit\), or compare the form alone"


def body(path: Path, height: float, metres: float = 1.0) -> Path:
    """A file of an ellipsoid of some height, in a unit of some metres."""
    mesh = shapes.ellipsoid((1, 1, 1.7), subdivisions=3)
    write_mesh(TriangleMesh(mesh.vertices * height / metres, mesh.faces), path)
    return path


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli, list(map(str, arguments)))


def refusal(*arguments: object) -> str:
    """The message of a command that refuses its input."""
    result = run(*arguments)
    assert isinstance(result.exception, InputError), result.output
    return str(result.exception)


@pytest.fixture
def in_metres(tmp_path: Path) -> Path:
    """A catalogue of shapes in metres, from files that say so."""
    files = [body(tmp_path / f"{name}.glb", height) for name, height in HEIGHTS.items()]
    catalogue = tmp_path / "metres.sqlite"
    assert run("ingest", *files, "-c", catalogue, "--workers", "1").exit_code == 0
    return catalogue


@pytest.fixture
def centimetres(tmp_path: Path) -> Path:
    """The large body, in centimetres, in a file that does not say so."""
    return body(tmp_path / "query.off", HEIGHTS["large"], metres=0.01)


def test_a_query_in_another_unit_is_converted(in_metres: Path, centimetres: Path) -> None:
    result = run("query", centimetres, "-c", in_metres, *SIZED, "--unit", "cm", "--json")
    assert result.exit_code == 0, result.output
    first, second = json.loads(result.stdout)["result"][0]["results"]
    assert (first["id"], second["id"]) == ("large", "small")
    assert first["distance"] < 0.05
    assert second["distance"] == pytest.approx(6 * np.log(1.2**2), rel=0.01)
    found = pr.search(in_metres, centimetres, options={"signature": {"size_weight": 6}}, unit="cm")
    assert found.distances.tolist() == [first["distance"], second["distance"]]


def test_a_query_without_a_unit_is_refused(in_metres: Path, centimetres: Path) -> None:
    for flags in (SIZED, ("--scale", "absolute")):
        message = refusal("query", centimetres, "-c", in_metres, *flags)
        assert "the shapes are in metres, the unit of the query is unknown; say the unit" in message
    sized = {"signature": {"size_weight": 6}}
    with pytest.raises(InputError, match=SAY_THE_UNIT):
        pr.search(in_metres, centimetres, options=sized)
    with pytest.raises(InputError, match=SAY_THE_UNIT):
        pr.search(in_metres, pr.signature(centimetres, sized), options=sized)
    with pytest.raises(InputError, match=SAY_THE_UNIT):
        pr.search(in_metres, pr.read_scan(centimetres), options=sized)
    known = pr.search(in_metres, pr.read_scan(centimetres), options=sized, unit="cm")
    assert known.ids == ("large", "small")
    signed = pr.signature(centimetres, {**sized, "scan": {"unit": "cm"}})
    assert pr.search(in_metres, signed, options=sized) == known


def test_a_catalogue_of_some_known_units_compares_no_sizes(in_metres: Path, centimetres: Path) -> None:
    labels = in_metres.with_name("labels.csv")
    labels.write_text("file,class\nlarge,a\nsmall,a\nquery,a\n")
    assert run("ingest", centimetres, "-c", in_metres, "--workers", "1").exit_code == 0
    commands = (
        ("query", "large", "-c", in_metres),
        ("evaluate", "-c", in_metres, "--labels", labels),
        ("report", "-c", in_metres, "-o", in_metres.with_name("page.html")),
        ("matrix", "-c", in_metres, "-o", in_metres.with_name("matrix.txt")),
    )
    for command in commands:
        message = refusal(*command, *SIZED)
        assert "some shapes are in metres, the unit of others is unknown; ingest all" in message
        result = run(*command)
        assert result.exit_code == 0, result.output
