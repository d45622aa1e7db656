"""Which shape of a catalogue is the next body of a scan, and how far it is."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import shapes

from pcretrieve import Catalogue, PipelineOptions, TriangleMesh, ingest, signature
from pcretrieve.formats import write_mesh
from pcretrieve.pipeline.inspecting import inspect_scan

OPTIONS = PipelineOptions().changed(
    signature={"method": "shape-dna", "n_values": 10}, spectral={"n_pairs": 20}
)


def ellipsoid(length: float) -> TriangleMesh:
    ball = shapes.icosphere(3)
    return TriangleMesh(ball.vertices * [length, 1.0, 0.7], ball.faces)


LENGTHS = {"a1": 2.0, "a2": 2.1, "b1": 2.4, "b2": 3.0}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("next")
    for name, length in LENGTHS.items():
        write_mesh(ellipsoid(length), place / f"{name}.off")
    write_mesh(ellipsoid(2.02), place / "new.ply")
    return place


def catalogue(
    folder: Path, name: str, labels: dict[str, str], options: PipelineOptions = OPTIONS
) -> Catalogue:
    store = Catalogue(folder / name, options, create=True)
    ingest(sorted(folder.glob("*.off")), store, labels=labels, workers=1)
    return store


@pytest.fixture(scope="module")
def labelled(folder: Path) -> Iterator[Catalogue]:
    with catalogue(folder, "labelled.sqlite", {f"{name}.off": name[0] for name in LENGTHS}) as store:
        yield store


def gap(one: float, other: float) -> float:
    a, b = (np.log(signature(ellipsoid(length), OPTIONS).values) for length in (one, other))
    return float(np.linalg.norm(a - b))


def test_the_next_body_is_the_nearest_shape_of_another_class(folder: Path, labelled: Catalogue) -> None:
    seen = inspect_scan(folder / "new.ply", n_rescans=0, catalogue=labelled)
    assert (seen.next_body.id, seen.next_body.label) == ("b1", "b")
    assert seen.next_body.distance == pytest.approx(gap(2.02, 2.4), rel=1e-4)
    assert seen.signature is not None and seen.signature.kind == "shape-dna", (
        "by the options of the catalogue"
    )
    assert "b1 (class b)" in seen.next_body.source
    assert f"the nearest shape is a1 (class a), {gap(2.02, 2.0):.2g} away" in seen.next_body.source
