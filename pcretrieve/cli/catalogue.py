"""The commands about whole catalogues: catalogue merge."""

from __future__ import annotations

from dataclasses import asdict

import click

from pcretrieve.cli.commands import command
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import say
from pcretrieve.cli.parts import CATALOGUE, json_option

__all__ = ["catalogue_command"]


@click.group("catalogue")
def catalogue_command() -> None:
    """Make one catalogue of several.

    \b
    pcretrieve catalogue merge part-*.sqlite -o all.sqlite
    """


@command("merge")
@click.argument("parts", nargs=-1, required=True, type=CATALOGUE, metavar="PART...")
@click.option(
    "--output",
    "-o",
    type=CATALOGUE,
    required=True,
    metavar="FILE|URL",
    help="The catalogue in which the shapes are stored; it may have shapes already.",
)
@json_option
def merge_command(parts: tuple[str, ...], output: str, as_json: bool) -> None:
    """Store the shapes of several catalogues in one.

    PART is a file or a URL, such as the catalogue of a task of a job array (`ingest --shard`). All parts were
    built with the same options. Of a file that several parts have, the first finished shape is kept. A file
    with two contents or two classes, or an id of two files, is a conflict: it is named, and nothing stored.

    \b
    pcretrieve catalogue merge part-*.sqlite -o all.sqlite
    """
    from pcretrieve.interface import merge_catalogues

    merged = merge_catalogues(parts, output)
    say(f"{merged.n_added} stored, {merged.n_held} held already: {output}")
    if as_json:
        write_document(asdict(merged))


catalogue_command.add_command(merge_command)
