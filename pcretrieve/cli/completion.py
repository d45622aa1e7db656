"""What a shell completes: presets, names of records, and the ids and classes of a catalogue."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import TYPE_CHECKING

import click
from click.shell_completion import CompletionItem

if TYPE_CHECKING:
    from pcretrieve.catalogue.rows import Origin

__all__ = ["CATALOGUE_VARIABLE", "complete_ids", "complete_labels", "complete_presets", "complete_queries"]

#: The environment variable that names the catalogue of commands without ``--catalogue``.
CATALOGUE_VARIABLE = "PCRETRIEVE_CATALOGUE"

FILTER = "label="


def complete_presets(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """The presets that begin with what is typed, and files."""
    from pcretrieve.options import PRESETS

    return _items(PRESETS, incomplete) or [CompletionItem(incomplete, type="file")]


def complete_ids(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """The ids that begin with what is typed, of the catalogue of the command."""
    return _items((origin.id for origin in _origins(context)), incomplete)


def complete_queries(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """The ids that begin with what is typed; if there are none, files."""
    return complete_ids(context, parameter, incomplete) or [CompletionItem(incomplete, type="file")]


def complete_labels(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """The conditions ``label=CLASS`` that begin with what is typed."""
    labels = {origin.label for origin in _origins(context) if origin.label}
    return _items((FILTER + label for label in sorted(labels)), incomplete)


def _items(names: Iterable[str], incomplete: str) -> list[CompletionItem]:
    # Without control characters, of which the shell would make further lines.
    return [CompletionItem(name) for name in names if name.startswith(incomplete) and name.isprintable()]


def _origins(context: click.Context) -> list[Origin]:
    """The shapes of the catalogue of a command; none, if it cannot be read."""
    from pcretrieve.catalogue import stored_shapes
    from pcretrieve.errors import PcretrieveError

    location = context.params.get("catalogue") or os.environ.get(CATALOGUE_VARIABLE)
    if not location:
        return []
    try:
        with stored_shapes(location) as store:
            return store.origins()
    except (PcretrieveError, OSError):
        return []
