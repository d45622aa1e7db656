"""Rates of an ingest: in one process, isolated, with two workers, and by a Dask cluster of this computer.

    scripts/benchmark batch

Scans of simulated people are ingested by each executor in turn, several rounds, so that other load on the
machine slows all alike. A rate is that of the scans after the first outcome: the time until then, in which
processes start, has a column of its own. Ratios are medians over the rounds.

Needs two idle cores. About 10 minutes on two cores of a 2.5 GHz Xeon.
"""

from __future__ import annotations

import multiprocessing
import statistics
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple, TypeVar

import numpy as np

from benchmarks.measuring import (
    Column,
    Table,
    argument_parser,
    positive,
    print_lines,
    use_one_core,
)
from benchmarks.poses import POSES
from benchmarks.simulation import body, make_subject, write_ply
from benchmarks.uniform import UniformOptions, scan_uniformly
from pcretrieve import ingest
from pcretrieve.errors import BenchmarkError
from pcretrieve.ingestion.cluster import DaskExecutor
from pcretrieve.ingestion.pool import Executor, in_processes

__all__ = ["EXECUTORS", "Run", "main", "run_of"]

Item = TypeVar("Item")
Answer = TypeVar("Answer")

TABLE = Table(
    Column("executor", 44, align="<"),
    Column("scans/s", 8, ".3f"),
    Column("first outcome, s", 17, ".1f"),
)

# Number of points of a scan.
N_POINTS = 40_000
USUAL = UniformOptions(n_points=N_POINTS)

ONE_PROCESS = "in one process, without isolation"
ONE_WORKER = "processes, one worker"
TWO_WORKERS = "processes, two workers"
DASK = "Dask cluster of this computer, two workers"
EXECUTORS = (ONE_PROCESS, ONE_WORKER, TWO_WORKERS, DASK)


class Run(NamedTuple):
    """How fast one ingest was.

    first: time until the first outcome; seconds.
    """

    rate: float
    first: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the rates and their ratios."""
    parser = argument_parser(__doc__)
    parser.add_argument(
        "--scans",
        type=positive,
        default=40,
        help="number of scans (default: %(default)s)",
    )
    parser.add_argument(
        "--rounds",
        type=positive,
        default=3,
        help="ingests by each (default: %(default)s)",
    )
    given = parser.parse_args(arguments)
    if given.scans < 4:
        parser.error(f"--scans must be at least 4, got {given.scans}")
    print_lines(_lines(given.scans, given.rounds))


def _lines(n_scans: int, n_rounds: int) -> Iterator[str]:
    yield TABLE.head
    with TemporaryDirectory() as folder:
        scans = Path(folder) / "scans"
        scans.mkdir()
        write_scans(scans, n_scans)
        rounds: list[dict[str, Run]] = []
        for number in range(n_rounds):
            # Every other round in reverse order, because the speed of a machine may drift.
            names = EXECUTORS if number % 2 == 0 else EXECUTORS[::-1]
            rounds.append({name: run_of(name, scans) for name in names})
    for name in EXECUTORS:
        runs = [found[name] for found in rounds]
        rate, first = (statistics.median(values) for values in zip(*runs, strict=True))
        yield TABLE.row(name, rate, first)
    for title, over, under in (
        ("one worker / without isolation", ONE_WORKER, ONE_PROCESS),
        ("two workers / one worker", TWO_WORKERS, ONE_WORKER),
        ("Dask / two workers", DASK, TWO_WORKERS),
    ):
        ratios = sorted(found[over].rate / found[under].rate for found in rounds)
        yield f"{title}: {statistics.median(ratios):.3f} (from {ratios[0]:.3f} to {ratios[-1]:.3f})"


def write_scans(folder: Path, n_scans: int, options: UniformOptions = USUAL) -> None:
    poses = list(POSES["person"].values())
    for number in range(n_scans):
        rng = np.random.default_rng(number)
        person = body(make_subject("person", rng), poses[number % len(poses)], rng)
        cloud = scan_uniformly(person, options, rng)
        write_ply(folder / f"person-{number:03}.ply", cloud.points)


def run_of(name: str, scans: Path) -> Run:
    """Ingest scans in a process that has loaded nothing yet, as the command line does."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_run, name, scans).result()


def _run(name: str, scans: Path) -> Run:
    if name == ONE_PROCESS:
        use_one_core()  # as a worker, whose libraries have one thread each
    executors: dict[str, Executor] = {ONE_PROCESS: _in_this_process}
    ends: list[float] = []
    started = time.perf_counter()
    with TemporaryDirectory() as folder, ExitStack() as stack:
        if name == DASK:
            from distributed import LocalCluster

            limits = {
                "threads_per_worker": 1,
                "memory_limit": 0,
                "dashboard_address": None,
            }
            cluster = stack.enter_context(LocalCluster(n_workers=2, **limits))
            executors[DASK] = DaskExecutor(scheduler=cluster.scheduler_address)
        summary = ingest(
            scans,
            Path(folder) / "catalogue.sqlite",
            workers=2 if name in (TWO_WORKERS, DASK) else 1,
            executor=executors.get(name, in_processes),
            on_shape=lambda record: ends.append(time.perf_counter()),
        )
    if summary.failed:
        raise BenchmarkError(
            f"all simulated scans must be ingested, {len(summary.failed)} failed"
        )
    return Run((len(ends) - 1) / (ends[-1] - ends[0]), ends[0] - started)


def _in_this_process(
    function: Callable[[Item], Answer],
    items: Iterable[Item],
    /,
    *,
    workers: int | None,
    timeout: float,
    memory: float | None,
) -> Generator[tuple[Item, Answer], None, None]:
    """An executor without limits and without isolation, for comparison."""
    for item in items:
        yield item, function(item)
