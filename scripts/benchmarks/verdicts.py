"""Print how many whole and damaged scans are called good or incomplete.

Simulated people and the meshes of TOSCA are scanned by nine cameras. Of each scan there are copies without a
lower limb or the head, with a hole of 8 % of the height, and with a tenth of the points on one side. "error"
is the median distance of the log-signature (r-bihdm, L = 23) to that of the clean mesh; the most frequent
reasons follow.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from benchmarks.measuring import (
    Column,
    Table,
    add_data,
    all_in_workers,
    argument_parser,
    print_lines,
)
from benchmarks.sets import SETS, Item, left_out
from pcretrieve.checks import findings_of, verdict_of
from pcretrieve.descriptors import describe
from pcretrieve.errors import ShapeError
from pcretrieve.options import JUDGED, PipelineOptions
from pcretrieve.pipeline.process import process, shape_of, stages
from pcretrieve.retrieval import Positions
from pcretrieve.simulation import RigOptions, scan
from pcretrieve.values import FloatArray, PointCloud, TriangleMesh
from pcretrieve.values.geometry import edge_graph

CONDITIONS = ("whole", "no limb", "hole", "density 10 : 1")

# The lengths of the limb that is missing, and of the hole, relative to the largest extent of the body.
LIMB, HOLE = 0.22, 0.08

# Share of the points that are left on the sparse side.
SPARSE = 0.1

TABLE = Table(
    Column("set", 8, align="<"),
    Column("condition", 15, align="<"),
    *(Column(title, 10, "d") for title in ("scans", "good", "incomplete", "failed")),
    Column("error", 6, ".2f"),
    Column("reasons", 1, align="<"),
)


class Judged(NamedTuple):
    """What is found of one scan: of each check by its name, the measurement and the expected error."""

    condition: str
    judgement: str
    error: float
    reasons: tuple[str, ...]
    checks: dict[str, tuple[float | None, float]]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argument_parser(__doc__)
    add_data(parser)
    parser.add_argument(
        "--limit", type=int, default=20, help="bodies of each set (default: %(default)s)"
    )
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help="write what was found of each scan"
    )
    given = parser.parse_args(arguments)
    print_lines(_lines(given.data, given.limit, given.json))


def _lines(data: Path, limit: int, file: Path | None) -> Iterator[str]:
    yield TABLE.head
    everything: dict[str, Any] = {}
    for name, items in SETS.items():
        if name == "tosca" and (missing := left_out(name, data / name)):
            yield missing
            continue
        tasks = [Task(item, condition) for item in items(data, limit) for condition in CONDITIONS]
        found = all_in_workers(judged, tasks, name)
        everything[name] = [one._asdict() for one in found]
        for condition in CONDITIONS:
            here = [one for one in found if one.condition == condition]
            counts = Counter(one.judgement for one in here)
            named = Counter(reason.partition(":")[0] for one in here for reason in one.reasons)
            shown = ", ".join(f"{reason} {n}" for reason, n in named.most_common(4))
            errors = [one.error for one in here if one.error == one.error]
            numbers = (counts["good"], counts["incomplete"], counts["failed"])
            yield TABLE.row(name, condition, len(here), *numbers, float(np.median(errors)), shown)
    if file is not None:
        file.write_text(json.dumps(everything, indent=1))


class Task(NamedTuple):
    """A body, and what is done to its scan."""

    item: Item
    condition: str

    def __hash__(self) -> int:
        return hash((self.item.name, self.condition))


def judged(task: Task) -> Judged:
    """Scan a body, damage the scan, and judge it."""
    item, condition = task
    rng = np.random.default_rng((item.number, CONDITIONS.index(condition)))
    cloud = scan(item.mesh, RigOptions(), rng)
    kept = cloud.select(_kept(cloud.points, item.mesh, condition, rng))
    options = PipelineOptions().changed(signature=JUDGED)
    whole = process(item.mesh, options.changed(surface={"mode": "keep"}))
    try:
        *_, last = stages(PointCloud(kept.points), options)
        shape = shape_of(last, options)
    except ShapeError as failure:
        return Judged(condition, "failed", float("nan"), (str(failure.stage),), {})
    truth, made = (np.log(describe(one, options.signature).values) for one in (whole, shape))
    checks = findings_of(last.cloud, last.mesh, last.marks, shape).checks
    verdict = verdict_of(checks)
    error = float(np.linalg.norm(made - truth))
    values = {check.name: (check.value, check.error) for check in checks}
    return Judged(condition, verdict.judgement, error, verdict.reasons, values)


def _kept(
    points: FloatArray, mesh: TriangleMesh, condition: str, rng: np.random.Generator
) -> Positions:
    """(k,) rows of the points that a damage leaves."""
    middle, height = points.mean(axis=0), np.ptp(points, axis=0).max()
    if condition == "hole":
        centre = points[rng.integers(len(points))]
        gone = np.linalg.norm(points - centre, axis=1) < HOLE * height / 2
    elif condition == "no limb":
        near = cKDTree(mesh.vertices).query(points)[1]
        gone = (_from_an_end(mesh, rng) < LIMB * height)[near]
    elif condition == "density 10 : 1":
        side = (points - middle) @ rng.standard_normal(3) > 0
        gone = side & (rng.random(len(points)) > SPARSE)
    else:
        gone = np.zeros(len(points), dtype=bool)
    return np.flatnonzero(~gone)


# A body has four limbs and a head. Ends with a smaller share of the surface are tails of dogs and horses,
# those with a larger one are no ends.
N_ENDS, SHARES = 5, (0.02, 0.25)


def _from_an_end(mesh: TriangleMesh, rng: np.random.Generator) -> FloatArray:
    """(n,) geodesic distances of the vertices from the end of a random limb."""
    reach, areas = LIMB * np.ptp(mesh.vertices, axis=0).max(), mesh.face_areas / mesh.area

    def is_limb(paths: FloatArray) -> bool:
        share = float(areas[(paths < reach)[mesh.faces].all(axis=1)].sum())
        return SHARES[0] < share < SHARES[1]

    return next(islice(filter(is_limb, _from_extremities(mesh)), int(rng.integers(N_ENDS)), None))


def _from_extremities(mesh: TriangleMesh) -> Iterator[FloatArray]:
    """(n,) lengths of the shortest paths along edges from one extremity of a body after the other.

    The extremities are found by farthest-point sampling that begins in the middle of the body.
    """
    graph = edge_graph(mesh)  # symmetric
    place = np.linalg.norm(mesh.vertices - mesh.vertices.mean(axis=0), axis=1).argmin()
    apart = dijkstra(graph, indices=np.array([place]))[0]
    while True:
        place = np.where(np.isfinite(apart), apart, 0).argmax()
        distances = dijkstra(graph, indices=np.array([place]))[0]
        apart = np.minimum(apart, distances)
        yield distances
