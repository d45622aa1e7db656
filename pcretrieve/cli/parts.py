"""Options that several commands have, and functions that print messages and results."""

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
    "CATALOGUE",
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
    "unit_option",
    "write_json",
    "write_json_list",
]

WHITENING_NAMES = ("auto", "none", "resolution", "neighbours", "pca", "within-class")

EXIT_SOME_FAILED = 3
EXIT_INTERRUPTED = 130

# Ratio of the largest to the smallest area, from which files probably have different units: the areas of a
# horse and a mouse have a smaller ratio, those of one body in centimetres and in metres a larger one (1e4).
MIXED_UNITS = 3000

#: The type of an option that names a catalogue: a string, because a path would lose a slash of a URL.
CATALOGUE = click.Path()
catalogue_option = click.option(
    "--catalogue", "-c", type=CATALOGUE, required=True, metavar="FILE|URL", help="The catalogue."
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
config_option = click.option(
    "--config",
    type=click.Path(path_type=Path),
    metavar="TOML|PRESET",
    help="Pipeline options: a file such as `pcretrieve options` prints, or one of body-scanner, handheld, "
    "depth-camera, clean-mesh, paper.",
)
surface_option = click.option(
    "--surface",
    type=click.Choice(["auto", "reconstruct", "keep"]),
    help="Which meshes to reconstruct: all that are not closed manifolds (auto, the default), all, or none "
    "(keep).",
)
unit_option = click.option(
    "--unit",
    type=click.Choice(["um", "mm", "cm", "dm", "m", "km", "in", "ft"]),
    help="Unit of the files whose format does not have one. All scans are converted to metres.",
)
matrix_option = click.option(
    "--matrix",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Rank by the distances in a file, such as `pcretrieve matrix` writes, instead of the distances of "
    "signatures: a square matrix, plain text or .npy. A file with the same name that ends in .ids has the "
    "ids of its rows, one in each line.",
)


class RecordName(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.3 only
    """The name of a record such as a descriptor: the help lists the names, the library checks them.

    Parameters
    ----------
    kind : str
        A key of `pcretrieve.names.NAMES`, such as "descriptor".
    """

    def __init__(self, kind: str) -> None:
        self.name = kind

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        """The names, as the help shows them.

        Parameters
        ----------
        param : click.Parameter
            Not used.
        ctx : click.Context, optional
            Not used.

        Returns
        -------
        str
            The names in brackets.
        """
        from pcretrieve.names import NAMES

        return f"[{'|'.join(NAMES[self.name].all())}]"


class WhiteningName(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.3 only
    """The name of a whitening, or a file of `pcretrieve calibrate`."""

    name = "whitening"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        """The names, as the help shows them.

        Parameters
        ----------
        param : click.Parameter
            Not used.
        ctx : click.Context, optional
            Not used.

        Returns
        -------
        str
            The names in brackets.
        """
        return f"[{'|'.join(WHITENING_NAMES)}|FILE]"


_distance_option = click.option(
    "--distance",
    type=RecordName("distance"),
    help="Euclidean distance of log-signatures (log), or the distances D1 and D2 of the paper.  [default: "
    "log, or the catalogue's]",
)
_whitening_option = click.option(
    "--whitening",
    type=WhiteningName(),
    help="Whiten log-signatures by a covariance matrix: of the differences of near shapes (neighbours); of "
    "the variation within the classes of the catalogue (within-class); of all its shapes (pca); or of the "
    "errors that the resolution of a surface causes, estimated from simulated bodies (resolution, for "
    "r-bihdm). auto is within-class if there are enough labels, else neighbours; `evaluate` does not fit "
    "auto to labels. FILE is a whitening that `calibrate` has fitted to other scans.  [default: auto, or "
    "the catalogue's]",
)
_rerank_option = click.option(
    "--rerank",
    type=click.Choice(["none", "local", "k-reciprocal"]),
    help="Sort the first hundred results again, of which the first stays: by distances relative to those of "
    "near shapes (local), or by how many neighbours two shapes share (k-reciprocal).  [default: none, or "
    "the catalogue's]",
)
_overlay_option = click.option(
    "--config",
    type=click.Path(path_type=Path),
    metavar="TOML|PRESET",
    help="Options that replace those of the catalogue: a file with the tables [signature] and [retrieval], "
    "or a preset.",
)


method_option = click.option(
    "--method", type=RecordName("descriptor"), help="The descriptor.  [default: r-bihdm, or the catalogue's]"
)
n_values_option = click.option(
    "--n-values",
    type=click.IntRange(min=1),
    metavar="L",
    help="Number of values of the descriptor.  [default: 59, or the catalogue's]",
)


scale_option = click.option(
    "--scale",
    type=click.Choice(["auto", "area", "relative", "absolute"]),
    help="How values are normalised: by the area of the surface (area), by the first value (relative), or "
    "not (absolute), so that they depend on the size of bodies. auto is relative "
    "with --whitening pca, else area.  [default: auto, or the catalogue's]",
)


size_weight_option = click.option(
    "--size-weight",
    type=click.FloatRange(min=0, max=20),
    metavar="W",
    help="Weight of the size of bodies beside their form, if all files have one unit or known ones (see "
    "--unit): adds a value, the area to the power of W. 6 is best for people.  [default: 0, or the "
    "catalogue's]",
)


def limit_options(unit: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Options that limit time and memory of the processes in which a command works.

    Parameters
    ----------
    unit : str
        What the time limit is for, such as "scan".

    Returns
    -------
    callable
        A decorator of commands, which adds ``--timeout`` and ``--memory``.
    """
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
    """Add the options that determine how shapes are compared; `compared` takes their values.

    Parameters
    ----------
    command : callable
        The command.

    Returns
    -------
    callable
        The command with the options.
    """
    for option in (
        _overlay_option,
        size_weight_option,
        scale_option,
        n_values_option,
        method_option,
        _rerank_option,
        _whitening_option,
        _distance_option,
    ):
        command = option(command)
    return command


def compared(store: Catalogue, config: Path | None, **flags: Any) -> PipelineOptions:
    """The options with which a command compares the shapes of a catalogue.

    Parameters
    ----------
    store : Catalogue
        The catalogue, whose options are the defaults.
    config : Path or None
        A file or a preset, whose options replace those of the catalogue.
    **flags : object
        Values of `comparison_options`, which replace both; None: not given.

    Returns
    -------
    PipelineOptions
        The options.

    Raises
    ------
    OptionError
        If the file cannot be read, or options are not valid.
    """
    given = {name: value for name, value in flags.items() if value is not None}
    tables: dict[str, dict[str, Any]] = {"signature": {}, "retrieval": {}}
    for name, value in given.items():
        tables["retrieval" if name in ("distance", "whitening", "rerank") else "signature"][name] = value
    # A whitening by name replaces a file that the configuration names, and vice versa.
    if "whitening" in given:
        name = given["whitening"]
        tables["retrieval"]["calibration"] = None if name in WHITENING_NAMES else name
        if name not in WHITENING_NAMES:
            del tables["retrieval"]["whitening"]
    options = load_options(config, base=store.options).changed(**tables)
    if options.signature.compares_sizes:
        _warn_of_mixed_units(store)
    return options


def read_distances(matrix: Path | None, comparison: dict[str, Any]) -> DistanceMatrix | None:
    """Read the distance matrix that ``--matrix`` names.

    Parameters
    ----------
    matrix : Path or None
        The file; None: not given.
    comparison : dict of str to object
        Values of `comparison_options`.

    Returns
    -------
    DistanceMatrix or None
        The distances; None without a file.

    Raises
    ------
    click.UsageError
        If options of signatures are given too, which have no effect on a matrix.
    """
    if matrix is None:
        return None
    if given := given_flags(comparison):
        raise click.UsageError(f"a matrix holds distances already: leave out {given}")
    from pcretrieve.matching import read_matrix

    return read_matrix(matrix)


def given_flags(comparison: dict[str, Any]) -> str:
    """The options among `comparison_options` that a command was given.

    Parameters
    ----------
    comparison : dict of str to object
        Values of `comparison_options`; None: not given.

    Returns
    -------
    str
        The flags, as they are typed, separated by commas.
    """
    given = [name for name, value in comparison.items() if value is not None]
    return ", ".join(f"--{name.replace('_', '-')}" for name in given)


def _warn_of_mixed_units(store: Catalogue) -> None:
    smallest, largest = store.areas().get(None, (1.0, 1.0))
    if largest > MIXED_UNITS * smallest:
        say(
            f"the largest body in {store.location} has {largest / smallest:.0f} times the area of the "
            "smallest: size tells them apart only if all files have one unit"
        )


def say(message: str) -> None:
    """Print a message for users, on standard error.

    Parameters
    ----------
    message : str
        The message.
    """
    click.echo(message, err=True)


def write_json(document: object) -> None:
    """Print a JSON document for programs, on standard output.

    Parameters
    ----------
    document : object
        What JSON can represent.
    """
    click.echo(json.dumps(document, indent=2, ensure_ascii=False))


def write_json_list(documents: Iterable[object]) -> None:
    """Print a list as a JSON document on standard output, each element as soon as it is computed.

    Parameters
    ----------
    documents : iterable of object
        What JSON can represent.
    """
    before = "["
    for document in documents:
        click.echo(before)
        click.echo(indent(json.dumps(document, indent=2, ensure_ascii=False), "  "), nl=False)
        before = ","
    click.echo("[]" if before == "[" else "\n]")


def failure_line(record: Record) -> str:
    """The message about a shape that failed.

    Parameters
    ----------
    record : Record
        The record of the failure.

    Returns
    -------
    str
        Id, stage and message; and the file, if the message does not name it.
    """
    file = "" if record.path in (record.message or "") else f" ({record.path})"
    return f"failed: [{record.id} / {record.stage}] {record.message}{file}"


def load_options(
    config: Path | None, surface: str | None = None, *, base: PipelineOptions | None = None
) -> PipelineOptions:
    """The options of a command with ``--config`` and ``--surface``.

    Parameters
    ----------
    config : Path or None
        A file or a preset; None: not given.
    surface : str or None
        The mode of the surface stage; None: not given.
    base : PipelineOptions, optional
        The options that the others replace; the defaults of the pipeline if not given.

    Returns
    -------
    PipelineOptions
        The options.

    Raises
    ------
    OptionError
        If the file cannot be read, or options are not valid.
    """
    from pcretrieve.options import PipelineOptions

    options = base or PipelineOptions()
    if config is not None:
        options = PipelineOptions.named(config, options)
    return options if surface is None else options.changed(surface={"mode": surface})


def step_lines(steps: tuple[Step, ...]) -> list[str]:
    """Provenance as text.

    Parameters
    ----------
    steps : tuple of Step
        The steps.

    Returns
    -------
    list of str
        One line for each step (stage, seconds, sizes), and one for each note.
    """
    lines = []
    for step in steps:
        sizes = ", ".join(
            f"{name} {value:.3g}" if value % 1 else f"{name} {value:.0f}"
            for name, value in step.sizes.items()
        )
        lines.append(f"{step.stage:<9} {step.seconds:7.3f} s  {sizes}")
        lines += [f"{'':<9}            {note}" for note in step.notes]
    return lines
