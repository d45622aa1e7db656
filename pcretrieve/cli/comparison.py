"""Options of the commands that compare shapes: which signatures, distances, whitening and re-ranking."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from pcretrieve.cli.completion import complete_presets
from pcretrieve.cli.messages import say
from pcretrieve.cli.parts import load_options

if TYPE_CHECKING:
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.matching import DistanceMatrix
    from pcretrieve.options import PipelineOptions

__all__ = [
    "RecordName",
    "compared",
    "comparison_options",
    "given_flags",
    "matrix_option",
    "method_option",
    "n_values_option",
    "read_distances",
    "scale_option",
    "size_weight_option",
]

# The names of flags that are options of retrieval; others are options of signatures.
RETRIEVAL_FLAGS = ("distance", "whitening", "rerank", "nearest")

WHITENING_NAMES = ("auto", "none", "resolution", "neighbours", "pca", "within-class")

# Ratio of the largest to the smallest area, from which files probably have different units: the areas of a
# horse and a mouse have a smaller ratio, those of one body in centimetres and in metres a larger one (1e4).
MIXED_UNITS = 3000

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

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """The names that begin with what is typed.

        Parameters
        ----------
        ctx : click.Context
            Not used.
        param : click.Parameter
            Not used.
        incomplete : str
            What is typed.

        Returns
        -------
        list of CompletionItem
            The names.
        """
        from pcretrieve.names import NAMES

        return [CompletionItem(name) for name in NAMES[self.name].all() if name.startswith(incomplete)]


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
    shell_complete=complete_presets,
    help="Options that replace those of the catalogue: a file with the tables [signature] and [retrieval], "
    "or a preset.",
)


method_option = click.option(
    "--method",
    type=RecordName("descriptor"),
    help="The descriptor, or several joined by +.  [default: combined, or the catalogue's]",
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
        Values of `comparison_options` and of ``--nearest``, which replace both; None: not given.

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
        tables["retrieval" if name in RETRIEVAL_FLAGS else "signature"][name] = value
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


def read_distances(
    matrix: Path | None, comparison: dict[str, Any], *, reranks: bool = False
) -> DistanceMatrix | None:
    """Read the distance matrix that ``--matrix`` names.

    Parameters
    ----------
    matrix : Path or None
        The file; None: not given.
    comparison : dict of str to object
        Values of `comparison_options`.
    reranks : bool, default False
        Whether the command can re-rank by a matrix.

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
    without = {name: value for name, value in comparison.items() if name != "rerank" or not reranks}
    if given := given_flags(without):
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
