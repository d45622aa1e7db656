"""Catalogues as functions take them: open, or the paths of their files."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from pcretrieve.catalogue import Catalogue, CatalogueLike, Merged, Record, opened
from pcretrieve.errors import InputError
from pcretrieve.options import PipelineOptions

__all__ = ["CatalogueLike", "merge_catalogues", "opened", "stored_records"]


def stored_records(catalogue: CatalogueLike, options: PipelineOptions | None = None) -> list[Record]:
    """The records of a catalogue; none of a file that does not exist, which is not made.

    Returns list of Record: the records in ascending order of id.
    """
    if not isinstance(catalogue, Catalogue) and "://" not in str(catalogue) and not Path(catalogue).exists():
        return []
    with opened(catalogue, options) as store:
        return store.records()


def merge_catalogues(parts: Sequence[CatalogueLike], output: CatalogueLike) -> Merged:
    """Store the shapes of several catalogues in one, such as those of ``ingest(shard=...)``.

    Parameters
    ----------
    parts : sequence of (Catalogue, str or Path)
        The catalogues, all built with the same options.
    output : Catalogue, str or Path
        The catalogue in which the shapes are stored. It is created if it does not exist.

    Returns
    -------
    Merged
        Numbers of shapes that were stored, and of shapes that the catalogue had already.

    Raises
    ------
    InputError
        If there are no parts.
    CatalogueError
        If a part does not exist or was built with other options, or there is a conflict (see
        `Catalogue.merge`). Nothing is then stored.
    """
    if not parts:
        raise InputError("there must be at least one catalogue to merge, got none: name the parts")
    with ExitStack() as stack:
        opened_parts = [stack.enter_context(opened(part)) for part in parts]
        target = stack.enter_context(opened(output, opened_parts[0].options, create=True))
        return target.merge(opened_parts)
