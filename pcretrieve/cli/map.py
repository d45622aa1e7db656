"""The command that draws the shapes of a catalogue in the plane: map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from pcretrieve.cli.commands import command
from pcretrieve.cli.comparison import compared, comparison_options
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import shown_path, write_line
from pcretrieve.cli.parts import catalogue_option, json_option, up_option

__all__ = ["map_command"]


@command("map")
@catalogue_option
@click.option(
    "--output",
    "-o",
    type=click.Path(path_type=Path),
    required=True,
    metavar="PNG|HTML",
    help="The picture or the page to write.",
)
@up_option
@comparison_options
@json_option
def map_command(catalogue: str, output: Path, up: str | None, as_json: bool, **comparison: Any) -> None:
    """Draw the shapes of a catalogue in the plane, shapes with similar signatures near each other.

    The default whitening does not use labels. A page (.html) shows the name and a thumbnail of the shape
    under the pointer; a picture (.png) needs matplotlib.

    \b
    pcretrieve map --catalogue bodies.sqlite -o bodies.html
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.interface import draw_map

    with Catalogue(catalogue) as store:
        options = compared(store, **comparison)
        page = draw_map(store, output, options=options, up=up)
    if as_json:
        write_document({"page": str(page)}, options=options)
    else:
        write_line(shown_path(str(page)))
