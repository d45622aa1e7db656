"""Options that several commands share, what a shell completes, and the command that prints all options.

`--help` of a command fits a screen: it only names rare options, which `--help-all` explains.
"""

from __future__ import annotations

import os
import textwrap
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial, wraps
from pathlib import Path
from typing import Any, TypeVar

import click
from click.shell_completion import CompletionItem

import pcretrieve as pr
from pcretrieve.cli.messages import say
from pcretrieve.cli.output import JSON_FLAG, errors_as_json, print_text, write_document
from pcretrieve.errors import PcretrieveError
from pcretrieve.plugins import DESCRIPTOR_NAMES

Decorated = TypeVar("Decorated", bound=Callable[..., Any])

EXIT_SOME_FAILED = 3
EXIT_INTERRUPTED = 130

#: The environment variable that names the catalogue of commands without ``--catalogue``.
CATALOGUE_VARIABLE = "PCRETRIEVE_CATALOGUE"

# Whether all options are shown, in the state of a command.
ALL = "pcretrieve.help_all"

LABEL = "label="

# The names of `comparison_options`.
SIGNATURE_FLAGS = ("method", "n_values", "scale", "size_weight")
RETRIEVAL_FLAGS = ("distance", "whitening", "rerank")
COMPARISON = ("config", *SIGNATURE_FLAGS, *RETRIEVAL_FLAGS)

WHITENING_NAMES = ("auto", "none", "resolution", "neighbours", "pca", "within-class")

# Ratio of the largest to the smallest area, from which files probably have different units: the areas of a
# horse and a mouse have a smaller ratio, those of one body in centimetres and in metres a larger one (1e4).
MIXED_UNITS = 3000


class Option(click.Option):
    """An option with a short text for ``--help``, and more of it for ``--help-all``."""

    def __init__(
        self, *args: Any, rare: bool = False, details: str | Callable[[], str] = "", **kwargs: Any
    ) -> None:
        super().__init__(*args, **kwargs)
        self.is_rare, self._details = rare, details

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """Name and text of the option; nothing for a rare one in ``--help``."""
        if not ctx.meta.get(ALL):
            return None if self.is_rare else super().get_help_record(ctx)
        short, details = self.help, self._details if isinstance(self._details, str) else self._details()
        self.help = f"{short} {details}".strip()
        record = super().get_help_record(ctx)
        self.help = short
        return record


class Command(click.Command):
    """A command with ``--help-all``, if it has rare options; for ``--json``, its errors are documents too."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """The parameters, ``--help-all`` among them."""
        return [*super().get_params(ctx), *([_HELP_ALL] if self._rare() else [])]

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, and the names of the rare ones."""
        super().format_options(ctx, formatter)
        if self._rare() and not ctx.meta.get(ALL):
            with formatter.section("More options, see --help-all"):
                # Not by `print_text`, which breaks lines at the hyphens of names.
                width = formatter.width - formatter.current_indent
                for line in textwrap.wrap(" ".join(self._rare()), width, break_on_hyphens=False):
                    formatter.write(f"{'':{formatter.current_indent}}{line}\n")

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse; with ``--json``, an error is a document too."""
        with errors_as_json(ctx, JSON_FLAG in args):
            return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run; with ``--json``, an error is a document too."""
        with errors_as_json(ctx, ctx.params.get("as_json", False)):
            return super().invoke(ctx)

    def _rare(self) -> list[str]:
        return [one.opts[0] for one in self.params if isinstance(one, Option) and one.is_rare]


#: Makes a command of a function.
command = partial(click.command, cls=Command)


def option(
    spec: str, text: str, kind: Any = None, *, into: str = "", **settings: Any
) -> Callable[[Decorated], Decorated]:
    """Add an option to a command.

    spec: the names, and what stands for the value in the help, as in ``--output -o FILE``; a flag has none.
    kind: a type of click, or the values of a choice.
    into: the name of the parameter, if it is another one.
    """
    words = spec.split()
    names = [word for word in words if word.startswith("-")]
    metavar = " ".join(words[len(names) :]) or None
    is_flag = kind is None and metavar is None
    settings.setdefault("show_default", settings.get("default") is not None and not is_flag)
    chosen = click.Choice(kind) if isinstance(kind, tuple) else kind
    names += [into] if into else []
    return click.option(
        *names, cls=Option, type=chosen, metavar=metavar, is_flag=is_flag or None, help=text, **settings
    )


#: An option that only ``--help-all`` explains.
rare_option = partial(option, rare=True)


def exit_if(some_failed: object) -> None:
    """End the command with the code for scans that failed, if there are any."""
    if some_failed:
        click.get_current_context().exit(EXIT_SOME_FAILED)


def _show_all(context: click.Context, parameter: click.Parameter, is_asked: bool) -> None:
    if is_asked and not context.resilient_parsing:
        context.meta[ALL] = True
        click.echo(context.get_help(), color=context.color)
        context.exit()


_HELP_ALL = click.Option(
    ["--help-all"],
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_show_all,
    help="Show all options, with details.",
)


# --- completion by the shell ---------------------------------------------------------------------------


Completed = list[CompletionItem]


def complete_presets(ctx: click.Context, param: click.Parameter, incomplete: str) -> Completed:
    """The presets that begin with what is typed, and files."""
    from pcretrieve.options import PRESETS

    return _items(PRESETS, incomplete) or [CompletionItem(incomplete, type="file")]


def complete_ids(ctx: click.Context, param: click.Parameter, incomplete: str) -> Completed:
    """The ids in the catalogue of the command."""
    return _items((shape_id for shape_id, _ in _shapes(ctx)), incomplete)


def complete_queries(ctx: click.Context, param: click.Parameter, incomplete: str) -> Completed:
    """The same; if there are none, files."""
    return complete_ids(ctx, param, incomplete) or [CompletionItem(incomplete, type="file")]


def complete_labels(ctx: click.Context, param: click.Parameter, incomplete: str) -> Completed:
    """The conditions ``label=CLASS``."""
    labels = {label for _, label in _shapes(ctx) if label}
    return _items((LABEL + label for label in sorted(labels)), incomplete)


def complete_methods(ctx: click.Context, param: click.Parameter, incomplete: str) -> Completed:
    """The descriptors."""
    return _items(DESCRIPTOR_NAMES.all(), incomplete)


def _items(names: Iterable[str], incomplete: str) -> Completed:
    # Without control characters, of which the shell would make further lines.
    return [CompletionItem(name) for name in names if name.startswith(incomplete) and name.isprintable()]


def _shapes(context: click.Context) -> list[tuple[str, str | None]]:
    """Id and class of the shapes of the catalogue of a command; none, if it cannot be read."""
    location = context.params.get("catalogue") or os.environ.get(CATALOGUE_VARIABLE)
    try:
        with pr.Catalogue(location or "") as store:
            return [(record.id, record.label) for record in store.outlines()]
    except (PcretrieveError, OSError):
        return []


def classes_of(context: click.Context, parameter: click.Parameter, conditions: tuple[str, ...]) -> list[str]:
    """The classes of conditions ``label=CLASS`` on the shapes that are searched."""
    for condition in conditions:
        if not condition.startswith(LABEL):
            raise click.BadParameter(f"must be label=CLASS, got {condition!r}", context, parameter)
    return [condition.removeprefix(LABEL) for condition in conditions]


# --- options of many commands --------------------------------------------------------------------------

#: The type of an option that names a catalogue: a string, because a path would lose a slash of a URL.
CATALOGUE = click.Path()
PATH = click.Path(path_type=Path)
COUNT = click.IntRange(min=1)
NUMBER = click.IntRange(min=0)

#: Of commands whose only argument is a catalogue.
catalogue_argument = click.argument("catalogue", type=CATALOGUE, envvar=CATALOGUE_VARIABLE)
catalogue_option = option(
    "--catalogue -c FILE|URL",
    "The catalogue.",
    CATALOGUE,
    required=True,
    envvar=CATALOGUE_VARIABLE,
    show_envvar=True,
)
json_option = option("--json", "Print one JSON document.", into="as_json")
workers_option = option("--workers N", "Scans at a time.", COUNT, show_default="one per core")
progress_option = rare_option(
    "--progress",
    "Show a bar (a line a minute in a log file), one line of JSON for each scan, or nothing.",
    ("bar", "json", "none"),
    default="bar",
)
labels_option = option("--labels CSV|LAYOUT", "Use these classes, not the stored ones; see `ingest --help`.")
up_option = rare_option(
    "--up",
    "Turn pictures so that this axis of the files points up.  [default: found for each shape]",
    ("x", "-x", "y", "-y", "z", "-z"),
)
config_option = option(
    "--config TOML|PRESET",
    "Settings: a file made by `pcretrieve options`, or body-scanner, handheld, depth-camera, clean-mesh, "
    "paper, classic.",
    PATH,
    shell_complete=complete_presets,
)
surface_option = option(
    "--surface WHICH",
    "Meshes to rebuild: auto (open ones), reconstruct (all), keep (none).",
    ("auto", "reconstruct", "keep"),
    details="auto, the default, rebuilds meshes with holes and those that are not manifolds.",
)
unit_option = option(
    "--unit UNIT",
    "Unit of files that name none: um mm cm dm m km in ft.",
    ("um", "mm", "cm", "dm", "m", "km", "in", "ft"),
    details="All scans are converted to metres.",
)


def limit_options(command: Decorated, *, unit: str = "scan") -> Decorated:
    """Options that limit time and memory of the processes in which a command works."""
    time, space = click.FloatRange(min=1), click.FloatRange(min=0.5)
    words = f"Give up after this time for each {unit}."
    timeout = rare_option("--timeout SECONDS", words, time, default=600)
    memory = rare_option("--memory GIB", "Give a worker process no more memory than this.", space)
    return timeout(memory(command))


def load_options(values: dict[str, Any], base: pr.PipelineOptions | None = None) -> pr.PipelineOptions:
    """Take ``--config``, ``--surface`` and ``--unit`` from the values of a command."""
    options = pr.PipelineOptions.of(values.pop("config"), base)
    if (mode := values.pop("surface", None)) is not None:
        options = options.changed(surface={"mode": mode})
    unit = values.pop("unit", None)
    return options if unit is None else options.changed(scan={"unit": unit})


# --- options of commands that compare shapes -----------------------------------------------------------

matrix_option = option(
    "--matrix FILE",
    "Rank by the distances in this file, which `pcretrieve matrix` writes.",
    PATH,
    details="It is a square matrix, plain text or .npy. A file of the same name that ends in .ids has the "
    "ids of its rows, one in each line.",
)
method_option = rare_option(
    "--method NAME",
    "Descriptor, or several joined by +.  [default: combined, or the catalogue's]",
    shell_complete=complete_methods,
    details=lambda: f"Names: {', '.join(DESCRIPTOR_NAMES.all())}.",
)
n_values_option = rare_option(
    "--n-values L", "Number of values of the descriptor.  [default: 59, or the catalogue's]", COUNT
)
scale_option = rare_option(
    "--scale",
    "Divide values by the area of the surface (area), by the first value (relative), or leave them, so that "
    "they depend on the size of bodies (absolute).  [default: auto, or the catalogue's]",
    ("auto", "area", "relative", "absolute"),
    details="auto is relative with --whitening pca, else area.",
)
size_weight_option = rare_option(
    "--size-weight W",
    "Weight of the size of bodies beside their form; 6 is best for people.  [default: 0, or the catalogue's]",
    click.FloatRange(min=0, max=20),
    details="Adds a value, the area to the power of W. All files need one unit, or known units.",
)
_overlay_option = rare_option(
    "--config TOML|PRESET",
    "Settings in place of the catalogue's: a file with the tables [signature] and [retrieval], or a preset.",
    PATH,
    shell_complete=complete_presets,
)
_rerank_option = rare_option(
    "--rerank",
    "Sort the first hundred results again, but keep the first: by distances relative to those of near shapes "
    "(local), or by the neighbours that two shapes share (k-reciprocal).  [default: none, or the "
    "catalogue's]",
    ("none", "local", "k-reciprocal"),
)
_whitening_option = rare_option(
    "--whitening NAME|FILE",
    "Differences that count less: those between near shapes (neighbours), within classes (within-class), "
    "between all shapes (pca), those that come from the resolution (resolution), those in a FILE of "
    "`calibrate`, or none.  [default: auto, or the catalogue's]",
    details="auto is within-class if there are enough labels, else neighbours; `evaluate` does not fit auto "
    "to labels. See docs/guide.md, Distances and whitening.",
)
_distance_option = rare_option(
    "--distance",
    "Euclidean distance of log-signatures (log), or D1 or D2 of the paper.  [default: log, or the "
    "catalogue's]",
    ("log", "d1", "d2"),
)


def comparison_options(command: Decorated) -> Decorated:
    """Add the options that determine how shapes are compared; `opened` takes their values."""
    command = size_weight_option(_overlay_option(command))
    command = method_option(n_values_option(scale_option(command)))
    return _distance_option(_whitening_option(_rerank_option(command)))


def on_catalogue(command: Callable[..., None]) -> Callable[..., None]:
    """Add the same, and give a command the opened catalogue, the options, and the distances of a matrix."""

    @wraps(command)
    def opening(catalogue: str, **values: Any) -> None:
        if "matrix" in values:
            values["matrix"] = read_distances(values, *COMPARISON)
        with opened(catalogue, values) as (store, options):
            command(store, options, **values)

    return comparison_options(opening)


@contextmanager
def opened(
    catalogue: str, values: dict[str, Any], *, any_numbers: bool = False
) -> Iterator[tuple[pr.Catalogue, pr.PipelineOptions]]:
    """A catalogue, and the options with which a command compares its shapes, taken from its values."""
    with pr.Catalogue(catalogue, any_numbers=any_numbers) as store:
        options = pr.PipelineOptions.of(values.pop("config"), store.options).changed(**changes(values))
        if options.signature.compares_sizes:
            _warn_of_mixed_units(store)
        yield store, options


def changes(values: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The changed options of a comparison by table, taken from the values of a command."""
    signature, retrieval = taken(values, *SIGNATURE_FLAGS), taken(values, *RETRIEVAL_FLAGS)
    # A whitening by name replaces a file that the configuration names, and vice versa.
    if "whitening" in retrieval:
        is_name = retrieval["whitening"] in WHITENING_NAMES
        retrieval["calibration"] = None if is_name else retrieval.pop("whitening")
    return {"signature": signature, "retrieval": retrieval}


def taken(values: dict[str, Any], *names: str) -> dict[str, Any]:
    """Take some options from the values of a command, those that were given."""
    found = {name: values.pop(name) for name in names}
    return {name: value for name, value in found.items() if value is not None}


def read_distances(values: dict[str, Any], *others: str) -> pr.DistanceMatrix | None:
    """The distances of ``--matrix``, in place of what other options determine."""
    if values["matrix"] is None:
        return None
    refuse(values, "a matrix holds distances already", *others)
    return pr.read_matrix(values["matrix"])


def refuse(values: dict[str, Any], reason: str, *names: str) -> None:
    """End with a usage error if a command was given some of these options."""
    if given := [f"--{name.replace('_', '-')}" for name in names if values[name] is not None]:
        raise click.UsageError(f"{reason}: leave out {', '.join(given)}")


def _warn_of_mixed_units(store: pr.Catalogue) -> None:
    smallest, largest = store.areas().get(None, (1.0, 1.0))
    if largest > MIXED_UNITS * smallest:
        say(
            f"the largest body in {store.location} has {largest / smallest:.0f} times the area of the "
            "smallest: size tells them apart only if all files have one unit"
        )


@command("options")
@config_option
@json_option
def options_command(as_json: bool, **values: Any) -> None:
    """Print all settings of the pipeline with their units, as TOML for --config.

    \b
    pcretrieve options > mine.toml
    """
    from pcretrieve.options import describe_options

    options = load_options(values)
    if as_json:
        write_document(None, options=options)
    else:
        print_text(describe_options(options))
