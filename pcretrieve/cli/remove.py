"""The command that removes shapes from a catalogue: remove."""

from __future__ import annotations

import click

from pcretrieve.cli.commands import command
from pcretrieve.cli.completion import complete_ids
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import say
from pcretrieve.cli.parts import catalogue_option, json_option

__all__ = ["remove_command"]


@command("remove")
@click.argument("shape_ids", nargs=-1, required=True, metavar="ID...", shell_complete=complete_ids)
@catalogue_option
@json_option
def remove_command(shape_ids: tuple[str, ...], catalogue: str, as_json: bool) -> None:
    """Remove shapes from a catalogue; the files of the scans are not changed.

    \b
    pcretrieve remove cat0 cat1 --catalogue bodies.sqlite
    """
    from pcretrieve.catalogue import Catalogue

    chosen = dict.fromkeys(shape_ids)
    with Catalogue(catalogue) as store:
        store.remove(*chosen)
    say(f"removed {len(chosen)} from {catalogue}")
    if as_json:
        write_document({"removed": [*chosen]})
