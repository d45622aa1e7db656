"""What the pipeline makes of the chain in its options: order, frames, surfaces, and stages that fail."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import shapes
from packages import install

from pcretrieve import PipelineOptions
from pcretrieve.errors import ShapeError
from pcretrieve.pipeline.inspecting import inspect_scan
from pcretrieve.pipeline.process import process

POINTS = shapes.points_on(shapes.body(), 5000)


def chain(*names: str, surface: dict[str, Any] | None = None, **tables: dict[str, Any]) -> PipelineOptions:
    """The options of a chain, with the options of its filters."""
    options = PipelineOptions().changed(surface=surface or {})
    return options.changed(pipeline={"stages": names, **tables})


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
