"""`pcretrieve query`, `evaluate`, `report`: which scale signatures are compared by, and that it is said."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import shapes
from click.testing import CliRunner, Result

from pcretrieve import Catalogue, PipelineOptions, ingest
from pcretrieve.cli.main import cli
from pcretrieve.formats import write_mesh
from pcretrieve.options import describe_options

PCA = ("--whitening", "pca")
N_CLASSES = 4


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Eggs of four kinds, three that differ a little of each."""
    folder, found = tmp_path_factory.mktemp("eggs"), []
    for kind in range(N_CLASSES):
        for number in range(3):
            axes = (1 + 0.1 * number, 1, 1.2 + 0.15 * kind)
            found.append(folder / f"{kind}{number}.off")
            write_mesh(shapes.ellipsoid(axes, subdivisions=3), found[-1])
    return found


@pytest.fixture(scope="module", params=["area", "relative"])
def catalogue(
    request: pytest.FixtureRequest, files: list[Path], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """R-BiHDM, whose values have a scale: one by the default scale, and one that was told to be relative."""
    path = tmp_path_factory.mktemp(request.param) / "c.sqlite"
    built = {
        "area": PipelineOptions().changed(signature={"method": "r-bihdm"}),
        "relative": PipelineOptions().changed(signature={"method": "r-bihdm", "scale": "relative"}),
    }
    with Catalogue(path, built[request.param], create=True) as store:
        ingest(files, store, labels={file.name: f"kind{file.name[0]}" for file in files})
    return path


def run(*arguments: object, code: int = 0) -> Result:
    result = CliRunner().invoke(cli, [str(word) for word in arguments])
    assert result.exit_code == code, result.output
    return result


def results(done: Result) -> list[dict[str, Any]]:
    """The results of the only query."""
    (answer,) = json.loads(done.stdout)["result"]
    found: list[dict[str, Any]] = answer["results"]
    return found


def test_lists_are_sorted_again_and_both_rows_are_printed(catalogue: Path, files: list[Path]) -> None:
    asked = ("evaluate", "-c", catalogue, "--whitening", "none")
    plain, both = (run(*asked, *chosen).stdout.splitlines() for chosen in ((), ("--rerank", "k-reciprocal")))
    assert [row.split()[-1] for row in both[1:3]] == ["plain", "k-reciprocal"]
    assert both[1].removesuffix(", plain") == plain[1]
    query = ("query", "-c", catalogue, files[0], "--json")
    before, after = (results(run(*query, "--rerank", how)) for how in ("none", "local"))
    assert [row["id"] for row in before[:2]] == [row["id"] for row in after[:2]]
    assert {row["id"] for row in before} == {row["id"] for row in after}


def test_a_file_gives_commands_their_options_and_flags_override_it(
    catalogue: Path, files: list[Path], tmp_path: Path
) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text("[signature]\nn_values = 9\n[retrieval]\nwhitening = 'pca'\ndistance = 'd1'\n")
    asked = ("evaluate", "-c", catalogue, "--json")
    by_file = json.loads(run(*asked, "--config", mine).stdout)["result"]
    assert (by_file["n_values"], by_file["whitening"], by_file["distance"]) == (9, "pca", "d1")
    assert by_file == json.loads(run(*asked, *PCA, "--distance", "d1", "--n-values", 9).stdout)["result"]
    overridden = run(*asked, "--config", mine, "--whitening", "auto", "--distance", "log", "--n-values", 59)
    assert json.loads(overridden.stdout)["result"] == json.loads(run(*asked).stdout)["result"]
    query = ("query", "-c", catalogue, files[0], "--json")
    with_file, by_flags, plain = (
        json.loads(run(*query, *chosen).stdout)["result"]
        for chosen in (("--config", mine), (*PCA, "--distance", "d1", "--n-values", 9), ())
    )
    assert with_file == by_flags != plain
    run("report", "-c", catalogue, "-o", tmp_path / "page.html", "--queries", 1, "--config", mine)
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    for name, value in (
        ("distance", "d1"),
        ("whitening", "pca: the covariance"),
        ("scale", by_file["scale"]),
    ):
        assert re.search(rf"<dt>{name}</dt>\s*<dd>{value}", page), name


def test_a_catalogue_compares_as_the_options_that_it_was_made_with_say(
    files: list[Path], tmp_path: Path
) -> None:
    options = PipelineOptions().changed(retrieval={"whitening": "pca", "distance": "d1"})
    (tmp_path / "mine.toml").write_text(describe_options(options))
    run("ingest", files[0].parent, "-c", tmp_path / "c.sqlite", "--config", tmp_path / "mine.toml")
    run("ingest", files[0].parent, "-c", tmp_path / "plain.sqlite")

    def found(name: str, *chosen: object) -> object:
        done = run("query", files[0], "--json", "-c", tmp_path / name, *chosen)
        return json.loads(done.stdout)["result"][0]["results"]

    assert found("c.sqlite") == found("plain.sqlite", *PCA, "--distance", "d1")
    as_plain = found("c.sqlite", "--whitening", "none", "--distance", "log")
    assert found("plain.sqlite") == as_plain != found("c.sqlite")
    # Stored results do not depend on these options, so that a catalogue can be used with other values.
    run("ingest", files[0].parent, "-c", tmp_path / "plain.sqlite", "--config", tmp_path / "mine.toml")


def test_mixed_units_are_noticed_where_size_counts(tmp_path: Path) -> None:
    scans = []
    for name, unit in (("metres", 1.0), ("millimetres", 1000.0)):
        mesh = shapes.ellipsoid((1, 1, 1.2), subdivisions=3)
        scans.append(tmp_path / f"{name}.off")
        write_mesh(replace(mesh, vertices=mesh.vertices * unit), scans[-1])
    path = tmp_path / "c.sqlite"
    with Catalogue(path, PipelineOptions(), create=True) as store:
        ingest(scans, store)
    assert run("query", "-c", path, scans[0]).stderr == (
        "nearest: all shapes compared\n"
        "whitening: none, because 2 shapes are too few to learn from neighbours (24)\n"
        "score: none, because labels and shapes are too few\n"
    )
    for chosen in (("--size-weight", 1), ("--scale", "absolute")):
        said = run("query", "-c", path, scans[0], *chosen).stderr
        assert "1000000 times the area of the smallest: size tells them apart only if all files have" in said
