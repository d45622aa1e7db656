"""Scan clean meshes virtually, reconstruct them, and print the errors against the clean meshes.

The clean mesh is the ground truth for the normals, the surface and the signature of its scan. Every run
prints the same numbers, except for times, because every scan has a random generator. A scan takes
about 4 seconds, a third of them for the measurements: 13 minutes for the 176 meshes of both sets under one
condition, on one core. With --changes, meshes are not scanned but changed, by another resolution, noise or
lost faces, and are queries in the clean meshes: each column is the mean average precision by one descriptor.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import io
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from functools import partial
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from benchmarks.changes import lines_of_changes
from benchmarks.measuring import (
    Column,
    Table,
    add_data,
    argument_parser,
    evaluate_table,
    forget_peak,
    is_missing,
    peak_memory,
    positive,
    print_lines,
    progress,
    use_one_core,
)
from benchmarks.sets import CONDITIONS, DEFECTS, SETS, Item, spread, write_scan
from benchmarks.spectral import lapy_eigenvalues
from benchmarks.uniform import BODIES, feet, points_of
from pcretrieve.arrays import DOUBLE_OFFSET, Frame
from pcretrieve.arrays.open3d import RayScene, open3d_cloud
from pcretrieve.descriptors import describe
from pcretrieve.errors import BenchmarkError, InputError, PcretrieveError
from pcretrieve.formats import read_scan
from pcretrieve.ingestion.pool import in_processes
from pcretrieve.options import JUDGED, PipelineOptions, RetrievalOptions, WhiteningKind
from pcretrieve.pipeline.process import process, signature
from pcretrieve.points import clean, oriented_normals
from pcretrieve.points.normals import estimate_normals, orient_by_tangent_planes
from pcretrieve.retrieval import coordinates
from pcretrieve.spectral import eigenpairs, laplace_beltrami
from pcretrieve.surface import tetwild
from pcretrieve.surface.poisson import poisson
from pcretrieve.surface.reconstruct import uniform_points
from pcretrieve.surface.tetwild import boundary_faces
from pcretrieve.values import FloatArray, PointCloud, Shape, SignatureTable, TriangleMesh
from pcretrieve.values.files import write_file
from pcretrieve.values.topology import compact, defects

EPILOG = """example:
  scripts/benchmark fidelity --set humans --limit 10
  scripts/benchmark fidelity --conditions typical-uniform harsh-rig --config mine.toml --name mine --csv f.csv
  scripts/benchmark fidelity --bodies 30000 1000000

--conditions:
  easy|typical|harsh - uniform|rig          points only, uniform or seen by nine cameras
  easy|typical|harsh - uniform|rig-sensors  the same, with the sensor position of each point
  defects                                   the clean mesh with holes, flipped and duplicate faces, and
                                            self-intersections
"""

# Euler characteristic of every mesh of both sets, if its holes are closed.
SPHERE = 2

# Largest number of meshes that --rescans scans repeatedly.
N_RESCANNED = 5


class Scans(NamedTuple):
    """The scans of one set under one condition."""

    set: str
    condition: str
    items: list[Item]
    paths: list[Path]
    again: list[list[Path]]
    timed: list[int]
    textbook: list[float]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    given = _parser().parse_args(arguments)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = "1"  # for the workers, which have not imported numpy yet
    if given.workers == 1:
        use_one_core()
    try:
        if given.bodies:
            print_lines(_of_bodies(given.bodies))
        elif given.changes:
            print_lines(lines_of_changes(given.data, given.limit, given.set or [*SETS]))
        else:
            print_lines(_run(given, _configurations(given)))
    except PcretrieveError as error:
        sys.exit(str(error))


def _parser() -> argparse.ArgumentParser:
    parser = argument_parser(__doc__, EPILOG)
    add_data(parser)
    add = parser.add_argument
    add(
        "--set",
        action="append",
        choices=SETS,
        help="one set only; may be repeated (default: all)",
    )
    add(
        "--conditions",
        nargs="+",
        choices=CONDITIONS,
        default=["typical-uniform"],
        metavar="NAME",
    )
    add(
        "--config",
        action="append",
        type=Path,
        default=[],
        metavar="TOML|PRESET",
        help="may be repeated",
    )
    add(
        "--name",
        action="append",
        help="names of the configurations (default: those of the files)",
    )
    add(
        "--limit",
        type=positive,
        metavar="N",
        help="scan N meshes only, evenly spread over the set",
    )
    add(
        "--rescans",
        type=positive,
        default=0,
        metavar="N",
        help="scan a few meshes N times, for the spread",
    )
    add(
        "--bodies",
        nargs="+",
        type=positive,
        metavar="N",
        help="only scan analytic bodies, with N points",
    )
    add(
        "--changes",
        action="store_true",
        help="only change the meshes, and print the rankings",
    )
    add(
        "--textbook",
        type=positive,
        default=0,
        metavar="K",
        help="time the textbook pipeline on K scans",
    )
    add("--csv", type=Path, metavar="FILE", help="append the rows to this file")
    add(
        "--workers",
        type=positive,
        default=1,
        metavar="N",
        help="processes; more than 1 spoil times",
    )
    return parser


def _configurations(given: argparse.Namespace) -> dict[str, PipelineOptions]:
    """Options by name, all with R-BiHDM signatures of one length, which earlier tables have too."""
    loaded = [PipelineOptions.of(name) for name in given.config] or [PipelineOptions()]
    names = given.name or [path.stem for path in given.config] or ["default"]
    if not len(set(names)) == len(names) == len(loaded):
        raise InputError(
            f"configurations must have distinct names, one for each, got {', '.join(names)}"
        )
    return {
        name: options.changed(signature={"method": "r-bihdm", "n_values": N_VALUES})
        for name, options in zip(names, loaded, strict=True)
    }


def _run(
    given: argparse.Namespace, configurations: dict[str, PipelineOptions]
) -> Iterator[str]:
    """Lines of every set under every condition with every configuration, as soon as they are known."""
    for name in given.set or SETS:
        items = SETS[name](given.data, given.limit)
        truths = {
            label: _truth(name, items, options, given.workers)
            for label, options in configurations.items()
        }
        yield f"{name}:"
        yield TABLE.head
        for condition in given.conditions:
            with tempfile.TemporaryDirectory() as folder:
                scans = _scanned(name, items, condition, given, Path(folder))
                for label, options in configurations.items():
                    row = _row(scans, label, options, truths[label], given.workers)
                    yield from lines_of(row)
                    if given.csv:
                        append(given.csv, row)


TURNED = Table(
    Column("body", 10, align="<"),
    *(
        Column(title, 9, form)
        for title, form in (("points", ",d"), ("turned", ""), ("dropped", ",d"))
    ),
    *(Column(title, 9, ".3%") for title in ("median", "99 %", "largest")),
    *(
        Column(title, 9, form)
        for title, form in (("signature", ".4f"), ("time/s", ".1f"))
    ),
)


def _of_bodies(numbers: Sequence[int]) -> Iterator[str]:
    """Lines of analytic bodies, exact and turned: dropped points; distances of the vertices of their surfaces
    from the bodies, relative to the diagonal; and of the signature of the turned one from the other.
    """
    yield TURNED.head
    options, turn = (
        PipelineOptions().changed(signature=JUDGED),
        Rotation.random(random_state=1).as_matrix(),
    )
    for n, (name, body) in product(numbers, BODIES.items()):
        points = points_of(body, n, np.random.default_rng(0))
        logs: list[FloatArray] = []
        for axes in (np.eye(3), turn):
            started = time.process_time()
            shape = process(PointCloud(points @ axes.T), options)
            logs.append(coordinates(describe(shape, options.signature).values[None])[0])
            seconds = time.process_time() - started
            cleaned = next(step for step in shape.provenance if step.stage == "clean")
            meshes = [
                surface.mesh for surface in shape.surfaces if surface.mesh is not None
            ]
            vertices = np.concatenate([mesh.vertices for mesh in meshes]) @ axes
            apart = (
                np.linalg.norm(vertices - feet(body, vertices), axis=1)
                / PointCloud(points).diagonal
            )
            measured = (
                int(cleaned.sizes["outliers"]),
                *np.quantile(apart, (0.5, 0.99, 1)).tolist(),
            )
            is_turned = "no" if len(logs) == 1 else "yes"
            moved = float(np.linalg.norm(logs[-1] - logs[0]))
            yield TURNED.row(name, n, is_turned, *measured, moved, seconds)


def _truth(
    name: str, items: list[Item], options: PipelineOptions, workers: int
) -> Signatures:
    """Signatures of the clean meshes of a set."""
    arguments = [(item.mesh, options) for item in items]
    signed = answers(
        f"{name}: clean meshes", clean_signatures, arguments, workers=workers
    )
    done = [one for one in signed if one]
    if len(done) < len(signed):
        raise BenchmarkError(
            f"every clean mesh of {name} must have a signature, got none of {len(signed) - len(done)}"
        )
    return stacked(done)


def _scanned(
    name: str, items: list[Item], condition: str, given: argparse.Namespace, folder: Path
) -> Scans:
    """Scan every mesh of a set, scan some of them repeatedly, and time the textbook pipeline on some."""
    title = f"{name} {condition}"
    paths = [
        write_scan(
            folder / item.name, item.mesh, condition, np.random.default_rng(item.number)
        )
        for item in progress(items, f"{title}: scanning")
    ]
    again = [
        [
            write_scan(
                folder / f"{item.name}-{take}",
                item.mesh,
                condition,
                np.random.default_rng((item.number, take)),
            )
            # From 1, because the seed (n, 0) is equivalent to n, the seed of the first scan.
            for take in range(1, given.rescans + 1)
        ]
        for _, item in progress(spread(items, N_RESCANNED), f"{title}: scanning again")
    ]
    # The textbook pipeline begins with points, which a damaged mesh does not have.
    timed = [] if condition == DEFECTS else [k for k, _ in spread(paths, given.textbook)]
    arguments = [(paths[k], TIMEOUT) for k in timed]
    seconds = answers(f"{title}: textbook", textbook_seconds, arguments, workers=1)
    return Scans(
        name, condition, items, paths, again, timed, [s for s in seconds if s is not None]
    )


def _row(
    scans: Scans, name: str, options: PipelineOptions, truth: Signatures, workers: int
) -> Row:
    """Run one configuration on the scans of one condition; `truth` has the clean signatures."""
    title, n = f"{scans.set} {scans.condition} {name}", len(scans.items)
    arguments = [
        (path, item.mesh, options)
        for path, item in zip(scans.paths, scans.items, strict=True)
    ]
    examined: list[Examination | None] = answers(
        title, examine, arguments, workers=workers
    )
    again = [(path, options) for own in scans.again for path in own]
    signed = iter(answers(f"{title} again", signature, again, workers=workers))
    repeats = [[one.values for _ in own if (one := next(signed))] for own in scans.again]
    rows = [k for k, answer in enumerate(examined) if answer]
    done = [answer for answer in examined if answer]
    found = stacked([answer.signatures for answer in done])
    errors = np.linalg.norm(
        np.log(found.relative / truth.relative[rows]), axis=1
    ).tolist()
    stages = dict.fromkeys(stage for answer in done for stage in answer.stages)
    textbook = median(scans.textbook)
    clean = retrieval(truth, scans.items, range(n), options)
    return {
        "set": scans.set,
        "condition": scans.condition,
        "name": name,
        "digest": options.digest,
        "scans": n,
        "failed": n - len(done),
        "normals_right": mean(
            answer.normals for answer in done if answer.normals is not None
        ),
        "closed": sum(answer.closed for answer in done) / n,
        "euler_right": sum(answer.euler == SPHERE for answer in done) / n,
        "distance_mean": median(answer.mean for answer in done),
        "distance_hausdorff": median(answer.hausdorff for answer in done),
        "log_error_median": median(errors),
        "log_error_mean": mean(errors),
        **retrieval(found, scans.items, rows, options),
        **{f"clean_{measure}": value for measure, value in clean.items()},
        "seconds": median(answer.seconds for answer in done),
        "processor_seconds": median(answer.processor for answer in done),
        "stages": json.dumps(
            {s: round(median(a.stages.get(s, 0.0) for a in done), 4) for s in stages}
        ),
        "peak_mib": max((answer.peak for answer in done), default=NAN),
        "rescan_spread": relative_spread(
            repeats, found.values, [scans.items[k].label for k in rows]
        ),
        "textbook_seconds": textbook,
        "textbook_ratio": textbook
        / median(a.seconds for k in scans.timed if (a := examined[k])),
    }


NAN = float("nan")

# Columns of the CSV file. Fractions are relative to all scans, including scans that failed, except for
# `normals_right`. Distances are relative to the diagonal; distances and seconds are medians over the scans
# that did not fail. Errors are of log-signatures with the scale relative; the spread of rescans is of
# signatures by the options of the configuration. Values that were not or cannot be measured are NaN.
COLUMNS = (
    *(
        "set",
        "condition",
        "name",
        "digest",
        "scans",
        "failed",
        "normals_right",
        "closed",
        "euler_right",
    ),
    *("distance_mean", "distance_hausdorff", "log_error_median", "log_error_mean"),
    *(
        "nn",
        "map",
        "nn_within",
        "map_within",
        "clean_nn",
        "clean_map",
        "clean_nn_within",
        "clean_map_within",
    ),
    *(
        "seconds",
        "stages",
        "peak_mib",
        "rescan_spread",
        "textbook_seconds",
        "textbook_ratio",
    ),
    *(
        "nn_relative",
        "map_relative",
        "nn_pca",
        "map_pca",
        "clean_nn_relative",
        "clean_map_relative",
    ),
    *(
        "clean_nn_pca",
        "clean_map_pca",
        "nn_sized",
        "map_sized",
        "clean_nn_sized",
        "clean_map_sized",
    ),
    "processor_seconds",
)

# One set under one condition with one choice of options: its values by the names of the columns.
Row = dict[str, Any]


def lines_of(row: Row) -> Iterator[str]:
    """A line of `TABLE`, and further lines with the values that are not in the table."""
    yield TABLE.row(*(row[name] for name in SHOWN))
    yield (
        "    clean meshes: NN {clean_nn:.3f}, mAP {clean_map:.3f}, "
        "within-class NN {clean_nn_within:.3f}, mAP {clean_map_within:.3f}"
    ).format_map(row)
    stages = json.loads(row["stages"])
    total = sum(stages.values())
    yield "    " + ", ".join(
        f"{stage} {s:.2f} s ({s / total:.1%})" for stage, s in stages.items()
    )
    for name, text in (
        ("processor_seconds", "processor time of a scan: {processor_seconds:.2f} s"),
        (
            "rescan_spread",
            "spread of rescans / distance to the nearest other class: {rescan_spread:.3f}",
        ),
        (
            "textbook_ratio",
            "textbook: median {textbook_seconds:.1f} s, {textbook_ratio:.1f} times as long as pcretrieve",
        ),
    ):
        if not is_missing(row[name]):
            yield f"    {text.format_map(row)}"


# Columns that are printed: titles and formats.
SHOWN = {
    "condition": Column("condition", 23, align="<"),
    "name": Column("options", 12, align="<"),
    **{name: Column(name, 8) for name in ("scans", "failed")},
    **{
        name: Column(title, 8, form)
        for name, title, form in (
            ("normals_right", "normals", ".2%"),
            ("closed", "closed", ".1%"),
            ("euler_right", "Euler", ".1%"),
            ("distance_mean", "distance", ".3%"),
            ("distance_hausdorff", "Hausd.", ".2%"),
            ("log_error_median", "log err", ".3f"),
            ("log_error_mean", "(mean)", ".3f"),
        )
    },
    **{
        f"{measure}{kind}": Column(f"{title}{shown}", 8, ".3f")
        for kind, title in (
            *(("", ""), ("_relative", "rel. "), ("_pca", "pca "), ("_within", "w-c ")),
            ("_sized", "size "),
        )
        for measure, shown in (("nn", "NN"), ("map", "mAP"))
    },
    "seconds": Column("time/s", 8, ".2f"),
    "peak_mib": Column("MiB", 8, ".0f"),
}
TABLE = Table(*SHOWN.values())


def append(path: Path, row: Row) -> None:
    """Append a row to a CSV file. If the file does not exist, the header is written first."""
    before = path.read_bytes() if path.exists() else b""
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    if not before:
        writer.writeheader()
    writer.writerow(row)
    write_file(path, before + text.getvalue().encode())


def retrieval(
    known: Signatures,
    items: Sequence[Item],
    rows: Sequence[int],
    options: PipelineOptions,
) -> dict[str, float]:
    """Nearest-neighbour score and mean average precision (mAP) of the items of a set, in several ways."""
    labels = [item.label for item in items]
    failed = {f"failed {k}": labels[k] for k in set(range(len(items))).difference(rows)}
    names, classes = tuple(items[k].name for k in rows), tuple(labels[k] for k in rows)
    ways: dict[str, tuple[WhiteningKind, FloatArray]] = {
        "": ("none", known.values),
        "_relative": ("none", known.relative),
        "_pca": ("pca", known.longer),
        "_within": ("within-class", known.values),
        "_sized": ("none", known.sized),
    }
    found: dict[str, float] = {}
    for way, (whitening, values) in ways.items():
        found |= {f"nn{way}": NAN, f"map{way}": NAN}
        table = SignatureTable(names, values, kind="scan", labels=classes)
        with contextlib.suppress(InputError):  # too few shapes
            measures = evaluate_table(
                table, RetrievalOptions(whitening=whitening), failed=failed
            )
            found |= {f"nn{way}": measures.nn, f"map{way}": measures.map}
    return found


def relative_spread(
    repeats: list[list[FloatArray]], values: FloatArray, labels: list[str]
) -> float:
    """Spread of the signatures of repeated scans, relative to the distance of the nearest other class.

    repeats: signatures (L,) of the repeated scans of some bodies; values: (n, L), of one scan of each body.
    """
    logs = [coordinates(np.array(own)) for own in repeats if own]  # (r, L) each
    within = [
        d for own in logs for d in np.linalg.norm(own - own.mean(axis=0), axis=1).tolist()
    ]
    everybody, classes = coordinates(values), np.array(labels)
    between = np.linalg.norm(everybody[:, None] - everybody, axis=2)  # (n, n)
    between[classes[:, None] == classes] = np.inf
    return median(within) / median(between.min(axis=1, initial=np.inf).tolist())


def mean(values: Iterable[float]) -> float:
    found = list(values)
    return statistics.fmean(found) if found else NAN


def median(values: Iterable[float]) -> float:
    found = list(values)
    return statistics.median(found) if found else NAN


# Lengths of the signatures that are compared, independent of the configuration: the length in the paper, and
# all values that 61 eigenpairs give, for PCA whitening.
N_VALUES = 23
N_LONGER = 60

# Weight of the size in the signatures that include the size.
SIZE_WEIGHT = PipelineOptions.of("body-scanner").signature.size_weight

# Number of random points on each of two surfaces from which the distance to the other surface is computed.
# Their spacing on a body is about .001 of the diagonal.
N_PROBES = 100_000


class Signatures(NamedTuple):
    """The signatures of one shape, (L,) each, or of many shapes, (n, L) each."""

    values: FloatArray
    relative: FloatArray
    longer: FloatArray
    sized: FloatArray


class Examination(NamedTuple):
    """The result of one scan. Lengths are relative to the diagonal of the clean mesh; the peak is in MiB."""

    signatures: Signatures
    seconds: float
    processor: float
    stages: dict[str, float]
    peak: float
    normals: float | None
    closed: bool
    euler: int
    mean: float
    hausdorff: float


def examine(path: Path, truth: TriangleMesh, options: PipelineOptions) -> Examination:
    """Process one scan, and compare the surface and the normals with the clean mesh."""
    forget_peak()
    started, processor = time.perf_counter(), time.process_time()
    shape = process(path, options)
    describe(shape, options.signature)
    seconds, processor = time.perf_counter() - started, time.process_time() - processor
    peak = peak_memory()
    stages: dict[str, float] = {}
    for step in shape.provenance:
        stages[step.stage] = stages.get(step.stage, 0.0) + step.seconds
    rng = np.random.default_rng(0)
    on_surface, _ = _probes(shape.mesh, rng)
    on_truth, true_normals = _probes(truth, rng)
    distances = [
        RayScene(mesh.vertices, mesh.faces).distance(points) / truth.diagonal
        for mesh, points in ((truth, on_surface), (shape.mesh, on_truth))
    ]
    return Examination(
        signatures=_signatures(shape, options),
        seconds=seconds,
        processor=processor,
        stages=stages,
        peak=peak,
        normals=_right_normals(path, on_truth, true_normals, options),
        closed=not defects(shape.mesh),
        euler=shape.mesh.euler_characteristic,
        mean=float(np.mean([part.mean() for part in distances])),
        hausdorff=float(max(part.max() for part in distances)),
    )


def clean_signatures(mesh: TriangleMesh, options: PipelineOptions) -> Signatures:
    """The signatures of a mesh without reconstruction."""
    return _signatures(process(mesh, options.changed(surface={"mode": "keep"})), options)


def stacked(many: Sequence[Signatures]) -> Signatures:
    """The signatures of many shapes."""
    lengths = (N_VALUES, N_VALUES, N_LONGER, N_VALUES + 1)
    return Signatures(
        *(
            np.array([one[k] for one in many]).reshape(-1, length)
            for k, length in enumerate(lengths)
        )
    )


def _signatures(shape: Shape, options: PipelineOptions) -> Signatures:
    form, relative = {"size_weight": 0}, {"size_weight": 0, "scale": "relative"}
    changes: list[dict[str, Any]] = [form, relative, relative | {"n_values": N_LONGER}]
    changes.append({"size_weight": SIZE_WEIGHT})
    chosen = [options.changed(signature=change).signature for change in changes]
    return Signatures(*(describe(shape, signature).values for signature in chosen))


def _right_normals(
    path: Path, places: FloatArray, normals: FloatArray, options: PipelineOptions
) -> float | None:
    """The share of filtered points whose normal agrees with that of the nearest point of the clean mesh."""
    cloud = read_scan(path)
    if not isinstance(cloud, PointCloud):
        return None
    oriented = oriented_normals(clean(cloud, options.scan)[0], options.scan)
    _, nearest = cKDTree(places).query(oriented.points)
    agreement = np.einsum("ij,ij->i", np.asarray(oriented.normals), normals[nearest])
    return float((agreement > 0).mean())


def _probes(
    mesh: TriangleMesh, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Points of a surface, uniform by area, and the unit normals there: (`N_PROBES`, 3) each."""
    points, faces = uniform_points(mesh, N_PROBES, rng)
    normals = mesh.area_vectors[faces]
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


Answer = TypeVar("Answer")

# Longest time for one scan; seconds. fTetWild with its defaults takes minutes for a fine surface.
TIMEOUT = 900.0


def answers(
    title: str,
    function: Callable[..., Answer],
    arguments: Sequence[tuple[object, ...]],
    *,
    workers: int,
) -> list[Answer | None]:
    """Call a function once for each tuple of arguments, each in a process."""
    found: list[Answer | None] = [None] * len(arguments)
    calls = partial(_called, function)
    running = in_processes(calls, enumerate(arguments), workers=workers, timeout=TIMEOUT)
    with closing(running):
        for (number, given), outcome in progress(running, title, len(arguments)):
            if isinstance(outcome, PcretrieveError):
                place = given[0].name if isinstance(given[0], Path) else "a mesh"
                print(
                    f"{title}: {place}: {type(outcome).__name__}: {outcome}",
                    file=sys.stderr,
                )
            else:
                found[number] = outcome
    return found


def _called(
    function: Callable[..., Answer], numbered: tuple[int, tuple[object, ...]]
) -> Answer:
    return function(*numbered[1])


# Parameters for which the libraries have no default.
OUTLIER_NEIGHBORS, OUTLIER_RATIO, TANGENT_NEIGHBORS, DEPTH, N_PAIRS = 20, 2.0, 30, 8, 61

# Defaults of Open3D: neighbours of a plane, size of the octree's cube relative to the points' bounding cube.
PLANE_NEIGHBORS, CUBE = 30, 1.1

# Defaults of fTetWild: edge length and envelope, relative to the diagonal.
EDGE_LENGTH, ENVELOPE = 0.05, 1e-3


def textbook_seconds(path: Path, timeout: float) -> float:
    """Wall-clock time of a textbook pipeline, from a file of points to 61 eigenpairs.

    Its stages are statistical outlier removal, normals oriented by tangent planes, Poisson reconstruction,
    fTetWild with its defaults, and LaPy on the boundary of the tetrahedra, or `eigenpairs` without LaPy.
    """
    started = time.perf_counter()
    cloud = read_scan(path)
    if not isinstance(cloud, PointCloud):
        raise BenchmarkError(
            f"the textbook pipeline begins with points, got a mesh: {path}"
        )
    framed = open3d_cloud(
        Frame.around(cloud.points, offset=DOUBLE_OFFSET).inward(cloud.points)
    )
    _, kept = framed.remove_statistical_outlier(
        nb_neighbors=OUTLIER_NEIGHBORS, std_ratio=OUTLIER_RATIO
    )
    points = cloud.points[np.sort(np.asarray(kept, dtype=np.int32))]
    normals = estimate_normals(points, n_neighbors=PLANE_NEIGHBORS)
    normals = orient_by_tangent_planes(points, normals, n_neighbors=TANGENT_NEIGHBORS)
    surface = poisson(points, normals, depth=DEPTH, scale=CUBE)
    nodes, tetrahedra = tetwild.tetrahedralize(
        surface.vertices,
        surface.faces,
        edge_length=EDGE_LENGTH,
        envelope=ENVELOPE,
        optimize=True,
        timeout=timeout,
    )
    boundary = compact(nodes, boundary_faces(nodes, tetrahedra))
    if find_spec("lapy") is not None:
        lapy_eigenvalues(boundary.vertices, boundary.faces, N_PAIRS)
    else:
        eigenpairs(laplace_beltrami(boundary), N_PAIRS)
    return time.perf_counter() - started
