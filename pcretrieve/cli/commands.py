"""Commands whose help fits a screen: `--help` only names rare options, which `--help-all` explains."""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from typing import Any, TypeVar

import click

from pcretrieve.cli.documents import JSON_FLAG, write_error
from pcretrieve.errors import OptionError, PcretrieveError

__all__ = ["EXIT_ERROR", "EXIT_USAGE", "command", "exit_code", "option"]

Decorated = TypeVar("Decorated", bound=Callable[..., Any])

EXIT_ERROR = 1
EXIT_USAGE = 2

# Whether all options are shown, in the state of a command.
ALL = "pcretrieve.help_all"


class _Option(click.Option):
    """An option with a short text for ``--help``, and more of it for ``--help-all``."""

    def __init__(
        self, *args: Any, rare: bool = False, details: str | Callable[[], str] = "", **kwargs: Any
    ) -> None:
        super().__init__(*args, **kwargs)
        self.is_rare = rare
        self._details = details

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        if not ctx.meta.get(ALL):
            return None if self.is_rare else super().get_help_record(ctx)
        short = self.help
        details = self._details if isinstance(self._details, str) else self._details()
        self.help = f"{short} {details}".strip()
        try:
            return super().get_help_record(ctx)
        finally:
            self.help = short


class _Command(click.Command):
    """A command with the option ``--help-all``, if it has options that ``--help`` does not explain."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        params = super().get_params(ctx)
        if self._rare():
            params.append(_HELP_ALL)
        return params

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        super().format_options(ctx, formatter)
        if self._rare() and not ctx.meta.get(ALL):
            with formatter.section("More options, which --help-all explains"):
                # Not by `print_text`, which breaks lines at the hyphens of names.
                names = " ".join(one.opts[0] for one in self._rare())
                width = formatter.width - formatter.current_indent
                for line in textwrap.wrap(names, width, break_on_hyphens=False):
                    formatter.write(f"{'':{formatter.current_indent}}{line}\n")

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        is_json = JSON_FLAG in args
        try:
            return super().parse_args(ctx, args)
        except click.UsageError as error:
            if is_json:
                write_error(ctx, error, error.exit_code)
            raise

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except (PcretrieveError, click.ClickException) as error:
            if ctx.params.get("as_json"):
                write_error(ctx, error, exit_code(error))
            raise

    def _rare(self) -> list[_Option]:
        return [one for one in self.params if isinstance(one, _Option) and one.is_rare]


def exit_code(error: PcretrieveError | click.ClickException) -> int:
    """The code with which a command ends after an error."""
    if isinstance(error, click.ClickException):
        return error.exit_code
    return EXIT_USAGE if isinstance(error, OptionError) else EXIT_ERROR


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


def command(name: str) -> Callable[[Callable[..., Any]], click.Command]:
    """Make a command of a function, as `click.command` does."""
    return click.command(name, cls=_Command)


def option(*names: str, **settings: Any) -> Callable[[Decorated], Decorated]:
    """Add an option to a command, as `click.option` does."""
    return click.option(*names, cls=_Option, **settings)
