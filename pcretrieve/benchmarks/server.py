"""Print how long a search page takes to answer many queries at a time.

    .venv/bin/python scripts/benchmark_server

A server is started as users start it, with a catalogue of synthetic signatures (see benchmark_catalogue) in a
temporary folder. As many clients as `--parallel` ask for the ten nearest shapes of random shapes, each the
next query when the last is answered. Server time is what the header Server-Timing says: from when a request
was received until its answer begins, so with the time in which it waited for the other queries; the time
of the client includes the waiting for a connection, and the client itself, which runs on the same computer.
Needs the extra `web`. About a minute.
"""

from __future__ import annotations

import json
import os
import random
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from functools import partial
from http.client import HTTPConnection
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

import numpy as np

from pcretrieve.benchmarks.arguments import argument_parser, positive
from pcretrieve.benchmarks.synthetic import CLASS_SIZE, synthetic_catalogue, synthetic_id
from pcretrieve.benchmarks.tables import Column, Table, print_lines
from pcretrieve.errors import BenchmarkError, PcretrieveError
from pcretrieve.options import PipelineOptions

__all__ = ["main"]

TABLE = Table(Column("figure", 44, align="<"), Column("measured", 8, align="<"))

OPTIONS = PipelineOptions().changed(signature={"method": "r-bihdm", "n_values": 45, "scale": "relative"})
SEED = 0
K = 10

# Queries of each client before those that are measured.
N_WARM = 12


class Answered(NamedTuple):
    """One answer: seconds by the clock of the client and of the server, and its bytes."""

    client: float
    server: float
    n_bytes: int


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table.

    Parameters
    ----------
    arguments : sequence of str, optional
        By default the arguments of the command line.
    """
    parser = argument_parser(__doc__)
    parser.add_argument("--shapes", type=positive, default=100_000, help="size of the catalogue")
    parser.add_argument("--parallel", type=positive, default=50, help="number of clients")
    parser.add_argument("--queries", type=positive, default=40, help="number of queries of each client")
    given = parser.parse_args(arguments)
    if given.shapes % CLASS_SIZE:
        parser.error(f"--shapes must be a multiple of {CLASS_SIZE}, got {given.shapes}")
    try:
        print_lines(_lines(given.shapes, given.parallel, given.queries))
    except PcretrieveError as error:
        sys.exit(str(error))


def _lines(n_shapes: int, n_clients: int, n_queries: int) -> Iterator[str]:
    yield TABLE.head
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "large.sqlite"
        synthetic_catalogue(path, OPTIONS, n_shapes, SEED)
        started = time.perf_counter()
        with _serving(path) as (process, address):
            yield TABLE.row(f"{n_shapes:,} shapes, first start", f"{time.perf_counter() - started:.1f} s")
            for n in (1, n_clients):
                yield from _measured(process, address, n_shapes, n, n_queries)
            memory = re.search(r"VmHWM:\s+(\d+) kB", (process / "status").read_text())
            yield TABLE.row("most memory of the server", f"{int(memory[1]) / 1024:.0f} MiB" if memory else "")


def _measured(process: Path, address: str, n_shapes: int, n: int, n_queries: int) -> Iterator[str]:
    _asked_by_all(address, n_shapes, n, N_WARM)
    cpu, started = _processor_seconds(process), time.perf_counter()
    answers = _asked_by_all(address, n_shapes, n, n_queries)
    seconds, cpu = time.perf_counter() - started, _processor_seconds(process) - cpu
    for name, values in (("server", [a.server for a in answers]), ("client", [a.client for a in answers])):
        median, p95, most = np.quantile(values, (0.5, 0.95, 1)) * 1e3
        yield TABLE.row(
            f"{n} at a time, time of the {name}", f"median {median:.0f}, p95 {p95:.0f}, most {most:.0f} ms"
        )
    yield TABLE.row(
        f"{n} at a time",
        f"{len(answers) / seconds:.0f} queries/s; processor {cpu / len(answers) * 1e3:.2f} ms, "
        f"answer {np.mean([a.n_bytes for a in answers]) / 1e3:.1f} kB a query",
    )


@contextmanager
def _serving(path: Path) -> Iterator[tuple[Path, str]]:
    """A server: what Linux says of its process, and the address that it has printed."""
    command = [sys.executable, "-m", "pcretrieve", "serve", "-c", str(path), "--port", "0", "--read-only"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            address = process.stdout.readline().strip() if process.stdout else ""
            if not address:
                raise BenchmarkError("the server did not start")
            yield Path(f"/proc/{process.pid}"), address
        finally:
            process.terminate()


def _processor_seconds(process: Path) -> float:
    """Processor time that a process has used, see proc(5)."""
    fields = (process / "stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _asked_by_all(address: str, n_shapes: int, n_clients: int, n_queries: int) -> list[Answered]:
    ask = partial(_asked, address, n_shapes, n_queries)
    with ThreadPoolExecutor(n_clients) as clients:
        return [answered for each in clients.map(ask, range(n_clients)) for answered in each]


def _asked(address: str, n_shapes: int, n_queries: int, client: int) -> list[Answered]:
    """What one client measures, which keeps its connection as a browser does."""
    parts = urlsplit(address)
    headers = {"Authorization": f"Bearer {parts.query.removeprefix('token=')}"}
    rows = random.Random(client)
    answers = []
    with closing(HTTPConnection(parts.hostname or "", parts.port, timeout=60)) as connection:
        for _ in range(n_queries):
            shape = synthetic_id(rows.randrange(n_shapes))
            started = time.perf_counter()
            connection.request("GET", f"/shapes/{shape}/similar?k={K}", headers=headers)
            answer = connection.getresponse()
            body = answer.read()
            seconds = time.perf_counter() - started
            timing = re.search(r"total;dur=([\d.]+)", answer.headers.get("server-timing", ""))
            if timing is None or len(json.loads(body).get("results", ())) != K:
                raise BenchmarkError(f"the server answered {answer.status}: {body[:500]!r}")
            answers.append(Answered(seconds, float(timing[1]) / 1e3, len(body)))
    return answers
