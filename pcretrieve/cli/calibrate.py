"""The command that fits a whitening to labelled scans, for other catalogues: calibrate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from pcretrieve.cli.commands import command
from pcretrieve.cli.comparison import compared, comparison_options
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import say
from pcretrieve.cli.parts import catalogue_option, json_option

__all__ = ["calibrate_command"]


@command("calibrate")
@catalogue_option
@click.option(
    "--output",
    "-o",
    type=click.Path(path_type=Path),
    required=True,
    metavar="FILE",
    help="The file to write, such as metric.npz.",
)
@comparison_options
@json_option
def calibrate_command(catalogue: str, output: Path, as_json: bool, **comparison: Any) -> None:
    """Learn from labelled scans what to ignore, for other catalogues.

    Scan some bodies several times as they will be scanned later, such as three people in ten poses. The
    variation within these classes is what `--whitening FILE` of query, evaluate and report ignores in other
    catalogues, which must be built with the same options, and needs no labels there.

    \b
    pcretrieve ingest three_people/ --labels people.csv --catalogue three.sqlite
    pcretrieve calibrate --catalogue three.sqlite -o metric.npz
    pcretrieve query --catalogue bodies.sqlite new_scan.ply --whitening metric.npz
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.evaluation import calibrate

    with Catalogue(catalogue) as store:
        options = compared(store, **comparison)
        whitening = calibrate(store, output, options)
    say(f"{output}: {whitening.reason}")
    if as_json:
        write_document({"whitening": str(output), "reason": whitening.reason}, options=options)
