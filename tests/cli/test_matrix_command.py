"""`pcretrieve matrix`, and the commands that take a matrix: the same answers as by signatures."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import shapes
from click.testing import CliRunner, Result

import pcretrieve as pr
from pcretrieve import Catalogue, ingest
from pcretrieve.cli.main import cli
from pcretrieve.formats import write_mesh
from pcretrieve.matching import MATCHERS, PairwiseIndex, distance_matrix, read_matrix

N_CLASSES = 3


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eggs of three kinds, three of each, in a catalogue, with a file that is no scan."""
    place = tmp_path_factory.mktemp("eggs")
    labels = ["file,class", "broken.off,kind0"]
    (place / "broken.off").write_text("OFF\n")
    for kind in range(N_CLASSES):
        for number in range(3):
            axes = (1 + 0.1 * number, 1, 1.2 + 0.15 * kind)
            write_mesh(shapes.ellipsoid(axes, subdivisions=3), place / f"{kind}{number}.off")
            labels.append(f"{kind}{number}.off,kind{kind}")
    (place / "labels.csv").write_text("\n".join(labels))
    with Catalogue(place / "c.sqlite", create=True) as store:
        ingest(
            sorted(place.glob("*.off")),
            store,
            labels={line.split(",")[0]: line.split(",")[1] for line in labels[1:]},
        )
    return place


def run(*arguments: object, code: int = 0) -> Result:
    result = CliRunner().invoke(cli, [str(word) for word in arguments])
    assert result.exit_code == code, result.output
    return result


def document(*arguments: object) -> dict[str, object]:
    found: dict[str, object] = json.loads(run(*arguments, "--json").stdout)["result"]
    return found


# --- matchers ------------------------------------------------------------------------------------------


def test_a_matcher_makes_a_matrix_that_ranks(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "heat.npy"
    run("matrix", "-c", folder / "c.sqlite", "-o", path, "--matcher", "heat-hausdorff")
    made = pr.matrix(folder / "c.sqlite", matcher="heat-hausdorff")
    with Catalogue(folder / "c.sqlite") as store:
        index = PairwiseIndex(MATCHERS["heat-hausdorff"], made.ids, store.shape)
    assert read_matrix(path) == replace(made, labels=()) == distance_matrix(index)
    assert made.labels == tuple(f"kind{shape_id[0]}" for shape_id in made.ids)
    found = document("evaluate", "-c", folder / "c.sqlite", "--matrix", path)
    assert (found["n_queries"], found["n_failed"]) == (10, 1)
    query = ("query", "-c", folder / "c.sqlite", folder / "10.off", "--matrix", path, "--json")
    assert json.loads(run(*query).stdout)["result"][0]["results"][0]["id"] == "10"


def test_a_matcher_leaves_nothing_else_to_be_chosen(folder: Path, tmp_path: Path) -> None:
    asked = ("matrix", "-c", folder / "c.sqlite", "-o", tmp_path / "run.txt", "--matcher")
    refused = run(*asked, "heat-hausdorff", "--n-values", 9, code=2)
    assert "a matcher has no signatures: leave out --n-values" in refused.stderr
    assert "'sift' is not one of 'heat-hausdorff'" in run(*asked, "sift", code=2).stderr
    assert not list(tmp_path.iterdir())
