"""Print how many requests a second the search page of a large catalogue answers, and how long they take.

    scripts/benchmark serve

A catalogue of 100,000 shapes is made in a temporary folder from the seed 0, as by the benchmark catalogue:
records and signatures, but neither spectra nor meshes. `pcretrieve serve` runs in a process of its own, and
50 clients, each with one connection, ask for one page after the other without a pause: for the first page of
the collection, for the same as JSON, and for others; first alone, and then beside `pcretrieve ingest` of
small meshes into the same catalogue, by one worker. Beside an ingest, the map is asked for at the start, so
that it is computed at the same time.

The clients need processor time too, and so do other programs of the computer: compare figures of one run, or
of two versions that run in turn. About 5 minutes on two cores; the temporary folder needs 300 MB.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

import numpy as np

from benchmarks.catalogue import OPTIONS, SEED
from benchmarks.measuring import Column, Table, argument_parser, positive, print_lines
from benchmarks.synthetic import CLASS_SIZE, synthetic_catalogue, write_small_meshes
from pcretrieve.catalogue import Catalogue
from pcretrieve.errors import BenchmarkError, PcretrieveError

__all__ = ["main"]

TABLE = Table(
    Column("asked for", 36, align="<"),
    Column("answers/s", 9, ".1f"),
    Column("median", 8, align=">"),
    Column("p99", 8, align=">"),
    Column("worst", 8, align=">"),
    Column("failed", 6, "d"),
)

# What is asked for: the first page of the collection, the same as JSON, a page in the middle, a class, the
# newest shapes, and a part of a name.
PATHS = (
    "/",
    "/shapes",
    "/?page=800",
    "/shapes?label=class-000100",
    "/shapes?sort=-added",
    "/shapes?q=pe-00999",
)
BESIDE = ("/", "/shapes", "/shapes?q=pe-00999")

N_VERTICES = 252

# Longest time for one answer, and for the first shape of an ingest to be stored; seconds.
PATIENCE = 120.0


class Answered(NamedTuple):
    """Times of the answers to all clients (seconds), the rate of answers, and the number of failures."""

    times: list[float]
    rate: float
    n_failed: int

    @property
    def row(self) -> tuple[object, ...]:
        """The figures of a line."""
        median, late = np.quantile(self.times or [np.nan], [0.5, 0.99])
        shown = [
            f"{1e3 * value:.0f} ms"
            for value in (median, late, max(self.times, default=np.nan))
        ]
        return self.rate, *shown, self.n_failed


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argument_parser(__doc__)
    parser.add_argument(
        "--shapes", type=positive, default=100_000, help="size of the catalogue"
    )
    parser.add_argument("--clients", type=positive, default=50, help="clients at a time")
    parser.add_argument("--seconds", type=positive, default=15, help="time for each line")
    parser.add_argument(
        "--meshes", type=positive, default=4_000, help="meshes to be ingested"
    )
    given = parser.parse_args(arguments)
    if given.shapes % CLASS_SIZE:
        parser.error(f"--shapes must be a multiple of {CLASS_SIZE}, got {given.shapes}")
    try:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            synthetic_catalogue(folder / "large.sqlite", OPTIONS, given.shapes, SEED)
            (folder / "scans").mkdir()
            write_small_meshes(folder / "scans", given.meshes, N_VERTICES, SEED)
            print_lines(_lines(folder, given.clients, given.seconds))
    except PcretrieveError as error:
        sys.exit(str(error))


def _lines(folder: Path, n_clients: int, seconds: float) -> Iterator[str]:
    # Indexes and maps are not put into the cache of the user.
    places = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache")}
    catalogue = folder / "large.sqlite"
    with Catalogue(catalogue) as store:
        n_shapes = len(store)
    with serving(catalogue, places) as address:
        yield f"{n_shapes:,} shapes, {n_clients} clients for {seconds:g} s"
        yield TABLE.head
        for path in PATHS:
            yield TABLE.row(path, *asked(address, path, n_clients, seconds).row)
        with ingesting(folder / "scans", catalogue, places):
            asked(address, "/map", 1, 0)
            for path in BESIDE:
                answered = asked(address, path, n_clients, seconds)
                yield TABLE.row(f"{path}, beside an ingest", *answered.row)
        with Catalogue(catalogue) as store:
            yield f"{len(store) - n_shapes} shapes were added beside {len(BESIDE) * seconds:g} s of answers"


@contextmanager
def serving(catalogue: Path, places: Mapping[str, str]) -> Iterator[str]:
    """Run the server of a catalogue, from when it has printed its address."""
    command = [
        sys.executable,
        "-m",
        "pcretrieve",
        "serve",
        "-c",
        str(catalogue),
        "--port",
        "0",
    ]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=places
    ) as process:
        try:
            address = (
                process.stdout.readline().strip() if process.stdout is not None else ""
            )
            if not address:
                raise BenchmarkError(
                    "pcretrieve serve ended before it has printed its address"
                )
            yield address
        finally:
            process.terminate()


@contextmanager
def ingesting(scans: Path, catalogue: Path, places: Mapping[str, str]) -> Iterator[None]:
    """Run an ingest from when it has stored its first shape, and interrupt it at the end."""
    with Catalogue(catalogue) as store:
        before, started = store.revision(), time.monotonic()
        command = [
            *(
                sys.executable,
                "-m",
                "pcretrieve",
                "ingest",
                str(scans),
                "-c",
                str(catalogue),
            ),
            *("--workers", "1", "--quiet"),
        ]
        quiet = subprocess.DEVNULL
        with subprocess.Popen(command, stdout=quiet, stderr=quiet, env=places) as process:
            try:
                while store.revision() == before:
                    if (
                        process.poll() is not None
                        or time.monotonic() > started + PATIENCE
                    ):
                        raise BenchmarkError("pcretrieve ingest has stored no shape")
                    time.sleep(0.1)
                yield
                if process.poll() is not None:
                    raise BenchmarkError(
                        "the ingest has ended too early: give more --meshes"
                    )
            finally:
                process.terminate()


def asked(address: str, path: str, n_clients: int, seconds: float) -> Answered:
    """Ask for one path by several clients for some time, each at least once."""
    parts = urlsplit(address)
    headers = {"Authorization": f"Bearer {parts.query.partition('=')[2]}"}
    times: list[float] = []
    failures: list[int] = []
    end = time.perf_counter() + seconds

    def ask() -> None:
        connection = HTTPConnection(parts.hostname or "", parts.port, timeout=PATIENCE)
        while True:
            started = time.perf_counter()
            try:
                connection.request("GET", path, headers=headers)
                answer = connection.getresponse()
                answer.read()
                if answer.status == 200:
                    times.append(time.perf_counter() - started)
                else:
                    failures.append(answer.status)
            except (OSError, HTTPException):
                failures.append(0)
                connection.close()
            if time.perf_counter() >= end:
                break
        with suppress(OSError):
            connection.close()

    started = time.perf_counter()
    clients = [threading.Thread(target=ask) for _ in range(n_clients)]
    for client in clients:
        client.start()
    for client in clients:
        client.join()
    return Answered(times, len(times) / (time.perf_counter() - started), len(failures))
