"""Units: bodies of one size have one size in the signature, whatever unit their files have."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes
from click.testing import CliRunner

import pcretrieve as pr
from pcretrieve import TriangleMesh
from pcretrieve.catalogue import Catalogue
from pcretrieve.cli.main import cli
from pcretrieve.errors import InputError, OptionError
from pcretrieve.formats import as_scan, write_mesh
from pcretrieve.options import PipelineOptions

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


def test_what_is_converted_is_converted_once() -> None:
    once = as_scan(scaled(1000), "mm")
    assert isinstance(once, TriangleMesh)
    np.testing.assert_allclose(once.vertices, BODY.vertices)
    assert once.provenance[-1].notes == ("converted the coordinates from mm to m",)
    assert as_scan(once, "mm") is once
    assert as_scan(once, "none") is once


def test_the_unit_is_part_of_the_digest_only_if_it_is_given() -> None:
    options = PipelineOptions()
    assert options.changed(scan={"unit": "mm"}).digest != options.digest
    assert options.changed(scan={"unit": "none"}).digest == options.digest
    # The unit of a signature is in the signature itself.
    assert options.changed(scan={"unit": "mm"}).signature_digest == options.signature_digest
    with pytest.raises(OptionError, match="unit"):
        options.changed(scan={"unit": "parsec"})


@pytest.mark.parametrize(
    ("options", "unit"),
    [
        ({}, {"m": None, "mm": None}),
        (SIZED, {"m": "m", "mm": "unknown"}),
        ({"signature": {"scale": "absolute"}}, {"m": "m", "mm": "unknown"}),
        ({**SIZED, "scan": {"unit": "mm"}}, {"m": "m", "mm": "m"}),
    ],
)
def test_a_signature_with_a_size_has_its_unit(
    options: dict[str, Any], unit: dict[str, str | None], files: dict[str, Path]
) -> None:
    assert {name: pr.signature(path, options).unit for name, path in files.items()} == unit


def test_there_is_no_other_unit() -> None:
    with pytest.raises(InputError, match="unit of sizes must be None, 'm' or 'unknown', got 'mm'"):
        pr.Signature(np.ones(2), "r-bihdm", unit="mm")  # type: ignore[arg-type]


def test_ingest_with_a_unit(files: dict[str, Path], tmp_path: Path) -> None:
    catalogue = tmp_path / "bodies.sqlite"
    arguments = ["ingest", *map(str, files.values()), "-c", str(catalogue), "--unit", "mm", "--workers", "1"]
    result = CliRunner().invoke(cli, arguments)
    assert result.exit_code == 0, result.output
    with Catalogue(catalogue) as store:
        records = [store.record(shape_id) for shape_id in ("metres", "millimetres")]
    assert [record.metres_per_unit for record in records] == [1, 1]
    assert records[0].area == pytest.approx(records[1].area, rel=1e-4)
