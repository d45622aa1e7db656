"""Catalogues as functions take them: open, or the paths of their files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeAlias

from pcretrieve.catalogue import Catalogue, Record
from pcretrieve.options import PipelineOptions

__all__ = ["CatalogueLike", "opened", "stored_records"]

#: A catalogue, or its path or URL.
CatalogueLike: TypeAlias = "Catalogue | str | Path"


@contextmanager
def opened(
    catalogue: CatalogueLike, options: PipelineOptions | None = None, *, create: bool = False
) -> Iterator[Catalogue]:
    """Open a catalogue that is given by its path, and close it at the end; leave others as they are.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue, or its path or URL.
    options : PipelineOptions, optional
        The options of a new catalogue, and those that an existing one must have.
    create : bool, default False
        Whether a file that does not exist is made.

    Yields
    ------
    Catalogue
        The open catalogue.
    """
    if isinstance(catalogue, Catalogue):
        yield catalogue
    else:
        with Catalogue(catalogue, options, create=create) as store:
            yield store


def stored_records(catalogue: CatalogueLike, options: PipelineOptions | None = None) -> list[Record]:
    """The records of a catalogue; none of a file that does not exist, which is not made.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue, or its path or URL.
    options : PipelineOptions, optional
        The options that an existing catalogue must have.

    Returns
    -------
    list of Record
        The records in ascending order of id.

    Raises
    ------
    CatalogueError
        If the catalogue cannot be opened, or was built with other options.
    """
    if not isinstance(catalogue, Catalogue) and "://" not in str(catalogue) and not Path(catalogue).exists():
        return []
    with opened(catalogue, options) as store:
        return store.records()
