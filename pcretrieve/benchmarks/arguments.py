"""Command-line arguments that several benchmarks share."""

from __future__ import annotations

import argparse
from pathlib import Path

__all__ = ["add_data", "argument_parser", "positive"]


def argument_parser(description: str | None, epilog: str | None = None) -> argparse.ArgumentParser:
    """A parser whose help prints the description, a module's docstring, with its line breaks.

    Parameters
    ----------
    description : str or None
        What the program does.
    epilog : str, optional
        Text below the list of arguments.

    Returns
    -------
    argparse.ArgumentParser
        The parser, without arguments.
    """
    return argparse.ArgumentParser(
        description=description, epilog=epilog, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def add_data(parser: argparse.ArgumentParser) -> None:
    """Add ``--data``, the folder that has a subfolder for each data set.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Changed in place.
    """
    parser.add_argument(
        "--data",
        type=Path,
        default=Path("data"),
        metavar="FOLDER",
        help="folder of the data sets (default: %(default)s)",
    )


def positive(text: str) -> int:
    """An integer of at least 1, as the type of an argument.

    Parameters
    ----------
    text : str
        The argument, as it was typed.

    Returns
    -------
    int
        The integer.

    Raises
    ------
    argparse.ArgumentTypeError
        If the integer is smaller.
    ValueError
        If `text` is not an integer.
    """
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1, got {number}")
    return number
