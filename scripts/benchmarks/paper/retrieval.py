"""Tables 3 and 4 and figure 3: retrieval in SHREC'11, alone and as the background of other shapes."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, NamedTuple

import numpy as np

from benchmarks.measuring import Column, Table, draw_curves, in_workers, progress, timed
from benchmarks.sets import (
    SETS,
    described,
    ingested,
    pooled_vectors,
    read_mesh,
    spread,
    write_scanned,
    written_set,
)
from benchmarks.simulation import POSES, body, make_subject
from benchmarks.synthetic import quartered
from pcretrieve.catalogue import Catalogue
from pcretrieve.descriptors import DESCRIPTORS, describe
from pcretrieve.errors import PcretrieveError, ShapeError
from pcretrieve.evaluation import rank_table
from pcretrieve.evaluation.measures import (
    PrecisionRecall,
    evaluate_rankings,
    precision_recall,
)
from pcretrieve.evaluation.rankings import Rankings, Subset, rank_subsets
from pcretrieve.formats import write_mesh
from pcretrieve.gallery.fitted import signatures
from pcretrieve.ingestion.discover import discover
from pcretrieve.ingestion.labels import discover_labelled, read_labels
from pcretrieve.options import PipelineOptions, RetrievalOptions, Scale, SignatureOptions
from pcretrieve.pipeline.process import process
from pcretrieve.plugins import METHODS
from pcretrieve.retrieval import DistanceBlock, table_whitening
from pcretrieve.shrec.matcher import MATCHERS, match_all
from pcretrieve.values import Metric, Shape, TriangleMesh
from pcretrieve.values.files import write_file
from pcretrieve.values.simplify import simplified

LENGTHS = (15, 20, 23, 25, 30)

NAMES = ("NN", "FT", "ST", "E", "DCG")

# Number of levels of recall of the curves of figure 3.
N_LEVELS = 21

ELEMENTS: Sequence[str] = ("linear", "cubic")

# Number of meshes of SHREC'11 that are the background of table 4 without --full.
N_BACKGROUND = 200

# Number of faces of the meshes of SHREC'11 in the usual version, and of those that are mixed with them.
N_FACES = 500

# The mAP of both tracks, synthetic and real, as published.
TABLE_5 = {
    "ISPM": (0.902, 0.258),
    "HAPT": (0.817, 0.637),
    "unsupervised dictionary learning": (0.842, 0.533),
    "supervised dictionary learning": (0.954, 0.791),
    "ShapeGoogle (VQ)": (0.813, 0.514),
    "R-BiHDM-s": (0.642, 0.640),
}

# NN, FT, ST, E and DCG as published, for meshes of about 9,000 faces. The paper does not say by which of D1
# and D2, and with which element.
Published = Mapping[str, tuple[float, float, float, float, float]]
TABLE_3: Published = {
    "Shape-DNA": (0.998, 0.890, 0.952, 0.696, 0.975),
    "MDS-CM-BoF": (0.995, 0.913, 0.969, 0.717, 0.982),
    "meshSIFT": (0.998, 0.800, 0.851, 0.627, 0.944),
    "SD-GDM": (1.000, 0.956, 0.982, 0.728, 0.992),
    "BiHDM-L25": (0.990, 0.915, 0.979, 0.719, 0.984),
    "R-BiHDM-L30": (0.998, 0.969, 0.981, 0.729, 0.993),
    "R-BiHDM-L25": (0.998, 0.971, 0.982, 0.729, 0.994),
    "R-BiHDM-L23": (1.000, 0.971, 0.983, 0.730, 0.994),
    "R-BiHDM-L20": (1.000, 0.964, 0.982, 0.728, 0.993),
    "R-BiHDM-L15": (0.998, 0.955, 0.981, 0.726, 0.991),
}
TABLE_4: Published = {
    "Shape-DNA": (0.985, 0.841, 0.906, 0.666, 0.954),
    "meshSIFT": (0.995, 0.790, 0.890, 0.650, 0.950),
    "SD-GDM": (1.000, 0.929, 0.986, 0.731, 0.991),
    "BiHDM-L25": (1.000, 0.930, 0.983, 0.722, 0.990),
    "R-BiHDM-L30": (1.000, 0.970, 0.996, 0.739, 0.997),
    "R-BiHDM-L25": (1.000, 0.975, 0.997, 0.742, 0.998),
    "R-BiHDM-L23": (1.000, 0.976, 0.997, 0.742, 0.998),
    "R-BiHDM-L20": (1.000, 0.975, 0.997, 0.742, 0.998),
    "R-BiHDM-L15": (1.000, 0.970, 0.994, 0.739, 0.997),
}


@dataclass(frozen=True, slots=True)
class System:
    """A row of a table."""

    title: str
    method: str
    n_values: int = 23
    distance: str = "d2"
    scale: Scale = "relative"
    element: str = "linear"
    in_figure: bool = False


def _systems(*, full: bool) -> list[System]:
    """The rows of both tables: as published; with `full` also as pcretrieve has them, and the slow ones."""
    published = [
        System("Shape-DNA", "shape-dna-norm1-values", 12, "log", in_figure=True),
        System("SD-GDM", "sd-gdm-sampled", distance="d1", in_figure=True),
        System("BiHDM-L25", "bihdm-sampled", 25, in_figure=True),
        *(
            System(
                f"R-BiHDM-L{n}",
                "r-bihdm",
                n,
                distance,
                element=element,
                in_figure=(n, distance, element) == (23, "d2", "linear"),
            )
            for n in LENGTHS
            for distance in ("d1", "d2")
            for element in (ELEMENTS if full else ELEMENTS[:1])
        ),
        System("ISPM", "ispm", 59, "log", in_figure=True),
    ]
    ours = [
        System("R-BiHDM-L23 by area", "r-bihdm", scale="area"),
        System(
            "default, without whitening",
            "hapt+r-bihdm",
            23,
            "log",
            "area",
            in_figure=True,
        ),
    ]
    if not full:
        return published + ours
    return [
        *published,
        System("MDS-CM-BoF", "mds-cm-bof", distance="pairs", in_figure=True),
        System("meshSIFT", "meshsift", distance="pairs", in_figure=True),
        System("ShapeGoogle", "hks-bow-gallery", distance="pairs", in_figure=True),
        System("HAPT", "hapt", distance="log", in_figure=True),
        System("HAPT with R-BiHDM-L23", "hapt+r-bihdm", distance="log"),
        System("Shape-DNA by logarithms", "shape-dna-norm1", 12, "log"),
        System("SD-GDM by area elements", "sd-gdm"),
        System("BiHDM-L25 by area elements", "bihdm", 25),
        *ours,
    ]


def retrieval_tables(
    part: str, data: Path, output: Path | None, *, full: bool
) -> Iterator[str]:
    """Table 3 or table 4, and its precision–recall curves (figure 3).

    The queries of table 4 are the meshes of TOSCA, simplified to as many faces as those of SHREC'11, which
    are their unlabelled background; the 200 deformed meshes of the paper are no longer published.
    """
    with TemporaryDirectory() as temporary:
        folder, labels, published = data / "shrec11", None, TABLE_3
        title, elements = (
            f"Table 3: SHREC'11, {N_FACES} faces",
            ELEMENTS if full else ELEMENTS[:1],
        )
        if part == "table4":
            folder, published = Path(temporary) / "mixed", TABLE_4
            labels = _mixed(data, folder, None if full else N_BACKGROUND)
            n_others = len(list(folder.iterdir())) - len(labels)
            title = f"Table 4: TOSCA among {n_others} unlabelled meshes of SHREC'11, {N_FACES} faces"
        yield f"{title}; in parentheses the measures of the paper, of other meshes"
        curves: dict[str, PrecisionRecall] = {}
        yield f"{'system':<28}{'FEM':<8}{'D':<6}" + "".join(
            f"{name:<14}" for name in (*NAMES, "mAP")
        )
        for element in elements:
            options = PipelineOptions().changed(
                surface={"mode": "keep"}, spectral={"element": element}
            )
            with ingested(
                folder, Path(temporary) / f"{element}.sqlite", options, labels
            ) as (
                catalogue,
                _,
            ):
                systems = [
                    system for system in _systems(full=full) if system.element == element
                ]
                for system in progress(systems, f"{part}, {element}"):
                    ranked = (_matched if system.distance == "pairs" else _ranked)(
                        catalogue, system
                    )
                    yield _row(system, ranked, published.get(system.title))
                    if system.in_figure:
                        curves[system.title] = precision_recall(ranked, n_points=N_LEVELS)
        if output is not None:
            yield from _figure(
                curves, output / ("figure3a" if part == "table3" else "figure3b")
            )


def _mixed(data: Path, folder: Path, limit: int | None) -> dict[str, str]:
    """Write simplified meshes of TOSCA beside some of SHREC'11, and return their classes by file name."""
    folder.mkdir()
    for _, scan in spread(discover([data / "shrec11"]), limit):
        (folder / f"background-{scan.name}").symlink_to(scan.file.resolve())
    classes = read_labels(data / "tosca" / "labels.csv")
    labels = {}
    for scan in progress(discover([data / "tosca"]), "simplified"):
        with suppress(ShapeError):  # one mesh of TOSCA is not closed
            write_mesh(simplified(read_mesh(scan.file), N_FACES), folder / scan.name)
            labels[scan.name] = classes[scan.name]
    return labels


def _ranked(catalogue: Catalogue, system: System) -> Rankings:
    options = SignatureOptions(
        method=system.method, n_values=system.n_values, scale=system.scale
    )
    table, failed = described(catalogue, options)
    retrieval = RetrievalOptions(distance=system.distance, whitening="none")
    return rank_table(table, retrieval, failed=failed)[0]


def _matched(catalogue: Catalogue, system: System) -> Rankings:
    """Rank all pairs; shapes without features count as misses."""
    matcher = MATCHERS[system.method]
    ids = signatures(catalogue).ids
    names, distances = match_all(
        matcher, ids, lambda shape_id: catalogue.shape(shape_id, matcher.needs)
    )
    classes = {record.id: record.label for record in catalogue.records()}
    labels = [classes.pop(shape_id) for shape_id in names]
    block = DistanceBlock(np.arange(len(names)), distances)
    everything = Subset(np.arange(len(names)), [block])
    return rank_subsets([everything], names, labels, failed=classes)[0]


def _row(system: System, ranked: Rankings, published: Sequence[float] | None) -> str:
    found = evaluate_rankings(ranked)
    values = (found.nn, found.ft, found.st, found.e, found.dcg)
    cells = [f"{value:.3f}" for value in values]
    if published is not None:
        cells = [
            f"{cell} ({other:.3f})" for cell, other in zip(cells, published, strict=True)
        ]
    measures = "".join(f"{cell:<14}" for cell in cells)
    return f"{system.title:<28}{system.element:<8}{system.distance:<6}{measures}{found.map:.3f}"


def _figure(curves: Mapping[str, PrecisionRecall], stem: Path) -> Iterator[str]:
    """Write precision–recall curves as a picture and as a table."""
    levels = next(iter(curves.values())).recall
    precisions = {title: curve.precision for title, curve in curves.items()}
    draw_curves(
        stem.with_suffix(".png"),
        levels,
        precisions,
        x_label="recall",
        y_label="precision",
        scale="linear",
    )
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(["recall", *precisions])
    writer.writerows(
        zip(levels.tolist(), *(row.tolist() for row in precisions.values()), strict=True)
    )
    write_file(stem.with_suffix(".csv"), table.getvalue().encode())
    yield f"wrote {stem}.png and {stem}.csv"


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
    """Seconds of one shape by every descriptor and matcher."""
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
    methods += [("descriptor", name) for name in METHODS]
    methods += [("matcher", name) for name in MATCHERS]
    tasks = [Task(*method, size) for method in methods for size in sizes]
    costs = in_workers(
        _cost, tasks, "table2", workers=1, timeout=TIMEOUTS[full], memory=MEMORY
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
        yield table.row(
            method,
            _needs(kind, method),
            *cells,
            _growth(seconds),
            max(pairs, default=None),
        )
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
    learned = matcher.learn([first]) if matcher.learn else (lambda features: features)
    matcher.distance(learned(first), learned(first))
    seconds, features = timed(lambda: learned(matcher.prepare(shape)))
    return Cost(seconds, timed(lambda: matcher.distance(features, features))[0])


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
        made = quartered(made)
    return made


TRACKS = ("synthetic", "real")

# How simulated people are scanned for the real track; those of the synthetic track are clean meshes.
CONDITION = "typical-uniform"

# Number of bodies of simulated people, of 100, without --full.
N_BODIES = 30


class Track(NamedTuple):
    title: str
    folder: Path
    options: PipelineOptions
    labels: dict[str, str]


def _by_area(title: str, method: str, n_values: int = 59) -> System:
    """A row of table 5; without a title, the paper has no such row."""
    return System(title, method, n_values, "log", "area")


SYSTEMS = (
    _by_area("ISPM", "ispm"),
    _by_area("HAPT", "hapt", 154),
    _by_area("unsupervised dictionary learning", "dl", 32),
    _by_area("supervised dictionary learning", "dl-supervised", 32),
    _by_area("ShapeGoogle (VQ)", "hks-bow"),
    System("R-BiHDM-s", "r-bihdm"),
    _by_area("R-BiHDM-s", "r-bihdm"),
    *(_by_area("", method) for method in ("bihdm", "shape-dna", "hapt+r-bihdm")),
)

# The vectors, by what is compared; and the whitenings, of which the last one is fitted by grouped folds.
METRICS: tuple[Metric, ...] = ("values", "logarithms")
WHITENINGS = ("none", "neighbours", "within-class")


def table_5(data: Path, *, full: bool) -> Iterator[str]:
    """The mAP of people, by our methods and as published.

    A track is measured on its meshes where the folder of the data has a folder by the name of its layout,
    ``shrec14-synthetic`` or ``shrec14-real``; else on ten simulated people, as clean meshes or as scans.
    """
    published = {
        name: {method: both[k] for method, both in TABLE_5.items()}
        for k, name in enumerate(TRACKS)
    }
    yield "Table 5: mAP of people without whitening; in parentheses that of the paper, of SHREC'14"
    measured: dict[str, dict[System, float]] = {}
    with TemporaryDirectory() as temporary:
        for name in TRACKS:
            if name == "real" and not full and not (data / "shrec14-real").is_dir():
                measured[name] = {}
                yield "real: left out; --full has scans of simulated people"
                continue
            made = track(name, data, Path(temporary), None if full else N_BODIES)
            yield f"{name}: {made.title}"
            file = Path(temporary) / f"{name}.sqlite"
            with ingested(made.folder, file, made.options, made.labels) as (catalogue, _):
                measured[name] = {
                    system: evaluate_rankings(_ranked(catalogue, system)).map
                    for system in progress(SYSTEMS, name)
                }
    yield (
        f"{'method':<16}{'L':<4}{'scale':<10}{'D':<5}"
        + "".join(f"{name:<16}" for name in TRACKS).rstrip()
    )
    for system in SYSTEMS:
        cells = [
            _cell(measured[name].get(system), published[name].get(system.title))
            for name in TRACKS
        ]
        facts = f"{system.method:<16}{system.n_values:<4}{system.scale:<10}{system.distance:<5}"
        yield facts + "".join(f"{cell:<16}" for cell in cells).rstrip()
    if (data / "shrec14_csd").is_dir():
        yield from _vector_rows(data / "shrec14_csd")


def _vector_rows(folder: Path) -> Iterator[str]:
    """A row for each whitening of the published vectors."""
    yield ""
    yield "SHREC'14 itself, by the descriptors of Chiotellis et al. (ECCV 2016), mAP"
    yield (
        f"{'compared':<16}{'whitening':<19}"
        + "".join(f"{name:<16}" for name in TRACKS).rstrip()
    )
    for metric in METRICS:
        tables = [pooled_vectors(folder / f"{name}.mat", metric) for name in TRACKS]
        for kind in WHITENINGS:
            retrieval = RetrievalOptions(whitening=kind)
            cells = []
            for table in tables:
                fitted = (
                    None if kind == "within-class" else table_whitening(table, retrieval)
                )
                cells.append(
                    f"{evaluate_rankings(rank_table(table, retrieval, whitening=fitted)[0]).map:.3f}"
                )
            yield (
                f"{metric:<16}{kind:<19}"
                + "".join(f"{cell:<16}" for cell in cells).rstrip()
            )


def _cell(measured: float | None, published: float | None) -> str:
    found = "-" if measured is None else f"{measured:.3f}"
    return found if published is None else f"{found} ({published:.3f})"


def track(name: str, data: Path, temporary: Path, n_bodies: int | None) -> Track:
    """The meshes of a track of SHREC'14, or else simulated people."""
    keep = PipelineOptions().changed(surface={"mode": "keep"})
    layout = f"shrec14-{name}"
    folder = data / layout
    if folder.is_dir():
        paths, labels = discover_labelled([folder], layout)
        return Track(f"{len(paths)} meshes of {layout}", folder, keep, labels)
    items, folder = SETS["humans"](data, n_bodies), temporary / name
    if name == "synthetic":
        labels = written_set(items, folder)
        return Track(
            f"{len(items)} clean meshes of simulated people", folder, keep, labels
        )
    labels = written_set(items, folder, partial(write_scanned, CONDITION))
    return Track(
        f"{len(items)} scans of simulated people, reconstructed",
        folder,
        PipelineOptions(),
        labels,
    )
