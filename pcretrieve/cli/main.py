"""The entry point of the command line: commands, exit codes, messages of errors.

Results go to standard output, messages for users to standard error. Exit codes: 0 success; 1 error; 2 wrong
usage; 3 finished, but some shapes failed; 130 interrupted by Ctrl-C; 143 by SIGTERM.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
from contextlib import suppress
from importlib import import_module
from types import FrameType
from typing import NoReturn

import click

from pcretrieve import __version__
from pcretrieve.cli.commands import EXIT_ERROR, exit_code
from pcretrieve.cli.documents import JSON_FLAG, write_error
from pcretrieve.cli.messages import say, silence
from pcretrieve.cli.parts import EXIT_INTERRUPTED
from pcretrieve.cli.patience import stop_waiting, tell_of_waiting
from pcretrieve.errors import OptionError, PcretrieveError
from pcretrieve.suggestions import did_you_mean

__all__ = ["cli", "main"]

# Shells report a program that was ended by a signal with this number plus the number of the signal.
EXIT_SIGNAL = 128

STANDARD_ERROR = 2

# The commands, each with its line in the list of commands. A command is the function `NAME_command` of the
# module `NAME`, with underscores for hyphens, which is imported when the command or its help is called.
COMMANDS = {
    "demo": "Simulate scans, ingest them, query and evaluate",
    "merge": "Register range scans of one body, and merge them",
    "reconstruct": "Write the closed surface of a scan",
    "signature": "Print the signatures of scans",
    "inspect": "Write a page that shows what is wrong with a scan",
    "report-problem": "Pack what is needed to report a scan that fails",
    "ingest": "Process scans, and store them in a catalogue",
    "status": "Say how far the last ingest is",
    "retry": "Process failed scans again",
    "watch": "Ingest scans that arrive in a folder",
    "query": "Find the shapes most similar to scans",
    "evaluate": "Compute retrieval measures of a labelled catalogue",
    "compare": "Compare the measures of two results",
    "calibrate": "Learn from labelled scans what to ignore",
    "matrix": "Write the distances of all pairs of shapes",
    "duplicates": "Find shapes that nothing distinguishes",
    "cluster": "Group shapes without labels",
    "map": "Draw the shapes in the plane, similar ones near",
    "report": "Write a page of queries, results and measures",
    "serve": "Show a catalogue in the browser",
    "list": "List the shapes of a catalogue",
    "show": "Show how a shape was made",
    "remove": "Remove shapes from a catalogue",
    "catalogue": "Make one catalogue of several",
    "check": "Check whether a catalogue is whole",
    "backup": "Copy a catalogue to one file",
    "export": "Write meshes or signatures of a catalogue",
    "options": "Print all options with their units",
}


class _LazyGroup(click.Group):
    """Commands that are imported when they are called, so that ``--help`` does not wait for imports."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        name = cmd_name.replace("-", "_")
        module = import_module(f"pcretrieve.cli.{name}")
        command: click.Command = getattr(module, f"{name}_command")
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([*COMMANDS.items()])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        if name not in COMMANDS and not name.startswith("-") and not ctx.resilient_parsing:
            error = click.UsageError(f"there is no command {name!r}{did_you_mean(name, COMMANDS)}", ctx)
            if JSON_FLAG in args:
                write_error(ctx, error, error.exit_code)
            raise error
        return super().resolve_command(ctx, args)


@click.group(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="pcretrieve")
@click.pass_context
def cli(context: click.Context) -> None:
    """Raw 3D scans of things that bend in, ranked shapes out.

    \b
    pcretrieve ingest scans/ --labels scans/labels.csv --catalogue bodies.sqlite
    pcretrieve query --catalogue bodies.sqlite scan.ply
    """
    logger = logging.getLogger("pcretrieve")
    if not any(isinstance(handler, _Printed) for handler in logger.handlers):
        logger.addHandler(_Printed(logging.WARNING))
    # The options of the command are parsed later, after imports that may take long.
    if context.invoked_subcommand is not None and not {"--quiet", "-q"} & {*sys.argv}:
        tell_of_waiting(context.invoked_subcommand)
        context.call_on_close(stop_waiting)


class _Printed(logging.Handler):
    """Prints warnings of the library on standard error, except for repairs, which are in the provenance."""

    def emit(self, record: logging.LogRecord) -> None:
        if record.name != "pcretrieve.pipeline":
            say(record.getMessage())


def main() -> NoReturn:
    """Run the command line, and end with an exit code. Errors are printed as messages."""
    _open_standard_streams()
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_DFL:  # not if the signal is ignored, as under nohup
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
    except OptionError as error:
        # Without the stage, because options are not the fault of the stage that checks them.
        say(f"Error: {error.message}")
        sys.exit(exit_code(error))
    except PcretrieveError as error:
        say(f"Error: {error}")
        sys.exit(exit_code(error))
    except BrokenPipeError:
        # The program that reads the output has ended, as in `pcretrieve list | head`.
        sys.stderr.close()
        sys.exit(EXIT_ERROR)
    except OSError as error:
        # Of printing alone: the library raises errors of its own, and errors of files have their names.
        if error.filename is not None:
            raise
        say(f"Error: cannot print the result: {error.strerror}; print it to another place")
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
