"""The help of each command fits a screen, and `--help-all` leaves no option out."""

from __future__ import annotations

from collections.abc import Iterator

import click
import pytest
from click.testing import CliRunner

from pcretrieve.cli.main import COMMANDS, cli

MOST_LINES = 40
COLUMNS = 80

NAMES = [(name,) for name in COMMANDS] + [("catalogue", "merge")]


def shown(*words: str) -> str:
    done = CliRunner().invoke(cli, words, terminal_width=COLUMNS, prog_name="pcretrieve")
    assert done.exit_code == 0, done.output
    return done.output


def found(words: tuple[str, ...]) -> click.Command:
    command: click.Command = cli
    for word in words:
        assert isinstance(command, click.Group)
        inner = command.get_command(click.Context(cli), word)
        assert inner is not None
        command = inner
    return command


def flags(words: tuple[str, ...]) -> Iterator[str]:
    for parameter in found(words).params:
        if isinstance(parameter, click.Option):
            yield parameter.opts[0]


@pytest.mark.parametrize("words", [(), *NAMES], ids=" ".join)
def test_the_help_fits_a_screen(words: tuple[str, ...]) -> None:
    lines = shown(*words, "--help").splitlines()
    assert len(lines) <= MOST_LINES
    assert max(map(len, lines)) <= COLUMNS


@pytest.mark.parametrize("words", NAMES, ids=" ".join)
def test_all_options_are_named_and_explained(words: tuple[str, ...]) -> None:
    short = shown(*words, "--help")
    assert {*flags(words)} <= {word.rstrip(",") for word in short.split()}
    if "--help-all" in short:
        full = shown(*words, "--help-all")
        assert max(map(len, full.splitlines())) <= COLUMNS
        # Each option begins a line, after its short name.
        lines = [line.split()[:2] for line in full.split("Options:")[1].splitlines()]
        assert {*flags(words)} <= {word.rstrip(",") for line in lines for word in line}
        assert "More options" not in full
    else:
        assert "More options" not in short


def test_the_list_has_all_commands_in_one_line_each() -> None:
    lines = shown("--help").split("Commands:\n")[1].splitlines()
    assert [line.split()[0] for line in lines] == [*COMMANDS]
