"""Catalogues as functions take them: open, or the paths of their files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeAlias

from pcretrieve.catalogue.store import Catalogue
from pcretrieve.options import PipelineOptions

__all__ = ["CatalogueLike", "opened"]

#: A catalogue, or its path or URL.
CatalogueLike: TypeAlias = "Catalogue | str | Path"


@contextmanager
def opened(
    catalogue: CatalogueLike, options: PipelineOptions | None = None, *, create: bool = False
) -> Iterator[Catalogue]:
    """Open a catalogue that is given by its path, and close it at the end; leave others as they are."""
    if isinstance(catalogue, Catalogue):
        yield catalogue
    else:
        with Catalogue(catalogue, options, create=create) as store:
            yield store
