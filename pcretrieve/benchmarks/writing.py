"""Times of writing to large catalogues: shapes that are added and removed, and parts that are merged."""

from __future__ import annotations

import statistics
from collections.abc import Collection
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from pcretrieve.benchmarks.synthetic import CLASS_SIZE, synthetic_catalogue
from pcretrieve.benchmarks.timing import timed
from pcretrieve.catalogue import Rows
from pcretrieve.catalogue.rows import OWN, Entry
from pcretrieve.catalogue.settings import settings_of
from pcretrieve.catalogue.stores import open_rows
from pcretrieve.errors import BenchmarkError
from pcretrieve.interface import merge_catalogues
from pcretrieve.options import PipelineOptions

__all__ = ["WritingTimes", "merged_in", "written_in"]

# Number of shapes that are copied to a part together.
COPIED_AT_ONCE = 1000


class WritingTimes(NamedTuple):
    """Median times of changes of a catalogue; seconds.

    Attributes
    ----------
    together : float
        To add shapes in one transaction.
    single : float
        To add them one by one, as an ingest does.
    removal : float
        To remove them.
    """

    together: float
    single: float
    removal: float


def written_in(path: Path, n_shapes: int, n_repeats: int) -> WritingTimes:
    """Add shapes to a catalogue, and remove them, several times.

    Parameters
    ----------
    path : Path
        The catalogue, which is afterwards as it was.
    n_shapes : int
        Number of shapes.
    n_repeats : int
        Number of repetitions.

    Returns
    -------
    WritingTimes
        Median times; seconds.
    """
    times = []
    with closing(open_rows(path, {}, create=False)) as rows:
        stored = rows.entries([record.id for record in rows.page(limit=n_shapes)])
        new = [
            replace(entry, record=replace(entry.record, id=f"new-{at}", path=f"/new/{at}.ply"))
            for at, entry in enumerate(stored)
        ]
        ids = [entry.record.id for entry in new]
        for _ in range(n_repeats):
            together, _ = timed(partial(rows.add, new))
            removal, _ = timed(partial(rows.remove, ids))
            single, _ = timed(partial(_put, rows, new))
            rows.remove(ids)
            times.append((together, single, removal))
    return WritingTimes(*map(statistics.median, zip(*times, strict=True)))


def merged_in(folder: Path, options: PipelineOptions, n_shapes: int, n_parts: int, seed: int) -> float:
    """Merge the catalogues of a job array.

    Parameters
    ----------
    folder : Path
        An empty folder.
    options : PipelineOptions
        Options of the catalogues, as for `synthetic_catalogue`.
    n_shapes : int
        Number of shapes of all parts together.
    n_parts : int
        Number of catalogues.
    seed : int
        Seed of the signatures.

    Returns
    -------
    float
        Wall-clock time; seconds.

    Raises
    ------
    BenchmarkError
        If the shapes cannot be divided into parts.
    """
    if n_shapes % (n_parts * CLASS_SIZE):
        raise BenchmarkError(
            f"the number of merged shapes must be a multiple of {n_parts * CLASS_SIZE}, got {n_shapes}"
        )
    synthetic_catalogue(folder / "whole.sqlite", options, n_shapes, seed)
    parts = [folder / f"part-{number}.sqlite" for number in range(n_parts)]
    with closing(open_rows(folder / "whole.sqlite", {}, create=False)) as rows:
        ids = [origin.id for origin in rows.origins()]
        for number, part in enumerate(parts):
            with closing(open_rows(part, settings_of(options), create=True)) as store:
                chosen = ids[number::n_parts]
                for start in range(0, len(chosen), COPIED_AT_ONCE):
                    store.add(rows.entries(chosen[start : start + COPIED_AT_ONCE]))
    return timed(lambda: merge_catalogues(parts, folder / "all.sqlite"))[0]


def _put(rows: Rows, entries: Collection[Entry]) -> None:
    for entry in entries:
        rows.put(entry.record, entry.signatures[OWN], entry.payloads)
