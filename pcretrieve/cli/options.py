"""How commands declare their options, those that several share, and what a shell completes.

The parameters of a function are those of its command: each has its option as its default. Options that go
together are a group, a frozen dataclass, which a function gets and passes on whole::

    @dataclass(frozen=True)
    class Limits:
        timeout: float = option("--timeout SECONDS", "Give up then.", SECONDS, default=600)

    @command("inspect")
    def inspect_command(*, scan: Path = argument("SCAN"), limits: Limits) -> Result: ...

The type says whether an option is a flag, takes a path or one of some words, and whether it must be given.

`--help` of a command fits a screen: it only names rare options, which `--help-all` explains.
"""

from __future__ import annotations

import os
import textwrap
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, is_dataclass
from functools import cache, partial
from inspect import signature
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

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
from pcretrieve.plugins import DESCRIPTOR_NAMES, METHODS, option_texts

#: The environment variable that names the catalogue of commands without ``--catalogue``.
CATALOGUE_VARIABLE = "PCRETRIEVE_CATALOGUE"

# Whether all options are shown, in the state of a command.
ALL = "pcretrieve.help_all"

LABEL = "label="

MATCHERS = ("heat-hausdorff", "hks-bow-gallery", "mds-cm-bof", "meshsift")

# The tables of options by which shapes are compared. A catalogue has its own, and few people set others.
COMPARED = ("signature", "retrieval")

#: The type of an option that names a catalogue: a string, because a path would lose a slash of a URL.
CATALOGUE = click.Path()
PATH = click.Path(path_type=Path)


class WholeNumber(click.IntRange):
    """A whole number, which messages call so."""

    name = "whole number"


class Number(click.FloatRange):
    """A number, which messages call so."""

    name = "number"


COUNT = WholeNumber(min=1)
NUMBER = WholeNumber(min=0)
SECONDS = Number(min=1)
GIBIBYTES = Number(min=0.5)


class Option(click.Option):
    """An option; a rare one is explained by ``--help-all`` only.

    sets: the option of the pipeline that it sets, such as signature.scale, and whose text it has.
    """

    def __init__(
        self, *args: Any, rare: bool = False, sets: str = "", **kwargs: Any
    ) -> None:
        super().__init__(*args, **kwargs)
        self.is_rare = rare or sets.startswith(COMPARED)
        self.sets, self.text = sets, self.help

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """Name and text of the option; nothing for a rare one in ``--help``."""
        if self.is_rare and not ctx.meta.get(ALL):
            return None
        if self.sets:
            text, default = _texts()[self.sets]
            stored = ", or the catalogue's" if self.is_rare else ""
            said = f"{text} {self.text}".rstrip()
            self.help = f"{said}  [default: {default}{stored}]"
        return super().get_help_record(ctx)


@cache
def _texts() -> dict[str, tuple[str, str]]:
    """Text and default of each option of the pipeline, read without an import of them, which takes .2 s."""
    tables = Path(__file__).parents[1] / "options" / "tables.py"
    return option_texts(tables.read_text(encoding="utf-8"))


def option(spec: str, text: str = "", kind: Any = None, **settings: Any) -> Any:
    """Declare an option, as the default of a parameter.

    spec: the names, and what stands for the value in the help, as in ``--output -o FILE``; a flag has none.
    kind: a type of click, where the type of the parameter does not say all.
    settings: those of `Option`.
    """
    words = spec.split()
    names = [word for word in words if word.startswith("-")]
    metavar = " ".join(words[len(names) :]) or None

    def made(name: str, hint: Any) -> Option:
        type_, may_lack = _type(hint)
        is_flag = type_ is bool
        own: dict[str, Any] = {"default": None} if may_lack else {}
        own["required"] = not (may_lack or is_flag or "default" in settings)
        return Option(
            [*names, name],
            type=kind or type_,
            metavar=metavar,
            help=text,
            is_flag=is_flag or None,
            **{"show_default": True} | own | settings,
        )

    return made


#: Declares an option that only ``--help-all`` explains.
rare_option = partial(option, rare=True)


def argument(metavar: str, kind: Any = None, **settings: Any) -> Any:
    """Declare an argument, as the default of a parameter; settings: those of click."""

    def made(name: str, hint: Any) -> click.Argument:
        nargs = -1 if get_origin(hint) is tuple else 1
        type_ = kind or _type(hint)[0]
        return click.Argument(
            [name], metavar=metavar, type=type_, nargs=nargs, **settings
        )

    return made


def _type(hint: Any) -> tuple[Any, bool]:
    """The type of click for the values of a type, each of several, and whether there may be none."""
    may_lack = get_origin(hint) in (Union, UnionType)
    (type_,) = {*(get_args(hint) if may_lack else [hint])} - {NoneType}
    if get_origin(type_) is Literal:
        return click.Choice(get_args(type_)), may_lack
    if get_origin(type_) in (tuple, list):
        type_ = get_args(type_)[0]
    return PATH if type_ is Path else type_, may_lack


def declared(holder: Any) -> Iterator[click.Parameter]:
    """The parameters of click of a function or of a group, in their order, groups opened."""
    hints = get_type_hints(holder)
    for name, parameter in signature(holder).parameters.items():
        if is_dataclass(hints[name]):
            yield from declared(hints[name])
        else:
            yield parameter.default(name, hints[name])


def _called(holder: Any, values: Mapping[str, Any]) -> Any:
    """Call a function, or make a group, with the values of its parameters."""
    hints = get_type_hints(holder)
    hints.pop("return", None)
    return holder(
        **{
            name: _called(hint, values) if is_dataclass(hint) else values[name]
            for name, hint in hints.items()
        }
    )


class Command(click.Command):
    """A command that prints the result of its function: for people, or with ``--json`` as JSON."""

    def __init__(self, *args: Any, has_json: bool = True, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.params += [*declared(self.callback)]
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
                takes_one = any("-c" in one.opts for one in self.params)
                if stray and takes_one and not {"-c", "--catalogue"} & {*given}:
                    raise click.UsageError(
                        f"write -c before a catalogue: -c {stray[0]}", ctx
                    ) from error
                raise

    def invoke(self, ctx: click.Context) -> Any:
        """Run, print the result, and end with its exit code."""
        from pcretrieve.values.compiled import tuned_process

        with errors_as_json(ctx, prints_json()):
            tuned_process()
            result = ctx.invoke(_called, self.callback, ctx.params)
            if isinstance(result, Result):
                print_result(result)
                if result.failed:
                    ctx.exit(result.exit_code)


#: Makes a command of a function.
command = partial(click.command, cls=Command)


def _show_all(context: click.Context, parameter: click.Parameter, is_given: bool) -> None:
    if is_given and not context.resilient_parsing:
        context.meta[ALL] = True
        click.echo(context.get_help(), color=context.color)
        context.exit()


_JSON = option(
    JSON_FLAG, "Print one JSON document.", expose_value=False, callback=choose_json
)("json", bool)
_JSON_LINES = rare_option(
    JSON_LINES_FLAG,
    "Print each element of the result as a line of JSON, as soon as it is known.",
    expose_value=False,
    callback=choose_json,
)("json_lines", bool)
_HELP_ALL = option(
    "--help-all",
    "Show all options.",
    is_eager=True,
    expose_value=False,
    callback=_show_all,
)("help_all", bool)


# --- completion by the shell ---------------------------------------------------------------------------


def _completion(
    names: Callable[[click.Context], Iterable[str]], *, or_files: bool = False
) -> Callable[..., list[CompletionItem]]:
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
) -> list[str] | None:
    """The classes of conditions ``label=CLASS`` on the shapes that are searched; None for all."""
    for condition in conditions:
        if not condition.startswith(LABEL):
            raise click.BadParameter(
                f"must be label=CLASS, got {condition!r}", context, parameter
            )
    return [condition.removeprefix(LABEL) for condition in conditions] or None


# --- options of many commands --------------------------------------------------------------------------

Axis = Literal["x", "-x", "y", "-y", "z", "-z"]
Unit = Literal["um", "mm", "cm", "dm", "m", "km", "in", "ft"]

catalogue_option = option(
    "--catalogue -c FILE|URL",
    "The catalogue.",
    CATALOGUE,
    envvar=CATALOGUE_VARIABLE,
    show_envvar=True,
)
verbose_option = option(
    "--verbose -v", "Print how shapes were compared, and all measures."
)
up_option = rare_option(
    "--up",
    "Turn pictures so that this axis of the files points up.  [default: found for each shape]",
)
matrix_option = rare_option(
    "--matrix FILE",
    "Rank by the distances in this file, which `write_matrix` in Python writes.",
)
config_option = option(
    "--config TOML|PRESET",
    "Settings: a file made by `pcretrieve lab options`, or body-scanner, handheld, depth-camera, "
    "clean-mesh.",
    shell_complete=complete_presets,
)
unit_option = option("--unit UNIT", sets="scan.unit")


@dataclass(frozen=True)
class Limits:
    """The limits of the processes in which a command works: seconds, and GiB."""

    timeout: float = rare_option(
        "--timeout SECONDS",
        "Give up after this time for each scan.",
        SECONDS,
        default=600,
    )
    memory: float | None = rare_option(
        "--memory GIB", "Give a worker process no more memory than this.", GIBIBYTES
    )


@dataclass(frozen=True)
class Processes(Limits):
    """The processes that work on many scans, and what is shown meanwhile."""

    workers: int | None = option(
        "--workers N", "Scans at a time.", COUNT, show_default="one per core"
    )
    progress: Literal["bar", "json", "none"] = rare_option(
        "--progress",
        "Show a bar (a line a minute in a log file), one line of JSON for each scan, or nothing.",
        default="bar",
    )


@dataclass(frozen=True)
class Settings:
    """A configuration, and options of the pipeline that are given beside it."""

    config: Path | None = config_option

    def options(self, base: pr.PipelineOptions | None = None) -> pr.PipelineOptions:
        """The options of a catalogue, or the defaults, with what was given."""
        return pr.PipelineOptions.of(self.config, base).changed(**self.changes())

    def changes(self) -> dict[str, dict[str, object]]:
        """The options that were given, by table."""
        tables: dict[str, dict[str, object]] = defaultdict(dict)
        for one in declared(type(self)):
            value = getattr(self, str(one.name))
            if isinstance(one, Option) and one.sets and value is not None:
                table, _, name = one.sets.partition(".")
                tables[table][name] = value
        return tables


@dataclass(frozen=True)
class SurfaceSettings(Settings):
    """How surfaces are reconstructed."""

    surface: Literal["auto", "reconstruct", "keep"] | None = option(
        "--surface WHICH", sets="surface.mode"
    )


@dataclass(frozen=True)
class ScanSettings(SurfaceSettings):
    """How scans are read and reconstructed."""

    unit: Unit | None = unit_option


# --- options of commands that compare shapes -----------------------------------------------------------


@dataclass(frozen=True)
class SignatureSettings(Settings):
    """The descriptor by which shapes are compared."""

    method: str | None = option(
        "--method NAME",
        f"Names: {', '.join(METHODS)}.",
        sets="signature.method",
        shell_complete=complete_methods,
        multiple=True,
        # Joined, as only `evaluate` takes several; of others, the message on the name has them all.
        callback=lambda _, option, names: ",".join(names) or None,
    )
    n_values: int | None = option("--n-values L", sets="signature.n_values")
    scale: Literal["area", "relative", "absolute"] | None = option(
        "--scale", sets="signature.scale"
    )
    size_weight: float | None = option("--size-weight W", sets="signature.size_weight")


@dataclass(frozen=True)
class Comparison(SignatureSettings):
    """How shapes are compared: what is given in place of the options of a catalogue."""

    distance: Literal["log", "d1", "d2"] | None = option(
        "--distance", sets="retrieval.distance"
    )
    whitening: str | None = option(
        "--whitening NAME|FILE",
        "Or a FILE of `lab calibrate`.",
        sets="retrieval.whitening",
    )
    rerank: Literal["none", "k-reciprocal"] | None = option(
        "--rerank", sets="retrieval.rerank"
    )
    config: Path | None = rare_option(
        "--config TOML|PRESET",
        "Settings in place of the catalogue's: a file with [signature] and [retrieval], or a preset.",
        shell_complete=complete_presets,
    )

    def changes(self) -> dict[str, dict[str, object]]:
        """The same; a whitening by name replaces a file that the configuration names, and vice versa."""
        from pcretrieve.options import WhiteningKind

        if self.method in MATCHERS:
            raise click.UsageError(
                f"{self.method} compares pairs of surfaces, and has no signatures: write its distances "
                f"in Python by pr.write_matrix(pr.matrix(CATALOGUE, matcher={self.method!r}), FILE), and "
                "give --matrix FILE"
            )
        changed = super().changes()
        if self.whitening in get_args(WhiteningKind):
            changed["retrieval"]["calibration"] = None
        elif self.whitening is not None:
            changed["retrieval"]["calibration"] = changed["retrieval"].pop("whitening")
        return changed

    def opened(self, catalogue: str) -> tuple[pr.Catalogue, pr.PipelineOptions]:
        """A catalogue, and the options with which its shapes are compared."""
        store = opened(catalogue)
        return store, self.options(store.options)


# The names of the options of a comparison.
COMPARISON = [str(one.name) for one in declared(Comparison)]


def opened(catalogue: str, *, any_numbers: bool = False) -> pr.Catalogue:
    """A catalogue, which is closed when the result of the command is printed."""
    return click.get_current_context().with_resource(
        pr.Catalogue(catalogue, any_numbers=any_numbers)
    )


def read_distances(file: Path | None, *, used: str = "") -> pr.DistanceMatrix | None:
    """The distances of ``--matrix``, in place of what the options of a comparison determine.

    used: the name of the option of a comparison that is used beside a matrix.
    """
    if file is None:
        return None
    refuse("a matrix holds distances already", *(n for n in COMPARISON if n != used))
    return pr.read_matrix(file)


def refuse(reason: str, *names: str) -> None:
    """End with a usage error if the command was given some of these options."""
    values = click.get_current_context().params
    if given := [
        f"--{name.replace('_', '-')}" for name in names if values[name] is not None
    ]:
        raise click.UsageError(f"{reason}: leave out {', '.join(given)}")


@command("options")
def options_command(settings: Settings) -> Result:
    """Print all settings of the pipeline with their units, as TOML for --config.

    \b
    pcretrieve lab options > mine.toml
    """
    from pcretrieve.options import describe_options

    options = settings.options()
    return Result(None, options, lambda: print_text(describe_options(options)))
