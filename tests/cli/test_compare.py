"""`pcretrieve compare`, and what `evaluate` prints and writes for it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import shapes
from click.testing import CliRunner, Result

import pcretrieve as pr
from pcretrieve.cli.main import cli
from pcretrieve.evaluation import MEASURES, query_scores, rank_catalogue, read_scores


def run(*arguments: object, code: int = 0) -> Result:
    result = CliRunner().invoke(cli, [str(word) for word in arguments])
    assert result.exit_code == code, result.output
    return result


def document(*arguments: object) -> dict[str, object]:
    found: dict[str, object] = json.loads(run(*arguments, "--json").stdout)["result"]
    return found


@pytest.fixture(scope="module")
def eggs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A catalogue of eggs of four kinds, four of each."""
    place = tmp_path_factory.mktemp("eggs")
    labels = {}
    for kind in range(4):
        for number in range(4):
            axes = (1 + 0.1 * number, 1, 1.2 + 0.08 * kind)
            pr.write_mesh(shapes.ellipsoid(axes, subdivisions=3), place / f"{kind}{number}.off")
            labels[f"{kind}{number}.off"] = f"kind{kind}"
    (place / "labels.csv").write_text(
        "\n".join(["file,class", *(f"{name},{label}" for name, label in labels.items())])
    )
    pr.ingest(place, place / "eggs.sqlite", labels=labels, workers=1)
    return place


def test_re_ranking_is_a_row_more_and_works_by_a_matrix(eggs: Path, tmp_path: Path) -> None:
    chosen = ("-c", eggs / "eggs.sqlite", "--whitening", "none")
    run("matrix", *chosen, "-o", tmp_path / "eggs.npy")
    own = run("evaluate", *chosen, "--rerank", "local").stdout.splitlines()
    assert own[1].endswith("  micro-average, plain")
    assert own[2].endswith("  micro-average, local")
    labels = eggs / "labels.csv"
    by_matrix = ("evaluate", "--matrix", tmp_path / "eggs.npy", "--rerank", "local")
    assert run(*by_matrix, "--labels", labels).stdout.splitlines() == own
    assert run(*by_matrix, "-c", eggs / "eggs.sqlite").stdout.splitlines() == own
    refused = run("matrix", *chosen, "--rerank", "local", "-o", tmp_path / "x.npy", code=2).stderr
    assert "distances are not re-ranked: leave out --rerank" in refused
    np.save(tmp_path / "far.npy", np.where(np.eye(16) > 0, 0, np.inf))
    (tmp_path / "far.ids").write_text((tmp_path / "eggs.ids").read_text())
    far = ("evaluate", "--matrix", tmp_path / "far.npy", "--labels", labels)
    assert run(*far, "--rerank", "none").stdout
    error = run(*far, "--rerank", "local", code=1).exception
    assert "re-ranking needs finite distances, got 240 that are infinite" in str(error)


def test_two_settings_matrices_and_files_give_one_comparison(eggs: Path, tmp_path: Path) -> None:
    catalogue = eggs / "eggs.sqlite"
    settings = {"one": ("--distance", "log"), "two": ("--distance", "d1", "--n-values", "5")}
    for name, flags in settings.items():
        run("matrix", "-c", catalogue, "--whitening", "none", *flags, "-o", tmp_path / f"{name}.txt")
        run("evaluate", "-c", catalogue, "--whitening", "none", *flags, "--csv", tmp_path / name)
    with pr.Catalogue(catalogue) as store:
        chosen = store.options.changed(retrieval={"whitening": "none", "distance": "log"})
        assert read_scores(tmp_path / "one" / "queries.csv") == query_scores(
            rank_catalogue(store, chosen).rankings
        )
    plain = {"retrieval": {"whitening": "none"}}
    short = {"retrieval": {"whitening": "none", "distance": "d1"}, "signature": {"n_values": 5}}
    expected = pr.compare(catalogue, catalogue, options=plain, second_options=short)
    assert (expected.difference != 0).any()
    matrices = (tmp_path / "one.txt", tmp_path / "two.txt")
    assert pr.compare(*matrices, labels=eggs / "labels.csv") == expected
    files = (tmp_path / "one" / "queries.csv", tmp_path / "two" / "queries.csv")
    assert pr.compare(*files) == expected
    flags = ("--whitening", "none", "--distance", "log", "--distance", "d1")
    lengths = ("--n-values", 59, "--n-values", 5)
    found = document("compare", catalogue, catalogue, *flags, *lengths, "--changes", 3)
    assert found["difference"] == dict(zip(MEASURES, expected.difference.tolist(), strict=True))
    assert found["low"] == dict(zip(MEASURES, expected.interval[0].tolist(), strict=True))
    assert found["n_queries"] == 16
    changes = found["changes"]
    assert isinstance(changes, list)
    assert [one["id"] for one in changes] == [one.shape_id for one in expected.changes[:3]]
    printed = run("compare", *files).stdout.splitlines()
    assert printed[3].split()[:6] == [f"{value:+.3f}" for value in expected.difference]
    assert printed[1].endswith(f"  A: {files[0]}")
    change = expected.changes[0]
    assert printed[6:8] == ["average precision of the most changed shapes:", "ID  CLASS       A       B"]
    assert printed[8].split() == [
        *(change.shape_id, change.label),
        *(f"{change.first:.4f}", f"{change.second:.4f}"),
    ]


def test_what_cannot_be_compared(eggs: Path, tmp_path: Path) -> None:
    catalogue = eggs / "eggs.sqlite"
    run("matrix", "-c", catalogue, "-o", tmp_path / "run.txt")
    refused = run("compare", catalogue, tmp_path / "run.txt", code=1)
    assert "a distance matrix has no classes: give labels" in str(refused.exception)
    three = ("--distance", "d1") * 3
    assert (
        "--distance is given at most twice, got 3"
        in run("compare", catalogue, catalogue, *three, code=2).stderr
    )
    gone = run("compare", catalogue, tmp_path / "gone.sqlite", code=1)
    assert "there is no catalogue" in str(gone.exception)
