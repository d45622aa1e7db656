"""Table 2: how long each method takes for one shape, and how that grows with the number of vertices."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any, Literal, NamedTuple

import numpy as np

from pcretrieve.benchmarks.progress import progress
from pcretrieve.benchmarks.tables import Column, Table
from pcretrieve.benchmarks.timing import timed
from pcretrieve.descriptors import DESCRIPTORS, describe
from pcretrieve.errors import PcretrieveError, ShapeError
from pcretrieve.ingestion.isolation import in_processes
from pcretrieve.matching import MATCHERS
from pcretrieve.options import PipelineOptions, SignatureOptions
from pcretrieve.pipeline.process import process
from pcretrieve.simulation import POSES, body, make_subject
from pcretrieve.surface.simplify import simplified
from pcretrieve.values import Shape, TriangleMesh

__all__ = ["table_2"]

# Numbers of vertices with and without --full, of which the first one also warms up: numba compiles functions.
SIZES = {True: (1000, 2000, 5000, 10_000, 20_000, 50_000), False: (1000, 5000, 20_000)}

# Longest time for one method and one mesh with and without --full, in seconds; largest heap, in GiB.
TIMEOUTS = {True: 600.0, False: 60.0}
MEMORY = 8.0

# Shortest time of which the growth is computed; seconds.
LEAST_SECONDS = 0.001

OPTIONS = PipelineOptions().changed(surface={"mode": "keep"})

Kind = Literal["process", "descriptor", "matcher"]


class Task(NamedTuple):
    """A method, and the number of vertices of the mesh to which it is applied."""

    kind: Kind
    method: str
    size: int


class Cost(NamedTuple):
    """Seconds of one shape, and of a pair of shapes by methods that compare pairs."""

    shape: float
    pair: float | None


def table_2(*, full: bool) -> Iterator[str]:
    """Seconds of one shape by every descriptor and matcher.

    Parameters
    ----------
    full : bool
        Whether all sizes are measured, and long times are waited for.

    Yields
    ------
    str
        A line of the table.
    """
    sizes = SIZES[full]
    yield "Table 2: seconds for a simulated person of so many vertices, on one core. Those of methods that"
    yield "need the spectrum are in addition to it; the growth is the power of the number of vertices."
    table = Table(
        Column("method", 22, align="<"),
        Column("needs", 9, align="<"),
        *(Column(f"{size:,}", 8, ".4f") for size in sizes),
        Column("growth", 6, ".1f"),
        Column("ms a pair", 9, ".2f"),
    )
    methods: list[tuple[Kind, str]] = [("process", "spectrum and checks")]
    methods += [("descriptor", name) for name in DESCRIPTORS.own]
    methods += [("matcher", name) for name in MATCHERS.own]
    tasks = [Task(*method, size) for method in methods for size in sizes]
    costs = dict(
        in_processes(_cost, progress(tasks, "table2"), workers=1, timeout=TIMEOUTS[full], memory=MEMORY)
    )
    yield table.head
    failures = []
    for kind, method in methods:
        found: dict[int, Cost] = {}
        for size in sizes:
            cost = costs[Task(kind, method, size)]
            if isinstance(cost, ShapeError):
                failures.append(f"{method}, {size:,} vertices: {cost.message}")
            elif isinstance(cost, PcretrieveError):
                raise cost
            else:
                found[size] = cost
        pairs = [1000 * cost.pair for cost in found.values() if cost.pair is not None]
        seconds = {size: cost.shape for size, cost in found.items()}
        cells = [seconds.get(size) for size in sizes]
        yield table.row(method, _needs(kind, method), *cells, _growth(seconds), max(pairs, default=None))
    yield from failures


def _needs(kind: Kind, method: str) -> str:
    """Whether a method starts from the spectrum or from the surface."""
    if kind == "process":
        return "mesh"
    needs = DESCRIPTORS[method].needs if kind == "descriptor" else MATCHERS[method].needs
    return "mesh" if set(needs) == {"mesh"} else "spectrum"


def _growth(seconds: Mapping[int, float]) -> float | None:
    """The slope of the logarithm of the seconds over that of the number of vertices, by least squares."""
    long = {size: time for size, time in seconds.items() if time >= LEAST_SECONDS}
    if len(long) < 2:
        return None
    return float(np.polyfit(np.log(list(long)), np.log(list(long.values())), 1)[0])


def _cost(task: Task) -> Cost:
    """Apply a method in a worker process, which keeps the shapes that it has made."""
    mesh = _person(task.size)
    if task.kind == "process":
        process(_person(SIZES[True][0]), OPTIONS)
        return Cost(timed(lambda: process(mesh, OPTIONS))[0], None)
    warm, shape = _shape(SIZES[True][0]), _shape(task.size)
    if task.kind == "descriptor":
        options = SignatureOptions(method=task.method)
        describe(warm, options)
        return Cost(timed(lambda: describe(shape, options))[0], None)
    matcher = MATCHERS[task.method]
    first = matcher.prepare(warm)
    learned = _unchanged if matcher.learn is None else matcher.learn([first])
    matcher.distance(learned(first), learned(first))
    seconds, features = timed(lambda: learned(matcher.prepare(shape)))
    return Cost(seconds, timed(lambda: matcher.distance(features, features))[0])


def _unchanged(features: Any) -> Any:
    return features


@cache
def _shape(size: int) -> Shape:
    """A person with the spectrum."""
    return process(_person(size), OPTIONS)


@cache
def _person(size: int) -> TriangleMesh:
    """The surface of a simulated person, simplified, or refined where that has fewer vertices."""
    rng = np.random.default_rng(0)
    person = body(make_subject("person", rng), POSES["person"]["stand"], rng)
    n_refinements = 0
    while size > 4**n_refinements * len(person.vertices):
        n_refinements += 1
    # A closed surface without handles has 2 n − 4 faces; a refinement makes four of each.
    made = simplified(person, (2 * size - 4) // 4**n_refinements)
    for _ in range(n_refinements):
        made = _refined(made)
    return made


def _refined(mesh: TriangleMesh) -> TriangleMesh:
    """Each face divided into four at the midpoints of its edges."""
    n = len(mesh.vertices)
    edges = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)  # (3m, 2)
    unique, number = np.unique(edges, axis=0, return_inverse=True)
    (a, b, c), (ab, bc, ca) = mesh.faces.T, n + number.reshape(-1, 3).T
    vertices = np.concatenate([mesh.vertices, mesh.vertices[unique].mean(axis=1)])
    faces = np.concatenate(
        [np.column_stack(corners) for corners in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]
    )
    return TriangleMesh(vertices, faces)
