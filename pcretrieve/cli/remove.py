"""The command that forgets shapes: remove."""

from __future__ import annotations

from pathlib import Path

import click

from pcretrieve.cli.parts import (
    catalogue_option,
    say,
)

__all__ = ["remove_command"]


@click.command("remove")
@click.argument("shape_ids", nargs=-1, required=True, metavar="ID...")
@catalogue_option
def remove_command(shape_ids: tuple[str, ...], catalogue: Path) -> None:
    """Forget shapes; their files are left alone.

    \b
    pcretrieve remove cat0 cat1 --catalogue bodies.sqlite
    """
    from pcretrieve.catalogue import Catalogue

    chosen = dict.fromkeys(shape_ids)
    with Catalogue(catalogue) as store:
        store.remove(*chosen)
    say(f"removed {len(chosen)} from {catalogue}")
