"""`pcretrieve list` and `show`: pages in order of id, and what a shape costs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import shapes
from click.testing import CliRunner

from pcretrieve import Catalogue
from pcretrieve.catalogue import Content, Record
from pcretrieve.catalogue.tables import PAYLOADS
from pcretrieve.cli.main import cli
from pcretrieve.descriptors import describe
from pcretrieve.options import PipelineOptions
from pcretrieve.pipeline.process import process

OPTIONS = PipelineOptions()
N_FAILED = 2500


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One shape, and more failures than are read at a time."""
    shape = process(shapes.icosphere(3), OPTIONS)
    with Catalogue(tmp_path_factory.mktemp("list") / "c.sqlite", create=True) as store:
        store.put(
            Record("ball", "/ball.off", "hash"), Content(shape, describe(shape, OPTIONS.signature).values)
        )
        for number in range(N_FAILED):
            store.put(Record(f"r{number:04}", f"/r{number:04}.ply", "", status="failed", message="no scan"))
    return Path(store.location)


def run(*arguments: object) -> str:
    result = CliRunner().invoke(cli, [str(word) for word in arguments])
    assert result.exit_code == 0, result.output
    return result.stdout


def listed(path: Path, *arguments: object) -> list[str]:
    """The ids that are listed, which are the same in text and in JSON."""
    ids = [line.split()[0] for line in run("list", "-c", path, *arguments).splitlines()[1:]]
    document = run("list", "-c", path, *arguments, "--json")
    assert [row["id"] for row in json.loads(document)["result"]] == ids
    assert document == json.dumps(json.loads(document), indent=2) + "\n"
    return ids


FAILED = [f"r{number:04}" for number in range(N_FAILED)]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], ["ball", *FAILED]),
        (["--failed"], FAILED),
        (["--limit", 1], ["ball"]),
        (["--limit", 3, "--offset", 1], FAILED[:3]),
        (["--failed", "--limit", 1200, "--offset", 900], FAILED[900:2100]),
        (["--offset", N_FAILED], FAILED[-1:]),
        (["--offset", N_FAILED + 1], []),
        (["--limit", 1000], ["ball", *FAILED[:999]]),
    ],
    ids=str,
)
def test_pages_are_in_order_of_id(arguments: list[object], expected: list[str], path: Path) -> None:
    assert listed(path, *arguments) == expected


def test_show_says_what_a_shape_costs(path: Path) -> None:
    stored = json.loads(run("show", "ball", "-c", path, "--json"))["result"]["stored_bytes"]
    said = run("show", "ball", "-c", path)
    assert f"\nstored          {sum(stored.values()) / 1000:.1f} kB: record " in said
    assert set(stored) == {"record", "signatures", *PAYLOADS}
    assert stored["signatures"] == 8 * (118 + 1)
    failed = json.loads(run("show", "r0000", "-c", path, "--json"))["result"]["stored_bytes"]
    assert sum(failed.values()) == failed["record"] < 1000
