"""The JSON documents that commands print: what was asked, by which version, and the result or the error."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from textwrap import indent
from typing import TYPE_CHECKING, Any

import click

from pcretrieve import __version__
from pcretrieve.cli.messages import ESCAPES_IN_JSON, print_text, without_password
from pcretrieve.errors import PcretrieveError

if TYPE_CHECKING:
    from pcretrieve.options import PipelineOptions

__all__ = ["JSON_FLAG", "write_document", "write_documents", "write_error"]

#: The option of commands that print documents.
JSON_FLAG = "--json"

# Whether a document has begun, in the state of a command.
BEGUN = "pcretrieve.document"


def write_document(result: object, *, options: PipelineOptions | None = None) -> None:
    """Print the document of a command, on standard output."""
    print_text(_text(_head(click.get_current_context(), options) | {"result": result}))


def write_documents(results: Iterable[object], *, options: PipelineOptions | None = None) -> None:
    """Print the document of a command whose result is a list, each element as soon as it is computed."""
    context = click.get_current_context()
    for result in results:
        if BEGUN not in context.meta:
            context.meta[BEGUN] = True
            print_text(_text(_head(context, options))[: -len("\n}")] + ',\n  "result": [')
        else:
            print_text(",")
        print_text(indent(_text(result), "    "), nl=False)
    if BEGUN in context.meta:
        print_text("\n  ]\n}")
    else:
        write_document([], options=options)


def write_error(context: click.Context, error: PcretrieveError | click.ClickException, code: int) -> None:
    """Print the document of a command that fails, on standard output."""
    facts = {
        "error": type(error).__name__,
        "stage": error.stage if isinstance(error, PcretrieveError) else None,
        "message": error.message,
        "exit_code": code,
    }
    if BEGUN in context.meta:
        print_text("\n  ]," + _text(facts)[len("{") :])
    else:
        print_text(_text(_head(context, None) | facts))


def _head(context: click.Context, options: PipelineOptions | None) -> dict[str, Any]:
    words = context.command_path.split()
    arguments = {
        _name(parameter): _shown(context.params[parameter.name])
        for parameter in context.command.params
        if parameter.name is not None and context.params.get(parameter.name) is not None
    }
    arguments.pop("json", None)
    return {
        "command": " ".join(words[1:]),
        "version": __version__,
        "arguments": arguments,
        "options": None if options is None else options.model_dump(mode="json"),
    }


def _shown(value: object) -> object:
    return without_password(value) if isinstance(value, str) else value


def _name(parameter: click.Parameter) -> str:
    """The name of an option as it is typed, without hyphens; that of an argument."""
    if isinstance(parameter, click.Option):
        return max(parameter.opts, key=len).lstrip("-").replace("-", "_")
    return str(parameter.name)


def _text(document: object) -> str:
    return json.dumps(document, indent=2, ensure_ascii=False, default=_plain).translate(ESCAPES_IN_JSON)


def _plain(value: object) -> str:
    """The text of a value that JSON does not have, such as a path."""
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"no JSON for {type(value).__name__}")
