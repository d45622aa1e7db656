"""Options of the commands that compare shapes: which signatures, distances, whitening and re-ranking."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from pcretrieve.cli.commands import option
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
    "names_of",
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

matrix_option = option(
    "--matrix",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Rank by the distances in a file, as `pcretrieve matrix` writes it.",
    details="It is a square matrix, plain text or .npy. A file with the same name that ends in .ids has the "
    "ids of its rows, one in each line.",
)


class RecordName(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.3 only
    """The name of a record such as a descriptor: the help lists the names, the library checks them."""

    def __init__(self, kind: str) -> None:
        self.name = kind

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        """What the help shows in place of the names, of which there may be many."""
        return "NAME"

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """The names that begin with what is typed."""
        from pcretrieve.names import NAMES

        return [CompletionItem(name) for name in NAMES[self.name].all() if name.startswith(incomplete)]


def names_of(kind: str) -> str:
    """The names of all records of a kind, for the help."""
    from pcretrieve.names import NAMES

    return f"Names: {', '.join(NAMES[kind].all())}."


_distance_option = option(
    "--distance",
    type=RecordName("distance"),
    rare=True,
    help="Euclidean distance of log-signatures (log), or D1 or D2 of the paper.  [default: log, or the "
    "catalogue's]",
    details=partial(names_of, "distance"),
)
_whitening_option = option(
    "--whitening",
    metavar="NAME|FILE",
    rare=True,
    help="Which differences of signatures count less: those of near shapes (neighbours), within classes "
    "(within-class), between all shapes (pca), by the resolution of surfaces (resolution), as in a FILE of "
    "`calibrate`; or none.  [default: auto, or the catalogue's]",
    details="auto is within-class if there are enough labels, else neighbours; `evaluate` does not fit auto "
    "to labels. See docs/guide.md, Distances and whitening.",
)
_rerank_option = option(
    "--rerank",
    type=click.Choice(["none", "local", "k-reciprocal"]),
    rare=True,
    help="Sort the first hundred results again, of which the first stays: by distances relative to those of "
    "near shapes (local), or by how many neighbours two shapes share (k-reciprocal).  [default: none, or "
    "the catalogue's]",
)
_overlay_option = option(
    "--config",
    type=click.Path(path_type=Path),
    metavar="TOML|PRESET",
    shell_complete=complete_presets,
    rare=True,
    help="Options that replace those of the catalogue: a file with the tables [signature] and [retrieval], "
    "or a preset.",
)


method_option = option(
    "--method",
    type=RecordName("descriptor"),
    rare=True,
    help="The descriptor, or several joined by +.  [default: combined, or the catalogue's]",
    details=partial(names_of, "descriptor"),
)
n_values_option = option(
    "--n-values",
    type=click.IntRange(min=1),
    metavar="L",
    rare=True,
    help="Number of values of the descriptor.  [default: 59, or the catalogue's]",
)


scale_option = option(
    "--scale",
    type=click.Choice(["auto", "area", "relative", "absolute"]),
    rare=True,
    help="How values are normalised: by the area of the surface (area), by the first value (relative), or "
    "not (absolute), so that they depend on the size of bodies.  [default: auto, or the catalogue's]",
    details="auto is relative with --whitening pca, else area.",
)


size_weight_option = option(
    "--size-weight",
    type=click.FloatRange(min=0, max=20),
    metavar="W",
    rare=True,
    help="Weight of the size of bodies beside their form; 6 is best for people.  [default: 0, or the "
    "catalogue's]",
    details="It adds a value, the area to the power of W; all files must have one unit or known ones.",
)


def comparison_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options that determine how shapes are compared; `compared` takes their values."""
    for added in (
        _overlay_option,
        size_weight_option,
        scale_option,
        n_values_option,
        method_option,
        _rerank_option,
        _whitening_option,
        _distance_option,
    ):
        command = added(command)
    return command


def compared(store: Catalogue, config: Path | None, **flags: Any) -> PipelineOptions:
    """The options with which a command compares the shapes of a catalogue."""
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
    """Read the distance matrix that ``--matrix`` names."""
    if matrix is None:
        return None
    without = {name: value for name, value in comparison.items() if name != "rerank" or not reranks}
    if given := given_flags(without):
        raise click.UsageError(f"a matrix holds distances already: leave out {given}")
    from pcretrieve.matching import read_matrix

    return read_matrix(matrix)


def given_flags(comparison: dict[str, Any]) -> str:
    """The options among `comparison_options` that a command was given."""
    given = [name for name, value in comparison.items() if value is not None]
    return ", ".join(f"--{name.replace('_', '-')}" for name in given)


def _warn_of_mixed_units(store: Catalogue) -> None:
    smallest, largest = store.areas().get(None, (1.0, 1.0))
    if largest > MIXED_UNITS * smallest:
        say(
            f"the largest body in {store.location} has {largest / smallest:.0f} times the area of the "
            "smallest: size tells them apart only if all files have one unit"
        )
