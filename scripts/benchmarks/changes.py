"""What resolution, noise, missing faces, motions and scanning do to rankings, by several descriptors.

The gallery are the clean meshes of a set, used as they are. Each mesh is changed in one way, and is then a
query; all meshes of its class are relevant, its own among them. The whitening is `unsupervised`, fitted to
the gallery. The last row of a set has raw scans as queries and as gallery, each left out of its own results.
"copies" is the share of the queries that `duplicates` finds to be copies of the mesh that was changed, and
"others" the number of other pairs that it finds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.measuring import Column, Table, all_in_workers
from benchmarks.paper.shapes import noisy, without_faces
from benchmarks.recognition import fused_points
from benchmarks.sets import SETS, Item, left_out, to_faces
from benchmarks.simulation import RigOptions, scan
from benchmarks.simulation.samples import moved, random_motion
from pcretrieve.descriptors import describe
from pcretrieve.errors import ShapeError
from pcretrieve.gallery.groups import SAME
from pcretrieve.options import PipelineOptions, SignatureOptions
from pcretrieve.pipeline.process import process
from pcretrieve.retrieval import coordinates, fit_whitening, pairwise, people
from pcretrieve.values import FloatArray, PointCloud, TriangleMesh

#: A change of a mesh, which takes `rng`.
Change = Callable[..., TriangleMesh | PointCloud]


def _moved(mesh: TriangleMesh, rng: np.random.Generator) -> TriangleMesh:
    """The mesh in another unit, turned and moved."""
    return TriangleMesh(1000 * moved(random_motion(rng), mesh.vertices), mesh.faces)


def _scanned(mesh: TriangleMesh, rng: np.random.Generator) -> PointCloud:
    return PointCloud(scan(mesh, RigOptions(), rng).points)


SCANS = "raw scans"
CHANGES: dict[str, Change] = {
    "as it is": lambda mesh, rng: mesh,
    **{
        f"{n:,} faces": partial(to_faces, n)
        for n in (40_000, 10_000, 5000, 2000, 1000, 500)
    },
    **{f"noise {size} edges": partial(noisy, size=size) for size in (0.1, 0.3, 0.5)},
    **{
        f"{share:.0%} faces lost": partial(without_faces, share=share)
        for share in (0.01, 0.03)
    },
    "unit, motion": _moved,
    "mirrored": lambda mesh, rng: TriangleMesh(
        mesh.vertices * [-1, 1, 1], mesh.faces[:, ::-1]
    ),
    SCANS: _scanned,
}

METHODS = (
    *(("hapt+r-bihdm", n) for n in (10, 15, 23, 40, 59)),
    *(("hapt", 23), ("r-bihdm", 23), ("r-bihdm", 59)),
)
TABLE = Table(
    Column("set", 7, align="<"),
    Column("queries", 15, align="<"),
    *(Column(f"{name} {n}".replace("hapt 23", "hapt"), 15, ".3f") for name, n in METHODS),
    Column("copies", 7, ".3f"),
    Column("others", 7, ".0f"),
)


def lines_of_changes(data: Path, limit: int | None, only: Sequence[str]) -> Iterator[str]:
    """Lines of each change of the meshes of some sets, as soon as they are known."""
    yield TABLE.head
    for name, items in ((name, SETS[name]) for name in only):
        if name == "tosca" and (missing := left_out(name, data / name)):
            yield missing
            continue
        bodies = items(data, limit)
        made: dict[str, list[Parts | None]] = {}
        for change in CHANGES:
            made[change] = all_in_workers(
                parts, [Task(body, change) for body in bodies], f"{name}, {change}"
            )
        for change, queries in made.items():
            gallery = queries if change == SCANS else list(made["as it is"])
            classes = np.array([body.label for body in bodies])
            maps = [_map(gallery, queries, classes, *how) for how in METHODS]
            yield TABLE.row(name, change, *maps, *_copies(gallery, queries))


class Task(NamedTuple):
    """A body and the name of its change."""

    item: Item
    change: str

    def __hash__(self) -> int:
        return hash((self.item.name, self.change))


class Parts(NamedTuple):
    """The values of hapt (154,), of r-bihdm (59,) and of moments (6,) of one shape."""

    hapt: FloatArray
    r_bihdm: FloatArray
    moments: FloatArray


def parts(task: Task) -> Parts | None:
    """The values of a body after a change; None if it has no surface."""
    item, change = task
    rng = np.random.default_rng((item.number, list(CHANGES).index(change)))
    options = PipelineOptions().changed(
        surface={"mode": "auto" if change == SCANS else "keep"}
    )
    try:
        shape = process(CHANGES[change](item.mesh, rng=rng), options)
        made = (
            SignatureOptions(method=method, n_values=59)
            for method in ("hapt", "r-bihdm", "moments")
        )
        return Parts(*(describe(shape, one).values for one in made))
    except ShapeError:
        return None


def _copies(
    gallery: Sequence[Parts | None], queries: Sequence[Parts | None]
) -> tuple[float, float]:
    """The share of the queries that are near their own shape, and the number of other near pairs."""
    known, points = (
        np.log([one.moments if one else np.full(6, np.nan) for one in side])
        for side in (gallery, queries)
    )
    near = pairwise("log", points, known) <= SAME
    is_own = np.eye(len(near), dtype=bool)
    return float("nan") if gallery is queries else float(near[is_own].mean()), float(
        near[~is_own].sum() / 2
    )


def _map(
    gallery: Sequence[Parts | None],
    queries: Sequence[Parts | None],
    classes: np.ndarray[tuple[int], np.dtype[np.str_]],
    method: str,
    n_values: int,
) -> float:
    """The mean average precision; a query or a shape without a surface is a miss."""
    has, asked = (
        np.array([one is not None for one in side]) for side in (gallery, queries)
    )
    options = SignatureOptions(method=method, n_values=n_values)
    known, points = (
        fused_points(
            {
                "hapt": coordinates(
                    np.array([one.hapt for one in side if one]), "histograms"
                ),
                "r-bihdm": coordinates(np.array([one.r_bihdm for one in side if one])),
            },
            options,
        )
        for side in (gallery, queries)
    )
    whitening = fit_whitening("unsupervised", known, people=people(options))
    apart = pairwise("log", whitening.apply(points), whitening.apply(known))
    found = 0.0
    for row, number in zip(apart, np.flatnonzero(asked), strict=True):
        same = classes[has] == classes[number]
        order = np.argsort(row, kind="stable")
        if gallery is queries:
            order = order[np.flatnonzero(has)[order] != number]
        ranks = np.flatnonzero(same[order]) + 1
        n_relevant = (classes == classes[number]).sum() - (gallery is queries)
        found += float((np.arange(1, len(ranks) + 1) / ranks).sum() / n_relevant)
    return found / len(queries)
