"""The command that prints all options: options."""

from __future__ import annotations

from pathlib import Path

import click

from pcretrieve.cli.commands import command
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.parts import config_option, json_option, load_options

__all__ = ["options_command"]


@command("options")
@config_option
@json_option
def options_command(config: Path | None, as_json: bool) -> None:
    """Print all options of the pipeline with their units, as TOML for --config.

    \b
    pcretrieve options > mine.toml
    """
    from pcretrieve.options import describe_options

    options = load_options(config)
    if as_json:
        write_document(None, options=options)
    else:
        click.echo(describe_options(options))
