"""Print times, memory and disk space of large catalogues, and the rate at which small meshes are ingested.

    scripts/benchmark catalogue

Catalogues of 100,000 and of a million shapes are made in a temporary folder from the seed 0: records and
signatures of 45 values, by `r-bihdm`, but neither spectra nor meshes. Queries ask for ten shapes; those of
the command line are PCA whitened. Queries of an index alternate with flat scans of faiss, which are in single
precision, if faiss is installed (the extra `benchmark`), and among 100,000 shapes with the BallTree of
scikit-learn. Times are processor times, which other load changes less than wall-clock times.

Ten parts of a job array, each a tenth of `--merged` shapes, are merged into one catalogue. With the option
`--postgresql URL`, small meshes are ingested into a new schema of that database too, which stays there.

The temporary folder needs 3.5 GB (`TMPDIR` names its parent). About 12 minutes on two cores of a 2.5 GHz
Xeon, of which 5 are the ingestion; `--shapes 100000 --meshes 200` takes one.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from uuid import uuid4

import numpy as np
from sklearn.neighbors import BallTree

from benchmarks.measuring import (
    MIB,
    Column,
    Table,
    argument_parser,
    positive,
    print_lines,
    run_command,
    timed,
    timed_by_turns,
)
from benchmarks.simulation import write_ply
from benchmarks.synthetic import (
    CLASS_SIZE,
    bumpy_sphere,
    merged_in,
    synthetic_catalogue,
    synthetic_id,
    write_small_meshes,
    written_in,
)
from benchmarks.uniform import UniformOptions, scan_uniformly
from pcretrieve import status
from pcretrieve.catalogue import Catalogue
from pcretrieve.errors import PcretrieveError
from pcretrieve.gallery import fitted
from pcretrieve.gallery.fitted import signatures
from pcretrieve.options import PipelineOptions
from pcretrieve.retrieval import DISTANCES, SignatureIndex
from pcretrieve.values import FloatArray, Neighbors

__all__ = ["main"]

TABLE = Table(Column("figure", 58, align="<"), Column("measured", 8, align="<"))

# A tree of more shapes takes minutes to build.
MOST_IN_TREE = 100_000

OPTIONS = PipelineOptions().changed(signature={"method": "r-bihdm", "n_values": 45})
WHITENED = ("--whitening", "pca")
SEED = 0
K = 10
N_REPEATS = 5
N_QUERIES = 100
N_BATCH = 1000

# Number of queries before the first that is measured; an index answers the first ten without compiled code.
N_WARM = 12

WHITENINGS_OF_QUERIES = ("none", "pca", "within-class")

# Number of answers that are compared with those of brute force.
N_COMPARED = 5

# Number of shapes that are added to a large catalogue, how often, and number of catalogues that are merged.
N_ADDED = 1000
N_WRITTEN = 3
N_PARTS = 10

N_VERTICES = 252
N_WORKERS = 2

# Number of vertices of the body whose surfaces are stored, for the size of what is stored.
N_SCANNED = 2000


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argument_parser(__doc__)
    parser.add_argument(
        "--shapes",
        type=positive,
        nargs="*",
        default=[100_000, 1_000_000],
        help="sizes of the catalogues",
    )
    parser.add_argument(
        "--meshes", type=int, default=5000, help="meshes that are ingested; 0 for none"
    )
    parser.add_argument(
        "--merged", type=int, default=100_000, help="shapes that are merged; 0 for none"
    )
    parser.add_argument(
        "--postgresql",
        metavar="URL",
        help="a database into which the meshes are ingested too",
    )
    given = parser.parse_args(arguments)
    if wrong := [n for n in given.shapes if n % CLASS_SIZE]:
        parser.error(f"--shapes must be multiples of {CLASS_SIZE}, got {wrong[0]}")
    try:
        print_lines(_lines(given.shapes, given.merged, given.meshes, given.postgresql))
    except PcretrieveError as error:
        sys.exit(str(error))


def _lines(
    sizes: Sequence[int], n_merged: int, n_meshes: int, database: str | None
) -> Iterator[str]:
    yield TABLE.head
    for n_shapes in sizes:
        yield f"{n_shapes:,} shapes"
        with tempfile.TemporaryDirectory() as folder:
            # The index is stored in the cache of the user, where nobody would need it again.
            os.environ["XDG_CACHE_HOME"] = folder
            yield from _catalogue(Path(folder) / "large.sqlite", n_shapes)
    if n_merged:
        with tempfile.TemporaryDirectory() as folder:
            seconds = merged_in(Path(folder), OPTIONS, n_merged, N_PARTS, SEED)
            yield TABLE.row(
                f"{N_PARTS} parts of {n_merged // N_PARTS:,} shapes merged",
                f"{seconds:.1f} s",
            )
    if n_meshes:
        yield f"{n_meshes:,} meshes of {N_VERTICES} vertices"
        with tempfile.TemporaryDirectory() as folder:
            yield from _ingestion(Path(folder), n_meshes, database)


def _catalogue(path: Path, n_shapes: int) -> Iterator[str]:
    """Figures of a synthetic catalogue."""
    seconds, _ = timed(partial(synthetic_catalogue, path, OPTIONS, n_shapes, SEED))
    yield TABLE.row("  written", f"{seconds:.0f} s, {path.stat().st_size / MIB:.0f} MiB")
    ((opening, _),) = timed_by_turns([lambda: Catalogue(path).close()], N_REPEATS)
    yield TABLE.row("  Catalogue(...)", f"{statistics.median(opening) * 1e3:.1f} ms")
    ((looking, _),) = timed_by_turns([lambda: status(path)], N_REPEATS)
    yield TABLE.row("  pcretrieve.status", f"{statistics.median(looking) * 1e3:.0f} ms")
    written = written_in(path, N_ADDED, N_WRITTEN)
    yield TABLE.row(
        f"  {N_ADDED:,} shapes more",
        f"{written.together:.2f} s in one transaction, {written.single:.2f} s one by one; "
        f"removed in {written.removal:.2f} s",
    )
    with Catalogue(path) as catalogue:
        seconds, _ = timed(partial(signatures, catalogue))
    yield TABLE.row(
        "  signatures", f"{seconds:.2f} s, {seconds / n_shapes * 1e6:.1f} µs a shape"
    )
    query = (
        "query",
        synthetic_id(n_shapes // 3),
        "-c",
        str(path),
        "-k",
        str(K),
        *WHITENED,
    )
    seconds, peak = run_command(*query)
    with Catalogue(path) as catalogue:
        assert catalogue.cache.folder is not None
        kept = list(catalogue.cache.folder.rglob("*.npy"))
    arrays = sum(file.stat().st_size for file in kept) / MIB
    yield TABLE.row(
        "  pcretrieve query ID, which makes the index",
        f"{seconds:.1f} s, peak {peak:.0f} MiB, {peak / arrays:.1f} times its arrays of {arrays:.0f} MiB",
    )
    runs = [run_command(*query) for _ in range(N_REPEATS)]
    seconds, peak = statistics.median(s for s, _ in runs), max(p for _, p in runs)
    yield TABLE.row(
        "  pcretrieve query ID, whose index is kept",
        f"median {seconds:.2f} s, peak {peak:.0f} MiB",
    )
    yield TABLE.row(
        "  pcretrieve list, first line", f"{_first_line('list', '-c', str(path)):.2f} s"
    )
    for whitening in WHITENINGS_OF_QUERIES:
        for distance in DISTANCES:
            yield from _queries(path, distance, whitening)


def _queries(path: Path, distance: str, whitening: str) -> Iterator[str]:
    """Times of queries by an index that was kept, and whether brute force agrees."""
    options = OPTIONS.changed(retrieval={"whitening": whitening, "distance": distance})
    with Catalogue(path) as catalogue:
        building, index = timed(partial(fitted.index, catalogue, options=options))
    with Catalogue(path) as catalogue:
        opening, index = timed(partial(fitted.index, catalogue, options=options))
        rows = np.random.default_rng(SEED).integers(len(index), size=N_QUERIES).tolist()
        ids = [synthetic_id(row) for row in rows]
        for shape_id in ids[:N_WARM]:
            # Maps the arrays, and loads what numba has compiled.
            index.nearest(shape_id, K)
        points = index.to_arrays()["gallery"]
        flat_scan = _flat_scan(points)
        tree = (
            BallTree(points)
            if distance == "log" and len(points) <= MOST_IN_TREE
            else None
        )
        own, other, by_tree = [], [], []
        for row, shape_id in zip(rows, ids, strict=True):
            own.append(_thread_seconds(partial(index.nearest, shape_id, K)))
            if flat_scan is not None:
                other.append(_thread_seconds(partial(flat_scan, points[row])))
            if tree is not None:
                by_tree.append(
                    _thread_seconds(partial(tree.query, points[row : row + 1], K))
                )
        equal = sum(_agrees(index, row) for row in rows[:N_COMPARED])
        values = signatures(catalogue, options=options).values[:N_BATCH]
        batch, _ = timed(partial(_answered, index, values))
    median = statistics.median(own)
    faiss = "faiss is not installed"
    if other:
        flat = statistics.median(other)
        faiss = f"flat scan of faiss {flat * 1e3:.1f} ms, ratio {median / flat:.2f}"
    if by_tree:
        faiss += f"; BallTree {statistics.median(by_tree) * 1e3:.1f} ms"
    yield TABLE.row(
        f"  index.nearest, {distance}, whitening {whitening}",
        f"{median * 1e3:.2f} ms; {faiss}; {equal} of {N_COMPARED} as by brute force; "
        f"made in {building:.1f} s, opens in {opening * 1e3:.0f} ms",
    )
    yield TABLE.row(
        f"  index.query, {N_WORKERS} threads",
        f"{len(values) / batch:.0f} queries/s of wall-clock time",
    )


def _answered(index: SignatureIndex, values: FloatArray) -> list[Neighbors]:
    """The answers to several queries, some at a time."""
    with ThreadPoolExecutor(N_WORKERS) as threads:
        return list(threads.map(partial(index.query, k=K), values))


def _thread_seconds(function: Callable[[], object]) -> float:
    """Processor time of this thread in a call of a function."""
    started = time.thread_time()
    function()
    return time.thread_time() - started


def _flat_scan(points: FloatArray) -> Callable[[FloatArray], object] | None:
    """The exact search of faiss in single precision, if it is installed."""
    try:
        import faiss
    except ImportError:
        return None
    flat = faiss.IndexFlatL2(points.shape[1])
    flat.add(np.ascontiguousarray(points, np.float32))
    return lambda point: flat.search(np.asarray(point[np.newaxis], np.float32), K)


def _agrees(index: SignatureIndex, row: int) -> bool:
    """Whether the answer for a shape is that of comparing it with every shape."""
    ((_, distances),) = index.blocks(np.array([row]))
    order = np.argsort(distances[0], kind="stable")[:K]  # ids ascend with the rows
    found = index.nearest(index.ids[row], K)
    return (
        found.ids == tuple(index.ids[at] for at in order)
        and (found.distances == distances[0][order]).all()
    )


def _first_line(*arguments: str) -> float:
    """Seconds until a command prints its first line."""
    started = time.perf_counter()
    command = [sys.executable, "-m", "pcretrieve", *arguments]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as process:
        if process.stdout is not None:
            process.stdout.readline()
        seconds = time.perf_counter() - started
        process.kill()
    return seconds


def _ingestion(folder: Path, n_meshes: int, database: str | None) -> Iterator[str]:
    """Figures of the ingestion of small meshes, and what shapes cost."""
    scans, path = folder / "scans", folder / "small.sqlite"
    scans.mkdir()
    write_small_meshes(scans, n_meshes, N_VERTICES, SEED)
    yield TABLE.row(
        f"  pcretrieve ingest, {N_WORKERS} workers", _rate(scans, str(path), n_meshes)
    )
    if database is not None:
        sign = "&" if "?" in database else "?"
        location = f"{database}{sign}schema=benchmark{uuid4().hex}"
        yield TABLE.row("  the same into PostgreSQL", _rate(scans, location, n_meshes))
    yield _cost(path, "body-00000", "one surface")
    cloud = scan_uniformly(
        bumpy_sphere(N_SCANNED), UniformOptions(), np.random.default_rng(SEED)
    )
    write_ply(folder / "scan.ply", cloud.points)
    run_command("ingest", str(folder / "scan.ply"), "-c", str(path))
    yield _cost(path, "scan", "two surfaces")


def _rate(scans: Path, location: str, n_meshes: int) -> str:
    """The rate of an ingest."""
    before = _processor_seconds()
    seconds, peak = run_command(
        "ingest", str(scans), "-c", location, "--workers", str(N_WORKERS), "--quiet"
    )
    # Unlike the rate, the processor time is hardly slowed by other load on the machine.
    each = (_processor_seconds() - before) / n_meshes
    return (
        f"{seconds:.0f} s, {n_meshes / seconds:.1f} shapes/s, {each * 1e3:.0f} ms of processor time a shape, "
        f"peak {peak:.0f} MiB"
    )


def _processor_seconds() -> float:
    """Processor time of all processes that this one has started and that have ended."""
    times = os.times()
    return times.children_user + times.children_system


def _cost(path: Path, shape_id: str, surfaces: str) -> str:
    """The size of what is stored of a shape."""
    with Catalogue(path) as catalogue:
        stored = catalogue.rows.stored_bytes(shape_id)
    meshes = stored.pop("meshes")
    kilobytes = (
        f"{sum(stored.values()) / 1000:.1f} kB, and {meshes / 1000:.1f} kB of meshes"
    )
    return TABLE.row(f"  stored of a shape of {surfaces}, beside its meshes", kilobytes)
