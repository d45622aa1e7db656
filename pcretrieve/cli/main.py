"""The entry point of the command line: commands, exit codes, messages of errors.

Results go to standard output, messages for users to standard error. Exit codes: 0 success; 1 error; 2 wrong
usage; 3 finished, but some shapes failed; 130 interrupted by Ctrl-C; 143 by SIGTERM.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
from collections.abc import Mapping
from contextlib import suppress
from importlib import import_module
from types import FrameType
from typing import Any, NoReturn

import click

from pcretrieve import __version__
from pcretrieve.cli.messages import Printed, say, silence, stop_waiting, tell_of_waiting
from pcretrieve.cli.output import (
    EXIT_ERROR,
    EXIT_INTERRUPTED,
    JSON_FLAG,
    errors_as_json,
    exit_code,
)
from pcretrieve.errors import OptionError, PcretrieveError, did_you_mean

# Shells report a program that was ended by a signal with this number plus the number of the signal.
EXIT_SIGNAL = 128

STANDARD_ERROR = 2

# The commands, each with its module and its line in the list of commands. A command is the function
# `NAME_command`, with underscores for hyphens; its module is imported when the command or its help is called.
CATALOGUE = {
    "merge": ("catalogue", "Join catalogues"),
    "check": ("catalogue", "Check a catalogue for damage"),
    "backup": ("catalogue", "Copy a catalogue to one file"),
    "export": ("catalogue", "Write meshes or signatures to files"),
}
LAB = {
    "signature": ("scans", "Print the signatures of scans"),
    "calibrate": ("evaluation", "Learn from labelled scans what to ignore"),
    "map": ("search", "Plot a 2-D map of shapes"),
    "options": ("options", "Print all settings with their units"),
    "report-problem": ("inspection", "Pack a scan that fails for a report to us"),
}
COMMANDS = {
    "demo": ("batches", "Try everything on simulated scans"),
    "ingest": ("batches", "Process scans, and store them in a catalogue"),
    "status": ("batches", "Show progress of the last ingest"),
    "watch": ("batches", "Ingest scans as they arrive in a folder"),
    "query": ("search", "Find the shapes most similar to a scan"),
    "serve": ("search", "Show a catalogue in the browser"),
    "inspect": ("inspection", "Show what is wrong with a scan"),
    "merge": ("scans", "Merge views of one body into one scan"),
    "reconstruct": ("scans", "Turn a scan into a watertight surface"),
    "evaluate": ("evaluation", "Measure how well scans of one class find each other"),
    "report": ("evaluation", "Write a page of queries, results and measures"),
    "duplicates": ("search", "Find shapes that look the same"),
    "list": ("catalogue", "List the shapes of a catalogue"),
    "show": ("catalogue", "Show how a shape was made"),
    "mark": ("catalogue", "Keep a decision: rescan, accept, or a note"),
    "remove": ("catalogue", "Remove shapes from a catalogue"),
    "catalogue": (CATALOGUE, f"Look after catalogues: {', '.join(CATALOGUE)}"),
    "lab": (LAB, "The laboratory: signatures, distances, settings"),
}


class _LazyGroup(click.Group):
    """Commands that are imported when they are called, so that ``--help`` does not wait for imports."""

    def __init__(self, table: Mapping[str, tuple[Any, str]], **settings: Any) -> None:
        super().__init__(**settings)
        self._table = table

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self._table)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self._table:
            return None
        module, text = self._table[cmd_name]
        if isinstance(module, dict):
            return _LazyGroup(module, name=cmd_name, help=f"{text}.")
        found = getattr(
            import_module(f"pcretrieve.cli.{module}"),
            f"{cmd_name.replace('-', '_')}_command",
        )
        command: click.Command = found
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in self._table.items()])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        is_known = name.startswith("-") or self.get_command(ctx, name) is not None
        if not is_known and not ctx.resilient_parsing:
            with errors_as_json(ctx, JSON_FLAG in args):
                raise click.UsageError(
                    f"there is no command {name!r}{did_you_mean(name, self._table)}", ctx
                )
        return super().resolve_command(ctx, args)


@click.group(
    cls=_LazyGroup,
    table=COMMANDS,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(__version__, prog_name="pcretrieve")
@click.pass_context
def cli(context: click.Context) -> None:
    """Raw 3D scans of things that bend in, ranked shapes out.

    \b
    pcretrieve ingest scans/ --labels scans/labels.csv --catalogue bodies.sqlite
    pcretrieve query --catalogue bodies.sqlite scan.ply
    """
    logger = logging.getLogger("pcretrieve")
    if not any(isinstance(handler, Printed) for handler in logger.handlers):
        logger.addHandler(Printed(logging.WARNING))
    # The options of the command are parsed later, after imports that may take long.
    if context.invoked_subcommand is not None and not {"--quiet", "-q"} & {*sys.argv}:
        tell_of_waiting(context.invoked_subcommand)
        context.call_on_close(stop_waiting)


def main() -> NoReturn:
    """Run the command line, and end with an exit code. Errors are printed as messages."""
    _open_standard_streams()
    # Pydantic would look for plug-ins of its own in all packages: a twentieth of a short command.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "true")
    # Windows has no SIGHUP.
    for number in (signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)):
        if (
            signal.getsignal(number) is signal.SIG_DFL
        ):  # not if the signal is ignored, as under nohup
            signal.signal(number, _stop)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)
    try:
        code = cli.main(prog_name="pcretrieve", standalone_mode=False)
    except click.exceptions.Abort:
        say("stopped")
        sys.exit(EXIT_INTERRUPTED)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except PcretrieveError as error:
        # Options are not the fault of the stage that checks them.
        say(f"Error: {error.message if isinstance(error, OptionError) else error}")
        sys.exit(exit_code(error))
    except BrokenPipeError:
        # The program that reads the output has ended, as in `pcretrieve list | head`.
        sys.stderr.close()
        sys.exit(EXIT_ERROR)
    except OSError as error:
        # Of printing alone: the library raises errors of its own, and errors of files have their names.
        if error.filename is not None:
            raise
        say(
            f"Error: cannot print the result: {error.strerror}; print it to another place"
        )
        silence(sys.stdout)
        sys.exit(EXIT_ERROR)
    sys.exit(code if isinstance(code, int) else 0)


def _open_standard_streams() -> None:
    """Open the null device in place of standard streams that are closed, or files would get their numbers."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            # It gets the smallest number that is free, which is that of the stream.
            number = os.open(os.devnull, os.O_RDWR)
            os.set_inheritable(number, True)  # by worker processes
            setattr(sys, name, os.fdopen(number, "r" if name == "stdin" else "w"))


def _stop(number: int, frame: FrameType | None) -> NoReturn:
    """End by SystemExit, so that worker processes are stopped too."""
    sys.exit(EXIT_SIGNAL + number)


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    """End by KeyboardInterrupt at the first Ctrl-C, so that commands stop workers and say what is stored."""
    signal.signal(number, _end_at_once)
    raise KeyboardInterrupt


def _end_at_once(number: int, frame: FrameType | None) -> NoReturn:
    """End without a delay at the second Ctrl-C; Linux ends the worker processes too.

    What is written stays whole: changes of catalogues are transactions, and files get their names last.
    """
    with suppress(OSError):
        # Not by `say`, because the signal may have interrupted another message.
        os.write(STANDARD_ERROR, b"\nstopped at once\n")
    os._exit(EXIT_INTERRUPTED)
