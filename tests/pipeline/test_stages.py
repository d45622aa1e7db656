"""What the pipeline makes of the chain in its options: order, frames, surfaces, and stages that fail."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes
from packages import install, install_addition

from pcretrieve import PipelineOptions, PointCloud, TriangleMesh, ingest, reconstruct, signature
from pcretrieve.catalogue import Catalogue
from pcretrieve.errors import CatalogueError, OptionError, ShapeError
from pcretrieve.formats import write_mesh
from pcretrieve.pipeline.inspecting import inspect_scan
from pcretrieve.pipeline.process import process
from pcretrieve.pipeline.stages import stages

OF_POINTS = {"spectral": {"element": "points"}}

BODY = shapes.body(3)
POINTS = shapes.points_on(shapes.body(), 5000)
COARSE = {"cell": 0.02, "target_faces": 1000}


@pytest.fixture
def addition(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install_addition(tmp_path / "site", monkeypatch)


def chain(*names: str, surface: dict[str, Any] | None = None, **tables: dict[str, Any]) -> PipelineOptions:
    """The options of a chain, with the options of its filters."""
    options = PipelineOptions().changed(surface=surface or {})
    return options.changed(pipeline={"stages": names, **tables})


def steps(value: TriangleMesh | PointCloud) -> list[str]:
    return [step.stage for step in value.provenance]


# --- stages in another order --------------------------------------------------------------------------


def test_without_remesh_nothing_else_changes() -> None:
    """The stage `remesh` does nothing unless `remesh.method` is set."""
    default = process(POINTS, PipelineOptions().changed(surface=COARSE))
    shorter = process(POINTS, chain("clean", "orient", "surface", "spectrum", surface=COARSE))
    assert shorter.surfaces == default.surfaces
    assert len(default.surfaces) == 2


def test_without_clean_all_points_are_used() -> None:
    options = chain("orient", "surface", "spectrum", surface=COARSE)
    shape = process(POINTS, options)
    assert shape.cloud is not None and shape.cloud.normals is not None
    np.testing.assert_allclose(shape.cloud.points, POINTS, atol=1e-12)
    with pytest.raises(ShapeError, match=r"^\[read\] a scan needs at least 100 points, got 50"):
        process(POINTS[:50], options)


@pytest.mark.usefixtures("addition")
def test_filters_see_the_coordinates_of_the_scan_before_and_after_its_normals() -> None:
    far = np.array([2000.0, -3000.0, 1000.0])
    for names in (("cut", "clean", "orient"), ("clean", "orient", "cut")):
        options = chain(*names, "hull", "spectrum", cut={"height": 1000.5})
        surface = reconstruct(POINTS + far, options)
        assert steps(surface) == [*names, "surface"]
        assert 1000.4 < surface.vertices[:, 2].max() < 1000.5
        np.testing.assert_allclose(surface.vertices.mean(axis=0), far, atol=1)


@pytest.mark.usefixtures("addition")
def test_every_surface_of_a_scan_is_filtered() -> None:
    plain = process(POINTS, chain("clean", "orient", "surface", "spectrum", surface=COARSE))
    high = process(POINTS, chain("clean", "orient", "surface", "stretch", "spectrum", surface=COARSE))
    assert len(high.surfaces) == len(plain.surfaces) == 2
    for before, after in zip(plain.surfaces, high.surfaces, strict=True):
        assert before.mesh is not None and after.mesh is not None
        np.testing.assert_allclose(after.mesh.vertices, before.mesh.vertices * [1, 1, 2], atol=1e-9)
        assert steps(after.mesh) == ["clean", "orient", "surface", "stretch"]
    stretched = [step.stage for step in high.provenance]
    assert stretched == ["clean", "orient", "surface", "stretch", "surface", "stretch", "spectrum", "checks"]


@pytest.mark.usefixtures("addition")
def test_a_mesh_that_is_kept_enters_after_its_surface() -> None:
    names = ("cut", "clean", "orient", "surface", "stretch", "remesh", "spectrum")
    kept = reconstruct(BODY, chain(*names).changed(remesh={"method": "tetwild"}))
    assert steps(kept) == ["topology", "cut", "stretch"]
    assert kept.volume == pytest.approx(2 * BODY.volume)
    (note,) = kept.provenance[1].notes
    assert note == "not applied to a mesh that is used without reconstruction (surface.mode)"
    made = reconstruct(BODY, chain(*names, surface={"mode": "reconstruct", "method": "hull"}))
    assert steps(made) == ["sample", "cut", "clean", "orient", "surface", "stretch"]


@pytest.mark.usefixtures("addition")
def test_points_alone_are_filtered() -> None:
    options = chain("cut", "clean", "orient", "surface", "spectrum", cut={"height": 0.5})
    shape = process(POINTS, options.changed(spectral={"element": "points"}))
    assert [step.stage for step in shape.provenance] == ["cut", "clean", "orient", "spectrum", "checks"]
    assert shape.mesh.vertices[:, 2].max() < 0.5
    with pytest.raises(OptionError, match="'spectrum' takes a surface"):
        reconstruct(POINTS, {"pipeline": {"stages": ("clean", "orient", "spectrum")}} | OF_POINTS)


@pytest.mark.usefixtures("addition")
def test_the_chain_of_an_added_element_is_checked_when_a_scan_is_processed() -> None:
    """Its record says whether it needs a surface."""
    options = PipelineOptions().changed(
        pipeline={"stages": ("clean", "orient", "spectrum")}, spectral={"element": "soft"}
    )
    with pytest.raises(OptionError, match=r"^in \[pipeline\], stages: 'spectrum' takes a surface, but"):
        process(POINTS, options)


# --- the same chain everywhere ------------------------------------------------------------------------


def test_an_inspection_follows_the_chain() -> None:
    inspection = inspect_scan(POINTS, chain("orient", "surface", "spectrum", surface=COARSE), n_rescans=0)
    assert inspection.failure is None
    assert inspection.signature is not None
    assert "Outliers" not in [check.name for check in inspection.checks]
    assert [step.stage for step in inspection.steps] == ["orient", "surface"]


def test_an_inspection_of_points_alone() -> None:
    inspection = inspect_scan(POINTS, OF_POINTS, n_rescans=0)
    assert inspection.failure is None and inspection.mesh is None
    assert inspection.signature is not None
    np.testing.assert_array_equal(inspection.signature.values, signature(POINTS, OF_POINTS).values)


@pytest.mark.usefixtures("addition")
def test_a_catalogue_keeps_its_chain(tmp_path: Path) -> None:
    write_mesh(BODY, tmp_path / "body.off")
    options = PipelineOptions().changed(
        pipeline={"stages": ("clean", "orient", "surface", "stretch", "spectrum")}
    )
    ingest([tmp_path / "body.off"], tmp_path / "bodies.sqlite", options=options, workers=1)
    with Catalogue(tmp_path / "bodies.sqlite") as catalogue:
        assert catalogue.options == options
        assert "stretch" in [step.stage for step in catalogue.record("body").steps]
    with pytest.raises(CatalogueError, match=r"built with other options: pipeline\.stages: \('clean'"):
        ingest([tmp_path / "body.off"], tmp_path / "bodies.sqlite", options=PipelineOptions(), workers=1)


# --- filters that fail --------------------------------------------------------------------------------

MODULE = """
from dataclasses import replace

from pcretrieve.errors import ReconstructionError
from pcretrieve.points import PointFilter
from pcretrieve.surface import SurfaceFilter
from pcretrieve.values import PointCloud, Step, TriangleMesh

def refuse(cloud, options):
    raise ReconstructionError("the points must be blue")

BROKEN = PointFilter("broken", lambda cloud, options: cloud.points[cloud.nothing])
ENDING = PointFilter("ending", lambda cloud, options: exit(3))
REFUSING = PointFilter("refusing", refuse)
ARRAY = PointFilter("array", lambda cloud, options: cloud.points)
FEW = PointFilter("few", lambda cloud, options: cloud.select(slice(7)))
BARE = PointFilter("bare", lambda cloud, options: replace(cloud, normals=None))
BLIND = PointFilter("blind", lambda cloud, options: cloud, gives="normals")
EMPTY = SurfaceFilter("empty", lambda mesh, options: None)
OPEN = SurfaceFilter("open", lambda mesh, options: replace(mesh, faces=mesh.faces[3:]))

CENTRED = PointFilter("centred", lambda cloud, options: _own_step(cloud), near_origin=True)
FRESH = SurfaceFilter("fresh", lambda mesh, options: TriangleMesh(mesh.vertices, mesh.faces), of_kept=False)

def _own_step(cloud):
    return cloud.after(Step("centred", 0.0, {"distance": float(abs(cloud.points.mean(axis=0)).max())}))
"""
POINT_FILTERS = ("broken", "ending", "refusing", "array", "few", "bare", "blind", "centred")
SURFACE_FILTERS = ("empty", "open", "fresh")
ENTRY_POINTS = "".join(
    f"[pcretrieve.{group}]\n" + "".join(f"{name} = theirs:{name.upper()}\n" for name in names)
    for group, names in (("point_filters", POINT_FILTERS), ("surface_filters", SURFACE_FILTERS))
)


@pytest.fixture
def theirs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path / "site", "theirs", {"theirs": MODULE}, ENTRY_POINTS, monkeypatch)


PACKAGE = "of the package theirs"


@pytest.mark.usefixtures("theirs")
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("broken", f"the point filter 'broken' {PACKAGE} failed, AttributeError: 'PointCloud' object has no"),
        ("ending", f"the point filter 'ending' {PACKAGE} failed, SystemExit: 3"),
        ("refusing", "the points must be blue"),
        (
            "array",
            f"the point filter 'array' {PACKAGE} failed, TypeError: a filter must give a PointCloud, got",
        ),
        ("few", "a scan needs at least 100 points, got 7"),
        ("bare", f"the point filter 'bare' {PACKAGE} must keep normals, it gave none"),
        (
            "empty",
            f"the surface filter 'empty' {PACKAGE} failed, TypeError: a filter must give a TriangleMesh",
        ),
        ("open", "the surface must be a closed manifold, it has defects: "),
    ],
)
def test_a_filter_that_fails_is_named(name: str, message: str) -> None:
    names = ["clean", "orient", "poisson", "spectrum"]
    names.insert(2 if name in POINT_FILTERS else 3, name)
    with pytest.raises(ShapeError) as raised:
        process(POINTS, chain(*names))
    assert str(raised.value).startswith(f"[{name}] {message}")
    inspection = inspect_scan(POINTS, chain(*names), n_rescans=0)
    assert inspection.failure is not None and inspection.failure.stage == name


@pytest.mark.usefixtures("theirs")
def test_a_filter_that_should_give_normals() -> None:
    with pytest.raises(ShapeError, match=rf"^\[blind\] the point filter 'blind' {PACKAGE} must keep normals"):
        process(POINTS, chain("clean", "blind", "poisson", "spectrum"))


@pytest.mark.usefixtures("theirs")
def test_steps_and_frames_of_filters() -> None:
    options = chain("clean", "centred", "orient", "poisson", "fresh", "spectrum")
    surface = reconstruct(POINTS + 1e6, options)
    assert steps(surface) == ["clean", "centred", "orient", "surface", "fresh"]
    assert surface.provenance[1].sizes["distance"] < 1e-6
    assert surface.provenance[-1].sizes == {"faces_in": len(surface.faces), "faces": len(surface.faces)}
    assert steps(reconstruct(BODY, options)) == ["topology", "centred"]


@pytest.mark.usefixtures("theirs")
def test_a_mesh_that_is_open_may_stay_open() -> None:
    """As it may be with the mode `keep`."""
    mesh = TriangleMesh(BODY.vertices, BODY.faces[5:])
    kept = reconstruct(
        mesh, chain("clean", "orient", "surface", "open", "spectrum", surface={"mode": "keep"})
    )
    assert steps(kept) == ["topology", "open"]
    assert len(kept.faces) == len(mesh.faces) - 3


def test_every_stage_is_seen() -> None:
    options = chain("clean", "orient", "poisson", "spectrum")
    seen = list(stages(POINTS, options))
    assert [[step.stage for step in one.steps] for one in seen] == [
        [],
        ["clean"],
        ["clean", "orient"],
        ["clean", "orient", "surface"],
    ]
