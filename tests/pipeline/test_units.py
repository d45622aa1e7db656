"""Units: bodies of one size have one size in the signature, whatever unit their files have."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapes
from click.testing import CliRunner

import pcretrieve as pr
from pcretrieve import TriangleMesh
from pcretrieve.catalogue import Catalogue
from pcretrieve.cli.main import cli
from pcretrieve.formats import write_mesh

BODY = shapes.body(2)
SIZED = {"signature": {"size_weight": 6}}


def scaled(factor: float) -> TriangleMesh:
    return TriangleMesh(factor * BODY.vertices, BODY.faces)


@pytest.fixture
def files(tmp_path: Path) -> dict[str, Path]:
    """The same body in metres, and in millimetres in a file without a unit."""
    paths = {"m": tmp_path / "metres.glb", "mm": tmp_path / "millimetres.off"}
    write_mesh(BODY, paths["m"])
    write_mesh(scaled(1000), paths["mm"])
    return paths


def test_the_size_is_that_in_metres(files: dict[str, Path]) -> None:
    in_metres = pr.signature(files["m"], SIZED).values
    options = {**SIZED, "scan": {"unit": "mm"}}
    np.testing.assert_allclose(pr.signature(files["mm"], options).values, in_metres, rtol=1e-4)
    # A file that has a unit is not converted again.
    np.testing.assert_allclose(pr.signature(files["m"], options).values, in_metres, rtol=1e-4)
    assert pr.signature(files["mm"], SIZED).values[-1] > 1e6 * in_metres[-1]


def test_ingest_with_a_unit(files: dict[str, Path], tmp_path: Path) -> None:
    catalogue = tmp_path / "bodies.sqlite"
    arguments = ["ingest", *map(str, files.values()), "-c", str(catalogue), "--unit", "mm", "--workers", "1"]
    result = CliRunner().invoke(cli, arguments)
    assert result.exit_code == 0, result.output
    with Catalogue(catalogue) as store:
        records = [store.record(shape_id) for shape_id in ("metres", "millimetres")]
    assert [record.metres_per_unit for record in records] == [1, 1]
    assert records[0].area == pytest.approx(records[1].area, rel=1e-4)
