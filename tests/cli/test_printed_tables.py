"""Tables: what a program reads is complete, what a terminal shows fits its width."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
import shapes
from click.testing import CliRunner

from pcretrieve import Catalogue
from pcretrieve.catalogue import Content, Record
from pcretrieve.cli.main import cli
from pcretrieve.cli.output import Column, write_table
from pcretrieve.descriptors import describe
from pcretrieve.options import PipelineOptions
from pcretrieve.pipeline.process import process
from pcretrieve.values import Verdict

OPTIONS = PipelineOptions()
COLUMNS = 80
DEEP = "/".join(f"a-folder-with-a-long-name-{number}" for number in range(4))
REASON = "gaps: " + " ".join(["some are wide, others are wider"] * 4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three ellipsoids in deep folders, one of them doubtful, and a failure."""
    place = tmp_path_factory.mktemp("tables").resolve()
    with Catalogue(place / "c.sqlite", create=True) as store:
        for number, verdict in enumerate((Verdict("sound", 0.1), Verdict("doubtful", 0.4, (REASON,)), None)):
            shape = process(shapes.ellipsoid((1, 0.6 + 0.1 * number, 0.5), 3), OPTIONS)
            values = describe(shape, OPTIONS.signature).values
            path = str(place / DEEP / f"egg{number}.off")
            record = Record(f"egg{number}", path, f"hash {number}", label="egg")
            store.put(record, Content(replace(shape, verdict=verdict), values))
        store.put(Record("bad", str(place / "bad.off"), "", status="failed", stage="read", message="no scan"))
    return place


def on_terminal(
    folder: Path, *words: str, says: bool = False, code: int = 0, **environment: str
) -> list[str]:
    """The lines that a terminal of 80 columns gets, with their codes; messages too, if it `says` them."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, COLUMNS, 0, 0))
    known = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "NO_COLOR")}
    command = [sys.executable, "-m", "pcretrieve", *words]
    with subprocess.Popen(
        command,
        stdin=theirs,
        stdout=theirs,
        stderr=theirs if says else subprocess.DEVNULL,
        cwd=folder,
        env=known | environment,
    ) as process:
        os.close(theirs)
        text = b""
        while True:
            try:
                part = os.read(ours, 4096)
            except OSError:  # the other end is closed
                break
            if not part:
                break
            text += part
    os.close(ours)
    assert process.returncode == code
    return text.decode().splitlines()


def plain(line: str) -> str:
    return re.sub(r"\x1b\[[0-9;]*m", "", line)


def piped(folder: Path, monkeypatch: pytest.MonkeyPatch, *words: str) -> list[str]:
    monkeypatch.chdir(folder)
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 0, done.output
    return done.stdout.splitlines()


LISTS = [("list",), ("list", "--doubtful"), ("list", "--failed"), ("query", "egg0"), ("show", "egg1")]


@pytest.mark.parametrize("words", LISTS, ids=" ".join)
def test_nothing_is_wider_than_the_terminal(folder: Path, words: Sequence[str]) -> None:
    lines = on_terminal(folder, *words, "-c", "c.sqlite")
    assert max(len(plain(line)) for line in lines) <= COLUMNS
    shown = " ".join(" ".join(map(plain, lines)).split())
    if words in (("list",), ("query", "egg0")):
        # A path is relative, and keeps its name, when it is shortened.
        assert re.search(r"a-fol[\w-]*…[\w/-]*/egg2\.off", shown), shown
        assert str(folder) not in shown
    if words == ("list", "--doubtful"):
        assert shown.count("wider") + shown.count("others") == 2 * REASON.count("wider")


def test_messages_are_broken_between_words(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a terminal; elsewhere each is one line."""
    asked = ("query", "-c", "c.sqlite", "egg0", "--filter", "label=eggs")
    lines = on_terminal(folder, *asked, says=True, code=1, NO_COLOR="1")
    monkeypatch.chdir(folder)
    error = CliRunner().invoke(cli, asked).exception
    assert len(lines) == 2
    assert max(map(len, lines)) <= COLUMNS
    assert " ".join(lines) == f"Error: {error}"
    # The verdict of a query is on standard output.
    verdict = CliRunner().invoke(cli, ["query", "-c", "c.sqlite", "egg0"]).stdout.splitlines()[-1]
    shown = on_terminal(folder, "query", "-c", "c.sqlite", "egg0", COLUMNS="40")[-2:]
    assert max(map(len, shown)) <= 40
    assert " ".join(shown) == verdict


def test_paths_are_not_broken(folder: Path) -> None:
    """So that a page can be opened from the terminal."""
    page = f"{'a page with blanks ' * 5}.html"
    assert on_terminal(folder, "map", "-c", "c.sqlite", "-o", page)[-1] == page


def test_programs_get_whole_values_under_headings(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = piped(folder, monkeypatch, "list", "-c", "c.sqlite")
    assert lines[0].split() == ["ID", "VERDICT", "CLASS", "EULER", "SECONDS", "FILE"]
    assert [line.split()[-1] for line in lines[1:]] == ["bad.off", *(f"{DEEP}/egg{n}.off" for n in range(3))]
    (_, row) = piped(folder, monkeypatch, "list", "-c", "c.sqlite", "--doubtful")
    assert row.endswith(f"  doubtful, ± 0.4: {REASON}")
    rows = piped(folder, monkeypatch, "query", "-c", "c.sqlite", "egg0")
    assert rows[0].split() == ["RANK", "DISTANCE", "SCORE", "CLASS", "ID", "FILE", "VERDICT"]
    assert [line[line.index("doubtful") :] for line in rows if "doubtful" in line] == ["doubtful, ± 0.4"]
    starts = {line.index(word) for line, word in zip(rows, ("FILE", *[DEEP] * 3), strict=False)}
    assert len(starts) == 1, "columns are aligned"
    assert not any("\x1b" in line for line in (*lines, *rows))


def test_colours_are_for_terminals_that_want_them(folder: Path) -> None:
    asked = ("list", "-c", "c.sqlite")
    coloured, without = on_terminal(folder, *asked), on_terminal(folder, *asked, NO_COLOR="1")
    assert "\x1b[33mdoubtful" in coloured[3]
    assert "\x1b[31mfailed" in coloured[1]
    assert not any("\x1b" in line for line in without)
    assert [plain(line).rstrip() for line in coloured] == without


def test_wide_characters_take_two_columns(capsys: pytest.CaptureFixture[str]) -> None:
    write_table((Column("ID"), Column("NAME")), [("猫", "cat"), ("é", "e"), ("a\u0301", "a"), ("dog", "dog")])
    assert capsys.readouterr().out == "ID   NAME\n猫   cat\né    e\na\u0301    a\ndog  dog\n"
