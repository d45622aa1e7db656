"""Seconds and bytes of starting an ingest again, with and without the stamps of the files."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Callable, Generator, Iterable
from contextlib import closing
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from pcretrieve.benchmarks.memory import MIB
from pcretrieve.errors import PcretrieveError, ShapeError
from pcretrieve.ingestion.stamps import SETTLED
from pcretrieve.interface import ingest
from pcretrieve.simulation import write_ply

__all__ = ["Resumption", "resumed_in"]

Item = TypeVar("Item")
Answer = TypeVar("Answer")


class Resumption(NamedTuple):
    """What one start of an ingest costs that has nothing to process.

    Attributes
    ----------
    seconds : float
        Wall-clock time.
    mebibytes : float
        Bytes that this process has read, the catalogue included; MiB.
    """

    seconds: float
    mebibytes: float


def resumed_in(
    folder: Path, n_scans: int, n_points: int, *, wait: float = SETTLED
) -> tuple[Resumption, Resumption]:
    """Start an ingest again whose scans the catalogue has already.

    Parameters
    ----------
    folder : Path
        An empty folder for the scans, of random points, and the catalogue, which has failures of all of them.
    n_scans : int
        Number of scans.
    n_points : int
        Number of points of each scan.
    wait : float, optional
        Age at which a file may be known by its stamp; seconds. By default that of an ingest.

    Returns
    -------
    by_hashes, by_stamps : Resumption
        Without stamps, so that each file is hashed, and with the stamps of that start.
    """
    scans, catalogue = folder / "scans", folder / "catalogue.sqlite"
    scans.mkdir()
    rng = np.random.default_rng(0)
    for number in range(n_scans):
        write_ply(scans / f"{number:06}.ply", rng.normal(size=(n_points, 3)))
    time.sleep(wait + 1)
    ingest(scans, catalogue, executor=_refused)
    with closing(sqlite3.connect(catalogue)) as connection, connection:
        connection.execute("UPDATE shapes SET stamp = NULL")
    by_hashes, by_stamps = (_resumed(scans, catalogue) for _ in range(2))
    return by_hashes, by_stamps


def _resumed(scans: Path, catalogue: Path) -> Resumption:
    before, started = _bytes_read(), time.perf_counter()
    ingest(scans, catalogue, executor=_refused)
    return Resumption(time.perf_counter() - started, (_bytes_read() - before) / MIB)


def _bytes_read() -> int:
    """The bytes that this process has asked for by system calls, whether from a disk or its cache."""
    lines = Path("/proc/self/io").read_text("utf-8").splitlines()
    return int(dict(line.split(": ") for line in lines)["rchar"])


def _refused(
    function: Callable[[Item], Answer], items: Iterable[Item], /, **limits: float | None
) -> Generator[tuple[Item, Answer | PcretrieveError], None, None]:
    """An executor that processes nothing."""
    for item in items:
        yield item, ShapeError("not processed")
