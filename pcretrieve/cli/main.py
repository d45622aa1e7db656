"""The command line: parse, call, print.

Results go to standard output, words for people to standard error. Exit codes: 0 all good, 1 error, 2 usage,
3 finished, but some shapes failed; 130 stopped by Ctrl-C, 143 by SIGTERM.
"""

from __future__ import annotations

import logging
import signal
import sys
from importlib import import_module
from types import FrameType
from typing import NoReturn

import click

from pcretrieve import __version__
from pcretrieve.cli.parts import EXIT_INTERRUPTED
from pcretrieve.errors import OptionError, PcretrieveError

__all__ = ["cli", "main"]

EXIT_ERROR = 1
EXIT_USAGE = 2

# What a shell reports of a program that a signal ended is this plus the signal's number.
EXIT_SIGNAL = 128

# Each is the function `NAME_command` of the module of its name, imported when the command is run or asked for
# its own help.
COMMANDS = (
    "demo",
    "merge",
    "reconstruct",
    "signature",
    "inspect",
    "ingest",
    "query",
    "evaluate",
    "matrix",
    "report",
    "list",
    "show",
    "remove",
    "export",
    "options",
)


class _LazyGroup(click.Group):
    """Commands that are imported when they are needed: ``--help`` must not wait for numpy."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = import_module(f"pcretrieve.cli.{cmd_name}")
        command: click.Command = getattr(module, f"{cmd_name}_command")
        return command


@click.group(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="pcretrieve")
def cli() -> None:
    """Raw 3D scans of things that bend in, ranked shapes out.

    \b
    pcretrieve ingest scans/ --labels scans/labels.csv --catalogue bodies.sqlite
    pcretrieve query --catalogue bodies.sqlite scan.ply
    """
    logger = logging.getLogger("pcretrieve")
    if not any(isinstance(handler, _Said) for handler in logger.handlers):
        logger.addHandler(_Said(logging.WARNING))


class _Said(logging.Handler):
    """Warnings of the library, for people, but for repairs: results and pages name these."""

    def emit(self, record: logging.LogRecord) -> None:
        if record.name != "pcretrieve.pipeline":
            _say(record.getMessage())


def main() -> NoReturn:
    """Run the command line; the one place where errors become messages and exit codes."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_DFL:  # and not ignored, as under nohup
            signal.signal(number, _stop)
    try:
        code = cli.main(prog_name="pcretrieve", standalone_mode=False)
    except click.exceptions.Abort:
        _say("stopped")
        sys.exit(EXIT_INTERRUPTED)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except OptionError as error:
        # The option is wrong in every stage: the one that noticed tells nothing.
        _say(f"Error: {error.message}")
        sys.exit(EXIT_USAGE)
    except PcretrieveError as error:
        _say(f"Error: {error}")
        sys.exit(EXIT_ERROR)
    except BrokenPipeError:
        # The reader of our output has gone (`pcretrieve list | head`): nothing is left to say.
        sys.stderr.close()
        sys.exit(EXIT_ERROR)
    sys.exit(code if isinstance(code, int) else 0)


def _stop(number: int, frame: FrameType | None) -> NoReturn:
    """Leave in order, so that no worker outlives its parent."""
    sys.exit(EXIT_SIGNAL + number)


def _say(message: str) -> None:
    click.echo(message, err=True)
