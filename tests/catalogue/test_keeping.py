"""A catalogue stores the parts of a shape that its options name; others are computed again, or missing."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapes
from click.testing import CliRunner, Result

from pcretrieve import Catalogue, PipelineOptions
from pcretrieve.catalogue import Content, Record
from pcretrieve.cli.main import cli
from pcretrieve.descriptors import describe
from pcretrieve.errors import CatalogueError, ShapeError
from pcretrieve.formats import write_mesh
from pcretrieve.pages import report
from pcretrieve.pipeline.process import process
from pcretrieve.values import Need, Shape

NEEDS: tuple[Need, ...] = ("spectrum", "overlaps", "mesh")
OVERLAP_METHODS = ("wks", "bihdm")


def kept(*parts: str) -> PipelineOptions:
    return PipelineOptions().changed(catalogue={"keep": parts})


@cache
def eggs(element: str = "linear") -> tuple[Shape, ...]:
    """What processing makes of three eggs, the last of which has two surfaces."""
    options = PipelineOptions().changed(spectral={"element": element})
    first, second = (process(shapes.ellipsoid((1, 1, c), subdivisions=3), options) for c in (1.2, 1.5))
    both = Shape((*first.surfaces, *second.surfaces), provenance=first.provenance)
    return first, second, both


def filled(path: Path, options: PipelineOptions) -> Catalogue:
    store = Catalogue(path, options, create=True)
    for number, shape in enumerate(eggs(options.spectral.element)):
        record = Record(f"egg{number}", f"/egg{number}", f"hash{number}", "egg", steps=shape.provenance)
        store.put(record, Content(shape, describe(shape, options.signature).values))
    return store


def stored_parts(store: Catalogue) -> set[str]:
    sizes = [store.stored_bytes(record.id) for record in store.records()]
    return {name for size in sizes for name, n_bytes in size.items() if n_bytes}


ALWAYS = {"record", "signatures", "spectra", "moments"}


@pytest.mark.parametrize(
    "keep", [(), ("meshes",), ("overlaps",), ("overlaps", "meshes", "overlaps")], ids=str
)
def test_what_options_name_is_stored_and_comes_back(keep: tuple[str, ...], tmp_path: Path) -> None:
    with filled(tmp_path / "c.sqlite", kept(*keep)) as store:
        assert stored_parts(store) == ALWAYS.union(keep)
        for number, shape in enumerate(eggs()):
            again = store.shape(f"egg{number}", NEEDS)
            assert len(again.surfaces) == len(shape.surfaces)
            for one, other in zip(again.surfaces, shape.surfaces, strict=True):
                assert one.mesh == (other.mesh if "meshes" in keep else None)
                assert (one.spectrum == other.spectrum) is bool(keep)


@pytest.mark.parametrize("method", OVERLAP_METHODS)
def test_overlaps_are_computed_from_meshes_to_the_same_bits(method: str, tmp_path: Path) -> None:
    options = PipelineOptions().changed(signature={"method": method})
    with filled(tmp_path / "c.sqlite", PipelineOptions()) as store:
        values = store.signatures(options).values
        assert store.shape("egg0", ("spectrum", "overlaps")).surfaces[0].mesh is None
        assert store.shape("egg0").spectrum.overlaps is None
    for row, shape in zip(values, eggs(), strict=True):
        np.testing.assert_array_equal(row, describe(shape, options.signature).values)


def test_a_spectrum_of_points_keeps_its_overlaps(tmp_path: Path) -> None:
    """The star of triangles about each point is no surface that the spectrum could be computed from again."""
    options = PipelineOptions().changed(spectral={"element": "points"})
    with filled(tmp_path / "c.sqlite", options) as store:
        assert "overlaps" in stored_parts(store)
        egg = eggs("points")[0]
        assert store.shape("egg0", NEEDS) == Shape(egg.surfaces, verdict=egg.verdict)


@pytest.mark.parametrize(("method", "part"), [("wks", "overlaps"), ("hks-bow", "mesh")])
def test_what_is_neither_stored_nor_computed_is_gone(method: str, part: str, tmp_path: Path) -> None:
    with filled(tmp_path / "c.sqlite", kept()) as store:
        options = store.options.changed(signature={"method": method})
        with pytest.raises(ShapeError, match=rf"\[egg0 / signature\] gone: .* {part}"):
            store.signatures(options)
        assert len(store.signatures(store.options.changed(signature={"method": "shape-dna"}))) == 3
        with pytest.raises(ShapeError, match=r"\[egg1 / signature\] gone: the shape must hold its mesh"):
            store.mesh("egg1")


def test_pages_of_shapes_without_meshes_have_no_pictures(tmp_path: Path) -> None:
    for name, options in (("with", kept("meshes")), ("without", kept())):
        with filled(tmp_path / f"{name}.sqlite", options) as store:
            report(store, tmp_path / f"{name}.html")
    pages = [(tmp_path / f"{name}.html").read_text() for name in ("with", "without")]
    assert ["url(data:image/png" in page for page in pages] == [True, False]
    assert all("egg2" in page for page in pages)


def test_one_catalogue_keeps_the_same_of_all_shapes(tmp_path: Path) -> None:
    filled(tmp_path / "c.sqlite", kept("overlaps", "meshes")).close()
    Catalogue(tmp_path / "c.sqlite", kept("meshes", "overlaps")).close()
    with pytest.raises(
        CatalogueError, match=r"catalogue.keep: \('meshes', 'overlaps'\) there, \('meshes',\) here"
    ):
        Catalogue(tmp_path / "c.sqlite", PipelineOptions())


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli, [str(word) for word in arguments])


def test_meshes_are_left_out_at_the_command_line(tmp_path: Path) -> None:
    for number, c in enumerate((1.2, 1.5)):
        write_mesh(shapes.ellipsoid((1, 1, c), subdivisions=3), tmp_path / f"egg{number}.off")
    path = tmp_path / "c.sqlite"
    ingested = run("ingest", *tmp_path.glob("*.off"), "-c", path, "--no-meshes", "--workers", 1)
    assert ingested.exit_code == 0, ingested.output
    stored = json.loads(run("show", "egg0", "-c", path, "--json").output)["result"]["stored_bytes"]
    assert (stored["meshes"], stored["overlaps"]) == (0, 0)
    assert sum(stored.values()) < 30_000
    assert "egg0" in run("query", "egg0", "-c", path).stdout.splitlines()[1]
    exported = run("export", "egg0", "-c", path, "-o", tmp_path / "egg0.ply")
    assert isinstance(exported.exception, ShapeError)
    assert str(exported.exception).startswith("[egg0 / signature] gone: the shape must hold its mesh")
    assert not (tmp_path / "egg0.ply").exists()
