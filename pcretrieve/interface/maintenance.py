"""Care for catalogues: is one whole, and a copy of it."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from pcretrieve.catalogue import Catalogue, Defect, Record
from pcretrieve.catalogue.backups import write_backup
from pcretrieve.errors import CatalogueError
from pcretrieve.ingestion.recomputing import recomputed
from pcretrieve.interface.catalogues import CatalogueLike, opened

__all__ = ["Check", "backup", "check"]


@dataclass(frozen=True, slots=True)
class Check:
    """The result of a check of a catalogue."""

    n_shapes: int
    n_failed: int
    n_recomputed: int
    defects: tuple[Defect, ...]

    @property
    def is_whole(self) -> bool:
        """Whether there are no defects, or all of them were repaired."""
        return all(defect.repair is not None for defect in self.defects)


def check(
    catalogue: CatalogueLike,
    *,
    sample: int = 10,
    repair: bool = False,
    timeout: float = 600.0,
    seed: int | None = None,
    on_shapes: Callable[[int], None] = lambda number: None,
) -> Check:
    """Check whether a catalogue is whole.

    The check reads everything: pages and SQL indexes of an SQLite file; rows of no shape; of each shape,
    whether its record can be read and agrees with its arrays, and whether all arrays and signatures are there
    with the right checksums; and the stored indexes. Signatures of a sample are computed again, from the
    stored surfaces or from files that are unchanged.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue.
    sample : int, default 10
        Number of signatures that are computed again.
    repair : bool, default False
        Remove rows of no shape and damaged indexes, make SQL indexes again, and replace damaged shapes by
        failures in the stage ``check``, whose files the next ingest, or `retry`, processes again.
    timeout : float, default 600
        Longest time to compute a signature again; seconds.
    seed : int, optional
        Seed of the sample; by default another sample in each call.
    on_shapes : function of int, optional
        Called with the number of shapes that have been checked, now and then.

    Returns
    -------
    Check
        The defects, and which of them were repaired.

    Raises
    ------
    CatalogueError
        If the catalogue cannot be opened, or cannot be written to for repairs.
    """
    with opened(catalogue) as store:
        defects = store.defects(repair=repair, on_shapes=on_shapes)
        is_broken = any(defect.kind == "database" and defect.repair is None for defect in defects)
        # A list, because repairs change the order of the finished shapes.
        chosen = [] if is_broken else list(_sample(store, sample, seed))
        n_recomputed = 0
        for record, fault in recomputed(store, chosen, timeout=timeout):
            n_recomputed += 1
            if fault is not None:
                done = store.give_up(record.id, fault) if repair else None
                defects.append(Defect("signature", record.id, fault, done))
        n_failed = sum(store.failures().values())
        return Check(len(store), n_failed, n_recomputed, tuple(defects))


def backup(catalogue: CatalogueLike, file: str | Path) -> int:
    """Write a copy of a catalogue to one SQLite file, while others may read and write the catalogue.

    The copy of a file is one state of it. That of a database has each shape as a whole; shapes that are
    stored meanwhile may be missing. Indexes are not copied: they are made again when they are needed.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue. Its schema and its options may be those of an earlier version.
    file : str or Path
        The file, which must not exist. It has its name when it is complete, and is a catalogue.

    Returns
    -------
    int
        The size of the file; bytes.

    Raises
    ------
    CatalogueError
        If the catalogue cannot be read, or the file exists or cannot be written.
    """
    return write_backup(catalogue.location if isinstance(catalogue, Catalogue) else catalogue, Path(file))


def _sample(store: Catalogue, number: int, seed: int | None) -> Iterator[Record]:
    """Some finished shapes, without those whose records are damaged."""
    n_shapes = len(store)
    for offset in sorted(random.Random(seed).sample(range(n_shapes), min(number, n_shapes))):
        try:
            for page in store.pages(status="done", offset=offset, limit=1):
                yield from page
        except CatalogueError:
            continue
