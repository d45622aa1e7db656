"""`pcretrieve query`, `evaluate`, `report`: which scale signatures are compared by, and that it is said."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import shapes
from click.testing import CliRunner, Result

from pcretrieve import Catalogue, PipelineOptions, ingest
from pcretrieve.cli.main import cli
from pcretrieve.formats import write_mesh

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
