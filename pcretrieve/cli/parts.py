"""Options that several commands have, and exit codes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pcretrieve.cli.commands import option
from pcretrieve.cli.completion import CATALOGUE_VARIABLE, complete_presets
from pcretrieve.names import UPWARD

if TYPE_CHECKING:
    from pcretrieve.options import PipelineOptions

__all__ = [
    "CATALOGUE",
    "EXIT_INTERRUPTED",
    "EXIT_SOME_FAILED",
    "catalogue_argument",
    "catalogue_option",
    "config_option",
    "json_option",
    "labels_option",
    "limit_options",
    "load_options",
    "surface_option",
    "unit_option",
    "up_option",
]

EXIT_SOME_FAILED = 3
EXIT_INTERRUPTED = 130

#: The type of an option that names a catalogue: a string, because a path would lose a slash of a URL.
CATALOGUE = click.Path()
up_option = option(
    "--up",
    type=click.Choice(UPWARD),
    rare=True,
    help="The axis of the files that points upwards on pictures; by default found for each shape.",
)
#: Of commands whose only argument is a catalogue.
catalogue_argument = click.argument("catalogue", type=CATALOGUE, envvar=CATALOGUE_VARIABLE)
catalogue_option = click.option(
    "--catalogue",
    "-c",
    type=CATALOGUE,
    required=True,
    envvar=CATALOGUE_VARIABLE,
    show_envvar=True,
    metavar="FILE|URL",
    help="The catalogue.",
)
#: A string, because the layouts of published sets have names.
labels_option = option(
    "--labels",
    metavar="CSV|LAYOUT",
    help="Classes in place of the stored ones, as for `ingest`.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
config_option = option(
    "--config",
    type=click.Path(path_type=Path),
    metavar="TOML|PRESET",
    shell_complete=complete_presets,
    help="Options as by `pcretrieve options`, or body-scanner, handheld, depth-camera, clean-mesh, paper, "
    "classic.",
)
surface_option = option(
    "--surface",
    type=click.Choice(["auto", "reconstruct", "keep"]),
    metavar="WHICH",
    help="Meshes to rebuild: auto (open ones), reconstruct (all), keep (none).",
    details="auto, the default, reconstructs meshes that are not closed manifolds.",
)
unit_option = option(
    "--unit",
    type=click.Choice(["um", "mm", "cm", "dm", "m", "km", "in", "ft"]),
    metavar="UNIT",
    help="Unit of files without one: um mm cm dm m km in ft.",
    details="All scans are converted to metres.",
)


def limit_options(unit: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Options that limit time and memory of the processes in which a command works."""
    timeout = option(
        "--timeout",
        type=click.FloatRange(min=1),
        metavar="SECONDS",
        rare=True,
        default=600,
        show_default=True,
        help=f"Longest time for a {unit}.",
    )
    memory = option(
        "--memory",
        type=click.FloatRange(min=0.5),
        metavar="GIB",
        rare=True,
        help="Largest heap of a worker process.",
    )
    return lambda command: timeout(memory(command))


def load_options(
    config: Path | None, surface: str | None = None, *, base: PipelineOptions | None = None
) -> PipelineOptions:
    """The options of a command with ``--config`` and ``--surface``."""
    from pcretrieve.options import PipelineOptions

    options = base or PipelineOptions()
    if config is not None:
        options = PipelineOptions.named(config, options)
    return options if surface is None else options.changed(surface={"mode": surface})
