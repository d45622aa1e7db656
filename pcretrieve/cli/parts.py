"""What several commands share: options, and ways to say things."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from textwrap import indent
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from pcretrieve.catalogue import Catalogue, Record
    from pcretrieve.matching import DistanceMatrix
    from pcretrieve.options import PipelineOptions
    from pcretrieve.types import Step

__all__ = [
    "RecordName",
    "catalogue_option",
    "compared",
    "comparison_options",
    "config_option",
    "failure_line",
    "given_flags",
    "json_option",
    "limit_options",
    "load_options",
    "matrix_option",
    "method_option",
    "n_values_option",
    "read_distances",
    "say",
    "scale_option",
    "size_weight_option",
    "step_lines",
    "surface_option",
    "write_json",
    "write_json_list",
]

EXIT_SOME_FAILED = 3
EXIT_INTERRUPTED = 130

# Bodies whose areas differ by more than this may be in different units: from a mouse to a horse it is less,
# from centimetres to metres more.
MIXED_UNITS = 3000

catalogue_option = click.option(
    "--catalogue", "-c", type=click.Path(path_type=Path), required=True, metavar="FILE", help="The catalogue."
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
config_option = click.option(
    "--config",
    type=click.Path(path_type=Path),
    metavar="TOML|PRESET",
    help="Pipeline options: a file such as `pcretrieve options` prints, or one of body-scanner, handheld, "
    "depth-camera, clean-mesh.",
)
surface_option = click.option(
    "--surface",
    type=click.Choice(["auto", "reconstruct", "keep"]),
    help="What to do with meshes: keep closed manifold ones and reconstruct others (auto, the default), "
    "reconstruct all, or keep all.",
)
matrix_option = click.option(
    "--matrix",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Rank by the distances in a file, such as `pcretrieve matrix` writes, in place of those of "
    "signatures: a square of numbers, plain text or .npy, and beside it the ids of its rows, one a line, in "
    "a file of the same name that ends in .ids.",
)


class RecordName(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.3 only
    """The name of a record such as a descriptor: listed in the help, and checked where it is looked up."""

    def __init__(self, kind: str) -> None:
        self.name = kind

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        from pcretrieve.names import NAMES

        return f"[{'|'.join(NAMES[self.name].all())}]"


_distance_option = click.option(
    "--distance",
    type=RecordName("distance"),
    help="Euclidean distance of log-signatures, or the paper's D1 or D2.  [default: log, or the catalogue's]",
)
_whitening_option = click.option(
    "--whitening",
    type=click.Choice(["none", "resolution", "pca", "within-class"]),
    help="Let log-signatures count less in directions in which the resolution of a surface moves them, as it "
    "did those of simulated bodies (resolution, for r-bihdm); or decorrelate them over the catalogue (pca), "
    "or by the variation within its classes.  [default: none, or the catalogue's]",
)
_overlay_option = click.option(
    "--config",
    type=click.Path(path_type=Path),
    metavar="TOML|PRESET",
    help="Options in place of the catalogue's own: a file with the tables [signature] and [retrieval], or a "
    "preset.",
)


method_option = click.option(
    "--method", type=RecordName("descriptor"), help="The descriptor.  [default: r-bihdm, or the catalogue's]"
)
n_values_option = click.option(
    "--n-values",
    type=click.IntRange(min=1),
    metavar="L",
    help="Its length.  [default: 23, or the catalogue's]",
)


scale_option = click.option(
    "--scale",
    type=click.Choice(["auto", "area", "relative", "absolute"]),
    help="What its values are measured by: the area of the surface, its own first one, or the unit of the "
    "files, which keeps the size of bodies. auto is relative where signatures are compared PCA whitened, and "
    "else by area.  [default: auto, or the catalogue's]",
)


size_weight_option = click.option(
    "--size-weight",
    type=click.FloatRange(min=0, max=20),
    metavar="W",
    help="Weigh the size of bodies beside their form, where all files have one unit: one value more, their "
    "area to this power. 6 is best for people.  [default: 0, none, or the catalogue's]",
)


def limit_options(unit: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command the limits of the processes that work for it; the time is for one `unit`."""
    timeout = click.option(
        "--timeout",
        type=click.FloatRange(min=1),
        default=600,
        show_default=True,
        help=f"Longest time for a {unit}, seconds.",
    )
    memory = click.option(
        "--memory", type=click.FloatRange(min=0.5), metavar="GIB", help="Largest heap of a worker process."
    )
    return lambda command: timeout(memory(command))


def comparison_options(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options that say how shapes are compared, for `compared`."""
    for option in (
        _overlay_option,
        size_weight_option,
        scale_option,
        n_values_option,
        method_option,
        _whitening_option,
        _distance_option,
    ):
        command = option(command)
    return command


def compared(store: Catalogue, config: Path | None, **flags: Any) -> PipelineOptions:
    """How a command compares the shapes of a catalogue: the catalogue's options, a file's, then its flags."""
    given = {name: value for name, value in flags.items() if value is not None}
    tables: dict[str, dict[str, Any]] = {"signature": {}, "retrieval": {}}
    for name, value in given.items():
        tables["retrieval" if name in ("distance", "whitening") else "signature"][name] = value
    options = load_options(config, base=store.options).changed(**tables)
    if options.signature.size_weight or options.signature.scale == "absolute":
        _warn_of_mixed_units(store)
    return options


def read_distances(matrix: Path | None, comparison: dict[str, Any]) -> DistanceMatrix | None:
    """The distances that ``--matrix`` names; the options of signatures mean nothing beside it."""
    if matrix is None:
        return None
    if given := given_flags(comparison):
        raise click.UsageError(f"a matrix holds distances already: leave out {given}")
    from pcretrieve.matching import read_matrix

    return read_matrix(matrix)


def given_flags(comparison: dict[str, Any]) -> str:
    """Those of `comparison_options` that a command was given, as they were typed."""
    given = [name for name, value in comparison.items() if value is not None]
    return ", ".join(f"--{name.replace('_', '-')}" for name in given)


def _warn_of_mixed_units(store: Catalogue) -> None:
    areas = store.areas()
    if areas is not None and areas[1] > MIXED_UNITS * areas[0]:
        say(
            f"the largest body in {store.path} has {areas[1] / areas[0]:.0f} times the area of the smallest: "
            "size tells them apart only if all files have one unit"
        )


def say(message: str) -> None:
    """For people, on standard error."""
    click.echo(message, err=True)


def write_json(document: object) -> None:
    """For programs, on standard output."""
    click.echo(json.dumps(document, indent=2, ensure_ascii=False))


def write_json_list(documents: Iterable[object]) -> None:
    """A list for programs, on standard output; each of its members as soon as it is there."""
    before = "["
    for document in documents:
        click.echo(before)
        click.echo(indent(json.dumps(document, indent=2, ensure_ascii=False), "  "), nl=False)
        before = ","
    click.echo("[]" if before == "[" else "\n]")


def failure_line(record: Record) -> str:
    """Which shape failed, in which stage, why, and which file it was."""
    file = "" if record.path in (record.message or "") else f" ({record.path})"
    return f"failed: [{record.id} / {record.stage}] {record.message}{file}"


def load_options(
    config: Path | None, surface: str | None = None, *, base: PipelineOptions | None = None
) -> PipelineOptions:
    """The options that ``--config`` and ``--surface`` ask for; the others are those of `base`."""
    from pcretrieve.options import PipelineOptions

    options = base or PipelineOptions()
    if config is not None:
        options = PipelineOptions.named(config, options)
    return options if surface is None else options.changed(surface={"mode": surface})


def step_lines(steps: tuple[Step, ...]) -> list[str]:
    """Provenance, one line a stage and one a note."""
    lines = []
    for step in steps:
        sizes = ", ".join(
            f"{name} {value:.3g}" if value % 1 else f"{name} {value:.0f}"
            for name, value in step.sizes.items()
        )
        lines.append(f"{step.stage:<9} {step.seconds:7.3f} s  {sizes}")
        lines += [f"{'':<9}            {note}" for note in step.notes]
    return lines
