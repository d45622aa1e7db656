"""Options that several commands share, what a shell completes, and the command that prints all options.

`--help` of a command fits a screen: it only names rare options, which `--help-all` explains.
"""

from __future__ import annotations

import os
import textwrap
from collections.abc import Callable, Iterable
from functools import partial, wraps
from pathlib import Path
from typing import Any, TypeVar

import click
from click.shell_completion import CompletionItem

import pcretrieve as pr
from pcretrieve.cli.output import (
    JSON_FLAG,
    JSON_LINES_FLAG,
    Result,
    choose_json,
    errors_as_json,
    print_result,
    print_text,
    prints_json,
)
from pcretrieve.errors import PcretrieveError
from pcretrieve.plugins import DESCRIPTOR_NAMES, METHODS

Decorated = TypeVar("Decorated", bound=Callable[..., Any])

#: The environment variable that names the catalogue of commands without ``--catalogue``.
CATALOGUE_VARIABLE = "PCRETRIEVE_CATALOGUE"

# Whether all options are shown, in the state of a command.
ALL = "pcretrieve.help_all"

LABEL = "label="

# The names of `comparison_options`.
SIGNATURE_FLAGS = ("method", "n_values", "scale", "size_weight")
RETRIEVAL_FLAGS = ("distance", "whitening", "rerank")
COMPARISON = ("config", *SIGNATURE_FLAGS, *RETRIEVAL_FLAGS)

MATCHERS = ("heat-hausdorff", "hks-bow-gallery", "mds-cm-bof", "meshsift")
WHITENING_NAMES = (
    "auto",
    "unsupervised",
    "none",
    "people",
    "neighbours",
    "pca",
    "within-class",
)

# What messages call the values of these types.
KINDS = {click.IntRange: "whole number", click.FloatRange: "number"}


class Option(click.Option):
    """An option; a rare one is explained by ``--help-all`` only."""

    def __init__(self, *args: Any, rare: bool = False, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.is_rare = rare

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """Name and text of the option; nothing for a rare one in ``--help``."""
        return (
            None
            if self.is_rare and not ctx.meta.get(ALL)
            else super().get_help_record(ctx)
        )


class Command(click.Command):
    """A command that prints the result of its function: for people, or with ``--json`` as JSON."""

    def __init__(self, *args: Any, has_json: bool = True, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.params += [_JSON, _JSON_LINES] * has_json
        self._rare = [
            one.opts[0] for one in self.params if isinstance(one, Option) and one.is_rare
        ]
        self.params += [_HELP_ALL] * bool(self._rare)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, and the names of the rare ones."""
        super().format_options(ctx, formatter)
        if self._rare and not ctx.meta.get(ALL):
            with formatter.section("More options, see --help-all"):
                # Not by click, which breaks lines at the hyphens of names.
                width = formatter.width - formatter.current_indent
                for line in textwrap.wrap(
                    " ".join(self._rare), width, break_on_hyphens=False
                ):
                    formatter.write(f"{'':{formatter.current_indent}}{line}\n")

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse; with ``--json``, an error is a document too."""
        given = [*args]
        with errors_as_json(ctx, bool({JSON_FLAG, JSON_LINES_FLAG} & {*args})):
            try:
                return super().parse_args(ctx, args)
            except click.NoSuchOption:  # which has a suggestion
                raise
            except click.UsageError as error:
                stray = [word for word in given if word.endswith(".sqlite")]
                takes_one = {"-c", "--catalogue"} & {
                    name for one in self.params for name in one.opts
                }
                if stray and takes_one and not takes_one & {*given}:
                    raise click.UsageError(
                        f"write -c before a catalogue: -c {stray[0]}", ctx
                    ) from error
                raise

    def invoke(self, ctx: click.Context) -> Any:
        """Run, print the result, and end with its exit code."""
        from pcretrieve.values.compiled import tuned_process

        with errors_as_json(ctx, prints_json()):
            tuned_process()
            result = super().invoke(ctx)
            if isinstance(result, Result):
                print_result(result)
                if result.failed:
                    ctx.exit(result.exit_code)


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
    settings.setdefault(
        "show_default", settings.get("default") is not None and not is_flag
    )
    chosen = click.Choice(kind) if isinstance(kind, tuple) else kind
    if type(kind) in KINDS:
        kind.name = KINDS[type(kind)]
    names += [into] if into else []
    return click.option(
        *names,
        cls=Option,
        type=chosen,
        metavar=metavar,
        is_flag=is_flag or None,
        help=text,
        **settings,
    )


#: An option that only ``--help-all`` explains.
rare_option = partial(option, rare=True)


def _show_all(context: click.Context, parameter: click.Parameter, is_given: bool) -> None:
    if is_given and not context.resilient_parsing:
        context.meta[ALL] = True
        click.echo(context.get_help(), color=context.color)
        context.exit()


_JSON = click.Option(
    [JSON_FLAG],
    is_flag=True,
    expose_value=False,
    callback=choose_json,
    help="Print one JSON document.",
)
_JSON_LINES = Option(
    [JSON_LINES_FLAG],
    rare=True,
    is_flag=True,
    expose_value=False,
    callback=choose_json,
    help="Print each element of the result as a line of JSON, as soon as it is known.",
)
_HELP_ALL = click.Option(
    ["--help-all"],
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_show_all,
    help="Show all options.",
)


# --- completion by the shell ---------------------------------------------------------------------------

Completion = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def _completion(
    names: Callable[[click.Context], Iterable[str]], *, or_files: bool = False
) -> Completion:
    """What completes one of these names; if none begins with what is typed, a file."""

    def complete(
        ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        # Without control characters, of which the shell would make further lines.
        found = [
            name
            for name in names(ctx)
            if name.startswith(incomplete) and name.isprintable()
        ]
        return [*map(CompletionItem, found)] or [
            CompletionItem(incomplete, type="file")
        ] * or_files

    return complete


def _presets(context: click.Context) -> Iterable[str]:
    from pcretrieve.options import PRESETS

    return PRESETS


def _shapes(context: click.Context) -> dict[str, str | None]:
    """Class of each shape of the catalogue of a command; none, if it cannot be read."""
    location = context.params.get("catalogue") or os.environ.get(CATALOGUE_VARIABLE)
    try:
        with pr.Catalogue(location or "") as store:
            return store.labels()
    except (PcretrieveError, OSError):
        return {}


complete_presets = _completion(_presets, or_files=True)
complete_ids = _completion(_shapes)
complete_queries = _completion(_shapes, or_files=True)
complete_labels = _completion(
    lambda context: sorted(
        {f"{LABEL}{name}" for name in _shapes(context).values() if name}
    )
)
complete_methods = _completion(lambda context: DESCRIPTOR_NAMES.all())


def classes_of(
    context: click.Context, parameter: click.Parameter, conditions: tuple[str, ...]
) -> list[str]:
    """The classes of conditions ``label=CLASS`` on the shapes that are searched."""
    for condition in conditions:
        if not condition.startswith(LABEL):
            raise click.BadParameter(
                f"must be label=CLASS, got {condition!r}", context, parameter
            )
    return [condition.removeprefix(LABEL) for condition in conditions]


# --- options of many commands --------------------------------------------------------------------------

#: The type of an option that names a catalogue: a string, because a path would lose a slash of a URL.
CATALOGUE = click.Path()
PATH = click.Path(path_type=Path)
COUNT = click.IntRange(min=1)
NUMBER = click.IntRange(min=0)

catalogue_option = option(
    "--catalogue -c FILE|URL",
    "The catalogue.",
    CATALOGUE,
    required=True,
    envvar=CATALOGUE_VARIABLE,
    show_envvar=True,
)
workers_option = option(
    "--workers N", "Scans at a time.", COUNT, show_default="one per core"
)
progress_option = rare_option(
    "--progress",
    "Show a bar (a line a minute in a log file), one line of JSON for each scan, or nothing.",
    ("bar", "json", "none"),
    default="bar",
)
verbose_option = option(
    "--verbose -v", "Print how shapes were compared, and all measures.", into="is_verbose"
)
labels_option = option(
    "--labels CSV|LAYOUT", "Use these classes, not the stored ones; see `ingest --help`."
)
up_option = rare_option(
    "--up",
    "Turn pictures so that this axis of the files points up.  [default: found for each shape]",
    ("x", "-x", "y", "-y", "z", "-z"),
)
config_option = option(
    "--config TOML|PRESET",
    "Settings: a file made by `pcretrieve lab options`, or body-scanner, handheld, depth-camera, clean-mesh.",
    PATH,
    shell_complete=complete_presets,
)
surface_option = option(
    "--surface WHICH",
    "Meshes to rebuild: auto (those with holes or defects), reconstruct (all), keep (none).",
    ("auto", "reconstruct", "keep"),
)
unit_option = option(
    "--unit UNIT",
    "Unit of files that name none: um mm cm dm m km in ft.",
    ("um", "mm", "cm", "dm", "m", "km", "in", "ft"),
)


def limit_options(
    command: Decorated,
    *,
    unit: str = "scan",
    time: float = 600,
    memory: float | None = None,
) -> Decorated:
    """Options that limit time and memory of the processes in which a command works."""
    seconds, space = click.FloatRange(min=1), click.FloatRange(min=0.5)
    text = "Give a worker process no more memory than this."
    command = rare_option("--memory GIB", text, space, default=memory)(command)
    text = f"Give up after this time for each {unit}."
    return rare_option("--timeout SECONDS", text, seconds, default=time)(command)


def process_options(command: Decorated) -> Decorated:
    """Options of commands that work on many scans in processes."""
    return workers_option(limit_options(progress_option(command)))


def settings_options(command: Decorated) -> Decorated:
    """Options that determine how scans are read and reconstructed; `load_options` takes their values."""
    return config_option(surface_option(unit_option(command)))


def load_options(values: dict[str, Any]) -> pr.PipelineOptions:
    """Take ``--config``, ``--surface`` and ``--unit`` from the values of a command."""
    given = {
        "surface": {"mode": values.pop("surface", None)},
        "scan": {"unit": values.pop("unit", None)},
    }
    changed = {
        table: chosen for table, chosen in given.items() if None not in chosen.values()
    }
    return pr.PipelineOptions.of(values.pop("config")).changed(**changed)


# --- options of commands that compare shapes -----------------------------------------------------------

matrix_option = rare_option(
    "--matrix FILE",
    "Rank by the distances in this file, which `write_matrix` in Python writes.",
    PATH,
)
method_option = rare_option(
    "--method NAME",
    f"Descriptor, or several joined by +: {', '.join(METHODS)}.  [default: hapt+r-bihdm, or the catalogue's]",
    shell_complete=complete_methods,
)
n_values_option = rare_option(
    "--n-values L",
    "Number of values of the descriptor.  [default: 23, or the catalogue's]",
    COUNT,
)
scale_option = rare_option(
    "--scale",
    "Divide values by the area of the surface (area), by the first value (relative), or leave them, so that "
    "they depend on the size of bodies (absolute).  [default: area, or the catalogue's]",
    ("area", "relative", "absolute"),
)
size_weight_option = rare_option(
    "--size-weight W",
    "Weight of the size of bodies beside their form; 6 is best for people. All files need known units, or "
    "the same one.  [default: 0, or the catalogue's]",
    click.FloatRange(min=0, max=20),
)
_overlay_option = rare_option(
    "--config TOML|PRESET",
    "Settings in place of the catalogue's: a file with the tables [signature] and [retrieval], or a preset.",
    PATH,
    shell_complete=complete_presets,
)
_rerank_option = rare_option(
    "--rerank",
    "Sort the first hundred results again by the neighbours that two shapes share, but keep the first.  "
    "[default: none, or the catalogue's]",
    ("none", "k-reciprocal"),
)
_whitening_option = rare_option(
    "--whitening NAME|FILE",
    "Differences that count less: those between scans of one person (people), near shapes (neighbours), "
    "within classes (within-class), between all shapes (pca), those in a FILE of `calibrate`, or none. auto "
    "is people for scans of people; else within-class if there are enough labels, else neighbours; "
    "unsupervised is auto without labels, as in `evaluate`.  [default: auto, or the catalogue's]",
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


def on_catalogue(command: Callable[..., Result]) -> Callable[..., Result]:
    """Add the same, and give a command the opened catalogue, the options, and the distances of a matrix."""

    @wraps(command)
    def opening(catalogue: str, **values: Any) -> Result:
        if "matrix" in values:
            values["matrix"] = read_distances(values, *COMPARISON)
        store = opened(catalogue)
        return command(store, compared(store, values), **values)

    return comparison_options(opening)


def opened(catalogue: str, *, any_numbers: bool = False) -> pr.Catalogue:
    """A catalogue, which is closed when the result of the command is printed."""
    return click.get_current_context().with_resource(
        pr.Catalogue(catalogue, any_numbers=any_numbers)
    )


def compared(store: pr.Catalogue, values: dict[str, Any]) -> pr.PipelineOptions:
    """The options with which a command compares shapes, taken from its values."""
    return pr.PipelineOptions.of(values.pop("config"), store.options).changed(
        **changes(values)
    )


def changes(values: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The changed options of a comparison by table, taken from the values of a command."""
    signature, retrieval = (
        taken(values, *SIGNATURE_FLAGS),
        taken(values, *RETRIEVAL_FLAGS),
    )
    if (method := signature.get("method")) in MATCHERS:
        raise click.UsageError(
            f"{method} compares pairs of surfaces, and has no signatures: write its distances in Python by "
            f"pr.write_matrix(pr.matrix(CATALOGUE, matcher={method!r}), FILE), and give --matrix FILE"
        )
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
    refuse("a matrix holds distances already", *others)
    return pr.read_matrix(values["matrix"])


def refuse(reason: str, *names: str) -> None:
    """End with a usage error if the command was given some of these options."""
    values = click.get_current_context().params
    if given := [
        f"--{name.replace('_', '-')}" for name in names if values[name] is not None
    ]:
        raise click.UsageError(f"{reason}: leave out {', '.join(given)}")


@command("options")
@config_option
def options_command(**values: Any) -> Result:
    """Print all settings of the pipeline with their units, as TOML for --config.

    \b
    pcretrieve lab options > mine.toml
    """
    from pcretrieve.options import describe_options

    options = load_options(values)
    return Result(None, options, lambda: print_text(describe_options(options)))
