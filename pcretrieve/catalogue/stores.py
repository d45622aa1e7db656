"""The protocol that opens stores, and the table of stores.

Another package adds a store by an entry point of the group ``pcretrieve.stores`` that names a callable of the
protocol `OpenStore`. The name of the entry point is the scheme of the URLs that are opened by it, as the
store ``postgresql`` opens ``postgresql://host/database``. Locations without a scheme are SQLite files.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

from pcretrieve.catalogue.postgresql import PostgresqlRows
from pcretrieve.catalogue.rows import Rows
from pcretrieve.catalogue.sqlite import SqliteRows
from pcretrieve.names import NAMES
from pcretrieve.plugins import Registry

__all__ = ["STORES", "OpenStore", "file_of", "open_rows"]

SCHEME = re.compile(r"([a-z][a-z0-9+.-]*)://")


class OpenStore(Protocol):
    """A callable that opens the store at a location."""

    def __call__(self, location: str, settings: Mapping[str, str], *, create: bool) -> Rows:
        """Open a store."""
        ...


def open_rows(location: str | Path, settings: Mapping[str, str], *, create: bool) -> Rows:
    """Open the store at a location."""
    scheme = SCHEME.match(location) if isinstance(location, str) else None
    if scheme is None:
        return SqliteRows(Path(location), settings, create=create)
    return STORES[scheme[1]](str(location), settings, create=create)


def file_of(location: str | Path) -> Path | None:
    """The SQLite file at a location."""
    scheme = SCHEME.match(location) if isinstance(location, str) else None
    if scheme is None:
        return Path(location)
    return Path(str(location).partition("://")[2]) if scheme[1] == "sqlite" else None


def _sqlite(location: str, settings: Mapping[str, str], *, create: bool) -> Rows:
    return SqliteRows(Path(location.partition("://")[2]), settings, create=create)


def _checked(name: str, added: object) -> OpenStore:
    if not callable(added):
        raise TypeError(f"must be a callable of the protocol OpenStore, got {added!r}")
    opened: OpenStore = added
    return opened


STORES: Registry[OpenStore] = Registry(
    NAMES["store"], {"sqlite": _sqlite, "postgresql": PostgresqlRows}, _checked
)
