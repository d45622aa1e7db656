"""Options in words: as TOML with descriptions, and the differences of two sets of options."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from inspect import cleandoc
from typing import Any

from pcretrieve.options.model import Options
from pcretrieve.options.pipeline import PipelineOptions

__all__ = ["describe_options", "options_difference"]

# Keys of TOML that need no quotes.
BARE_KEY = re.compile(r"[\w-]+", re.ASCII)


def options_difference(stored: PipelineOptions, given: PipelineOptions) -> list[str]:
    """The differences of two sets of options, except for those of retrieval and of `merge`.

    Parameters
    ----------
    stored : PipelineOptions
        The options of a catalogue, called "there".
    given : PipelineOptions
        Other options, called "here".

    Returns
    -------
    list of str
        One line for each option, such as ``surface.poisson_depth: 7 there, 8 here``.
    """
    there, here = stored.model_dump(exclude={"retrieval", "merge"}), given.model_dump()
    return [line for table in there for line in _differences(table, there[table], here[table])]


def _differences(table: str, there: dict[str, Any], here: dict[str, Any]) -> Iterator[str]:
    # A table that is in only one of the two sets is that of a filter; the stages then differ too.
    for name in [name for name in there if name in here and there[name] != here[name]]:
        if isinstance(there[name], dict):
            yield from _differences(f"{table}.{name}", there[name], here[name])
        else:
            yield f"{table}.{name}: {there[name]!r} there, {here[name]!r} here"


def describe_options(options: PipelineOptions) -> str:
    """Options as TOML, with the description of each option as a comment, for ``--config``.

    Parameters
    ----------
    options : PipelineOptions
        The options to write.

    Returns
    -------
    str
        A TOML document that `PipelineOptions.from_toml` reads back to equal options.
    """
    tables = [_table(name, getattr(options, name)) for name in type(options).model_fields]
    return "\n".join(line for table in tables for line in table)


def _table(name: str, options: Options) -> Iterator[str]:
    """The lines of one table, and of the tables in it."""
    yield from _comment(options.__doc__)
    yield f"[{name}]"
    for option, info in type(options).model_fields.items():
        yield from _comment(info.description)
        # TOML has no null.
        value = getattr(options, option)
        yield f"# {option} =" if value is None else f"{option} = {json.dumps(value)}"
    yield ""
    for inner, table in (options.model_extra or {}).items():
        key = inner if BARE_KEY.fullmatch(inner) else json.dumps(inner)
        yield from _table(f"{name}.{key}", table)


def _comment(text: str | None) -> list[str]:
    return [f"# {line}".rstrip() for line in cleandoc(text or "").splitlines()]
