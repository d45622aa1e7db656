"""The entry point of the command line: commands, exit codes, messages of errors.

Results go to standard output, messages for users to standard error. Exit codes: 0 success; 1 error; 2 wrong
usage; 3 finished, but some shapes failed; 130 interrupted by Ctrl-C; 143 by SIGTERM.
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

# Shells report a program that was ended by a signal with this number plus the number of the signal.
EXIT_SIGNAL = 128

# The names of the commands. A command is the function `NAME_command` of the module `NAME`, which is imported
# when the command or its help is called.
COMMANDS = (
    "demo",
    "merge",
    "reconstruct",
    "signature",
    "inspect",
    "ingest",
    "query",
    "evaluate",
    "compare",
    "calibrate",
    "matrix",
    "duplicates",
    "cluster",
    "map",
    "report",
    "list",
    "show",
    "remove",
    "export",
    "options",
)


class _LazyGroup(click.Group):
    """Commands that are imported when they are called, so that ``--help`` does not wait for imports."""

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
    if not any(isinstance(handler, _Printed) for handler in logger.handlers):
        logger.addHandler(_Printed(logging.WARNING))


class _Printed(logging.Handler):
    """Prints warnings of the library on standard error, except for repairs, which are in the provenance."""

    def emit(self, record: logging.LogRecord) -> None:
        if record.name != "pcretrieve.pipeline":
            _say(record.getMessage())


def main() -> NoReturn:
    """Run the command line, and end with an exit code. Errors are printed as messages.

    Returns
    -------
    NoReturn
        Never.
    """
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_DFL:  # not if the signal is ignored, as under nohup
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
        # Without the stage, because options are not the fault of the stage that checks them.
        _say(f"Error: {error.message}")
        sys.exit(EXIT_USAGE)
    except PcretrieveError as error:
        _say(f"Error: {error}")
        sys.exit(EXIT_ERROR)
    except BrokenPipeError:
        # The program that reads the output has ended, as in `pcretrieve list | head`.
        sys.stderr.close()
        sys.exit(EXIT_ERROR)
    sys.exit(code if isinstance(code, int) else 0)


def _stop(number: int, frame: FrameType | None) -> NoReturn:
    """End by SystemExit, so that worker processes are stopped too."""
    sys.exit(EXIT_SIGNAL + number)


def _say(message: str) -> None:
    click.echo(message, err=True)
