"""Print how fast pcretrieve is, beside the textbook's chain, LaPy and faiss, in one run.

    .venv/bin/pip install -e '.[benchmark]'
    scripts/benchmark speed

A scan of a simulated person has 40,000 points. The textbook chain is that of benchmarks.fidelity: normals
and Poisson reconstruction by Open3D, fTetWild, and LaPy. What is compared runs by turns, on one thread; times
are medians of wall-clock time. The shapes that are searched are drawn with the covariances within and between
people, and have the default length and whitening; or they are isotropic, as PCA leaves signatures of R-BiHDM.
Memory is that of the largest worker of an ingest.

It takes about ten minutes on two idle cores.
"""

from __future__ import annotations

import os
import statistics
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

import pcretrieve as pr
from benchmarks.batch import ONE_WORKER, TWO_WORKERS, run_of, write_scans
from benchmarks.fidelity import textbook_seconds
from benchmarks.measuring import (
    Column,
    Table,
    argument_parser,
    largest_descendant,
    print_lines,
    run_command,
    timed,
    timed_by_turns,
)
from benchmarks.spectral import N_PAIRS, SIZES, lapy_eigenvalues, our_eigenvalues
from benchmarks.synthetic import (
    bumpy_sphere,
    signatures,
    synthetic_catalogue,
    synthetic_id,
)
from benchmarks.uniform import UniformOptions
from pcretrieve.options import PipelineOptions, RetrievalOptions, SignatureOptions
from pcretrieve.retrieval import SignatureIndex, fit_whitening, people
from pcretrieve.values import FloatArray, SignatureTable

TABLE = Table(
    Column("", 60, align="<"),
    Column("ours", 12),
    Column("theirs", 12),
    Column("ratio", 7, ".2f"),
)

N_ROUNDS, N_SCANS, N_QUERIES, K = 5, 24, 50, 10
N_AGAINST_TEXTBOOK = 3
TIMEOUT = 600.0

# Numbers of shapes of the default length, of isotropic ones, and of those that a command searches.
SEARCHED, ISOTROPIC, STORED = 1_000_000, 300_000, 100_000
LENGTH = 23

# Number of points of a large scan.
LARGE = 5_000_000


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argument_parser(__doc__)
    parser.add_argument(
        "--part", choices=PARTS, action="append", help="only this part; may be repeated"
    )
    given = parser.parse_args(arguments)
    print_lines([TABLE.head])
    with tempfile.TemporaryDirectory() as folder:
        write_scans(Path(folder), N_SCANS)
        for part in given.part or PARTS:
            print_lines(PARTS[part](Path(folder)))


def _row(
    title: str, ours: float, theirs: float, unit: str, *, by_us: bool = False
) -> str:
    """One row; `by_us`: the ratio is ours to theirs."""
    ratio = ours / theirs if by_us else theirs / ours
    return TABLE.row(
        title,
        f"{ours:.3g} {unit}",
        "" if np.isnan(theirs) else f"{theirs:.3g} {unit}",
        ratio,
    )


def _scan(folder: Path) -> Iterator[str]:
    paths = sorted(folder.iterdir())[:N_AGAINST_TEXTBOOK]
    pr.signature(paths[0])  # loads libraries and compiled functions
    ours, theirs = [], []
    with threadpool_limits(1):
        for path in paths:
            seconds = [timed(partial(pr.signature, path))[0] for _ in range(N_ROUNDS)]
            theirs.append(textbook_seconds(path, TIMEOUT))
            ours.append(
                statistics.median(
                    seconds + [timed(partial(pr.signature, path))[0] for _ in seconds]
                )
            )
    medians = statistics.median(ours), statistics.median(theirs)
    yield _row("scan to signature in a batch; the textbook's chain", *medians, "s")


def _command(folder: Path) -> Iterator[str]:
    path = str(sorted(folder.iterdir())[0])
    seconds = [run_command("lab", "signature", path)[0] for _ in range(N_ROUNDS)]
    yield _row("cold command for one scan", statistics.median(seconds), np.nan, "s")


def _pairs(_: Path) -> Iterator[str]:
    for size in SIZES:
        mesh = bumpy_sphere(size)
        solvers = [
            partial(our_eigenvalues, mesh),
            partial(lapy_eigenvalues, mesh.vertices, mesh.faces, N_PAIRS),
        ]
        with threadpool_limits(1):
            ours, theirs = (
                statistics.median(times) for times, _ in timed_by_turns(solvers, 3)
            )
        yield _row(f"{N_PAIRS} eigenpairs, {size:,} vertices; LaPy", ours, theirs, "s")


def _search(_: Path) -> Iterator[str]:
    rng = np.random.default_rng(0)
    options = SignatureOptions()
    drawn = np.stack(list(signatures(options, SEARCHED, rng)))
    whitened = fit_whitening(
        "people", drawn[:: SEARCHED // 1000], people=people(options)
    ).apply(drawn)
    yield from _against_faiss(
        f"{K} nearest of {SEARCHED:,} × {drawn.shape[1]}, people", whitened
    )
    isotropic = rng.standard_normal((ISOTROPIC, LENGTH))
    yield from _against_faiss(
        f"{K} nearest of {ISOTROPIC:,} × {LENGTH}, isotropic", isotropic
    )


def _against_faiss(title: str, points: FloatArray) -> Iterator[str]:
    """Rows for the flat scan of faiss and for Panorama, both of which are in single precision."""
    import faiss

    length = points.shape[1]
    rows = np.random.default_rng(1).integers(len(points), size=N_QUERIES)
    table = SignatureTable(
        tuple(map(synthetic_id, range(len(points)))),
        np.exp(points / np.abs(points).max()),
        kind="any",
        digest="",
    )
    index = SignatureIndex(table, RetrievalOptions(whitening="none"))
    index.load()
    single = np.ascontiguousarray(np.log(table.values), np.float32)
    flat, panorama = (
        faiss.IndexFlatL2(length),
        faiss.IndexFlatL2Panorama(length, min(8, length), 512),
    )
    faiss.omp_set_num_threads(1)
    flat.add(single)
    panorama.add(single)
    searches: dict[str, Callable[[int], object]] = {
        "ours": lambda row: index.nearest(synthetic_id(row), K),
        "flat": lambda row: flat.search(single[row : row + 1], K),
        "Panorama": lambda row: panorama.search(single[row : row + 1], K),
    }
    times: dict[str, list[float]] = {name: [] for name in searches}
    with threadpool_limits(1):
        for row in rows.tolist():
            for name, search in searches.items():
                times[name].append(timed(partial(search, row))[0] * 1e3)
    ours = statistics.median(times.pop("ours"))
    for name, theirs in times.items():
        yield _row(
            f"{title}; faiss {name}", ours, statistics.median(theirs), "ms", by_us=True
        )


def _query(folder: Path) -> Iterator[str]:
    catalogue = folder.with_suffix(".sqlite")
    synthetic_catalogue(catalogue, PipelineOptions(), STORED, 0)
    command = ("query", "--catalogue", str(catalogue), synthetic_id(0))
    run_command(*command)  # makes the index, which is kept
    seconds = [run_command(*command)[0] for _ in range(N_ROUNDS)]
    catalogue.unlink()
    yield _row(
        f"query of a stored id among {STORED:,}, whole command",
        statistics.median(seconds),
        np.nan,
        "s",
    )


def _batch(folder: Path) -> Iterator[str]:
    with _watched() as sizes:
        one, two = (run_of(name, folder).rate for name in (ONE_WORKER, TWO_WORKERS))
    yield TABLE.row(
        "scans/s by two workers; by one", f"{two:.3g} /s", f"{one:.3g} /s", two / one
    )
    middle = max(sizes[: len(sizes) // 2])
    yield TABLE.row(
        "largest worker, whole run; its first half",
        f"{max(sizes):.0f} MiB",
        f"{middle:.0f} MiB",
        1.0,
    )


def _large(_: Path) -> Iterator[str]:
    with tempfile.TemporaryDirectory() as folder:
        write_scans(Path(folder), 2, UniformOptions(n_points=LARGE, outlier_share=0.0))
        with _watched() as sizes:
            rate = run_of(ONE_WORKER, Path(folder)).rate
    title = f"a scan of {LARGE:,} points in a batch; memory of the worker"
    yield TABLE.row(title, f"{1 / rate:.3g} s", f"{max(sizes):.0f} MiB", np.nan)


@contextmanager
def _watched() -> Iterator[list[float]]:
    """The resident memory of the largest worker, ten times a second; MiB."""
    sizes: list[float] = []
    finished = threading.Event()

    def watch() -> None:
        while not finished.wait(0.1):
            sizes.append(largest_descendant(os.getpid()))

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield sizes
    finally:
        finished.set()
        watcher.join()


PARTS: dict[str, Callable[[Path], Iterator[str]]] = {
    "scan": _scan,
    "command": _command,
    "pairs": _pairs,
    "search": _search,
    "query": _query,
    "batch": _batch,
    "large": _large,
}
