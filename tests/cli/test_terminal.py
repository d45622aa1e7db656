"""Standard streams: what a terminal shows, what a program reads, and what is closed or full."""

from __future__ import annotations

import csv
import fcntl
import io
import json
import os
import pty
import re
import struct
import subprocess
import sys
import termios
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
import shapes
from commands import refusal, result, run

from pcretrieve import Catalogue, Grade, PipelineOptions, backup, describe, process
from pcretrieve.catalogue import Content, Record
from pcretrieve.cli import messages
from pcretrieve.cli.output import write_table
from pcretrieve.cli.search import SAID
from pcretrieve.formats import write_mesh

COLUMNS = 80
DEEP = "/".join(f"a-folder-with-a-long-name-{number}" for number in range(4))
REASON = "gaps: " + " ".join(["some are wide, others are wider"] * 4)
FULL = Path("/dev/full")  # a device without space
needs_full = pytest.mark.skipif(
    not FULL.exists(), reason="needs a device without space, /dev/full"
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three ellipsoids in deep folders, one of them incomplete, and a failure."""
    place, options = tmp_path_factory.mktemp("tables").resolve(), PipelineOptions()
    with Catalogue(place / "c.sqlite", create=True) as store:
        for number, grade in enumerate(
            (Grade("good", 0.1), Grade("incomplete", 0.4, (REASON,)), None)
        ):
            shape = process(shapes.ellipsoid((1, 0.6 + 0.1 * number, 0.5), 3), options)
            values = describe(shape, options.signature).values
            path = str(place / DEEP / f"egg{number}.off")
            record = Record(f"egg{number}", path, f"hash {number}", label="egg")
            store.put(record, Content(replace(shape, grade=grade), values))
        store.put(
            Record(
                "bad",
                str(place / "bad.off"),
                "",
                status="failed",
                stage="read",
                message="no scan",
            )
        )
    return place


def on_terminal(
    folder: Path,
    *words: str,
    says: bool = False,
    code: int = 0,
    program: str = "",
    types: str = "",
    **environment: str,
) -> str:
    """What a terminal of 80 columns gets, with its codes; messages too, if the command `says` them.

    types: what somebody types at it.
    """
    ours, theirs = pty.openpty()
    os.write(ours, types.encode())
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, COLUMNS, 0, 0))
    known = {
        name: value
        for name, value in os.environ.items()
        if name not in ("COLUMNS", "NO_COLOR")
    }
    command = [
        sys.executable,
        *(("-c", program) if program else ("-m", "pcretrieve", *words)),
    ]
    errors = theirs if says else subprocess.DEVNULL
    with subprocess.Popen(
        command,
        stdin=theirs,
        stdout=theirs,
        stderr=errors,
        cwd=folder,
        env=known | environment,
    ) as running:
        os.close(theirs)
        text = b""
        with (
            suppress(OSError),
            os.fdopen(ours, "rb", buffering=0) as screen,
        ):  # the other end is closed
            while part := screen.read(4096):
                text += part
    assert running.returncode == code
    return text.decode()


def plain(line: str) -> str:
    return re.sub(r"\x1b\[[0-9;]*m", "", line)


def screen(text: str) -> list[str]:
    """The lines that a terminal shows in the end, without colours."""
    lines, row, column = [""], 0, 0
    for part in re.split(r"(\r|\n|\x1b\[[0-9;]*[A-Za-z])", text):
        if part == "\n":
            row, column = row + 1, 0
            lines += [""] * (row == len(lines))
        elif part == "\r":
            column = 0
        elif part.startswith("\x1b") and part.endswith("A"):
            row -= int(part[2:-1])
        elif part == "\x1b[2K":
            lines[row] = ""
        elif not part.startswith("\x1b"):
            line = lines[row].ljust(column)
            lines[row] = line[:column] + part + line[column + len(part) :]
            column += len(part)
    return [line.rstrip() for line in lines if line.strip()]


# --- tables ---------------------------------------------------------------------------------------------


def test_nothing_is_wider_than_the_terminal(folder: Path) -> None:
    shown = {}
    for words in (
        "list",
        "list --incomplete",
        "list --failed",
        "query egg0",
        "show egg1",
    ):
        lines = on_terminal(folder, *words.split(), "-c", "c.sqlite").splitlines()
        assert max(len(plain(line)) for line in lines) <= COLUMNS
        shown[words] = " ".join(" ".join(map(plain, lines)).split())
    for words in ("list", "query egg0"):
        # There is no place for the column of files.
        assert (
            "egg2" in shown[words]
            and "FILE" not in shown[words]
            and ".off" not in shown[words]
        )
    incomplete = shown["list --incomplete"]
    assert incomplete.count("wider") + incomplete.count("others") == 2 * REASON.count(
        "wider"
    )
    # A path that is a result is not broken, so that a page can be opened from the terminal.
    page = f"{'a page with blanks ' * 5}.html"
    assert (
        on_terminal(folder, "lab", "map", "-c", "c.sqlite", "-o", page).splitlines()[-1]
        == page
    )


def test_ids_are_whole_however_narrow_the_terminal_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    long = "a-very-long-name-of-a-scan-that-somebody-will-copy"
    columns = {"ID": "text", "FILE": "path", "REASON": "words"}
    for width, headings in ((20, ["ID", "REASON"]), (120, ["ID", "FILE", "REASON"])):
        monkeypatch.setenv("COLUMNS", str(width))
        write_table(columns, [(long, f"{long}.ply"[-30:], REASON)])
        first, second, *_ = map(plain, capsys.readouterr().out.splitlines())
        assert first.split() == headings
        assert second.split()[0] == long
    # So are the names of several queries, without which nobody knows whose the answers are.
    monkeypatch.setenv("COLUMNS", "20")
    write_table(SAID, [(long, "sure", "cat", "0.99")])
    assert long in capsys.readouterr().out


def test_several_shapes_are_removed_after_a_question(
    folder: Path, tmp_path: Path
) -> None:
    """Not one shape, and not where nobody can answer, or with --yes."""
    catalogue = tmp_path / "c.sqlite"
    run("catalogue", "backup", folder / "c.sqlite", catalogue)
    words = ("remove", "egg0", "egg1", "-c", "c.sqlite")
    said = on_terminal(tmp_path, *words, says=True, code=1, types="n\n")
    assert (
        "Remove 2 shapes from c.sqlite? [y/N]" in said and "nothing was removed" in said
    )
    assert (
        "would remove 2 from"
        in run("remove", "egg0", "egg1", "-c", catalogue, "--dry-run").stderr
    )
    assert [row["id"] for row in result("list", "-c", catalogue)] == [
        "bad",
        "egg0",
        "egg1",
        "egg2",
    ]
    assert "Remove" not in on_terminal(
        tmp_path, "remove", "bad", "-c", "c.sqlite", says=True
    )
    assert "removed 2 from" in on_terminal(tmp_path, *words, says=True, types="y\n")
    assert [row["id"] for row in result("list", "-c", catalogue)] == ["egg2"]
    run("catalogue", "backup", folder / "c.sqlite", tmp_path / "d.sqlite")
    yes = ("remove", "egg0", "egg1", "-c", "d.sqlite", "--yes")
    assert "Remove" not in on_terminal(tmp_path, *yes, says=True)
    run("remove", "bad", "egg2", "-c", tmp_path / "d.sqlite")
    assert result("list", "-c", tmp_path / "d.sqlite") == []


def test_messages_are_broken_between_words(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a terminal; elsewhere each is one line."""
    monkeypatch.chdir(folder)
    query = ("query", "-c", "c.sqlite", "egg0")
    asked = (*query, "--filter", "label=eggs")
    lines = screen(on_terminal(folder, *asked, says=True, code=1))
    assert len(lines) == 2
    assert max(map(len, lines)) <= COLUMNS
    assert " ".join(lines) == f"Error: {run(*asked, code=1).exception}"


def test_programs_get_whole_values_under_headings(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    lines = run("list", "-c", "c.sqlite").stdout.splitlines()
    assert lines[0].split() == ["ID", "GRADE", "CLASS", "ERROR", "FILE", "REASON"]
    assert [line.split()[4:] for line in lines[1:]] == [
        ["bad.off", "no", "scan"],
        [f"{DEEP}/egg0.off"],
        [f"{DEEP}/egg1.off", *REASON.split()],
        [f"{DEEP}/egg2.off"],
    ]
    row = run("list", "-c", "c.sqlite", "--incomplete").stdout
    assert row.endswith(f"  incomplete, may answer wrongly: {REASON}\n")
    rows = run("query", "-c", "c.sqlite", "egg0").stdout.splitlines()
    assert rows[0].split() == ["RANK", "DISTANCE", "SCORE", "CLASS", "ID", "FILE", "SCAN"]
    assert [
        line[line.index("incomplete") :] for line in rows if "incomplete" in line
    ] == ["incomplete"]
    starts = {
        line.index(word) for line, word in zip(rows, ("FILE", *[DEEP] * 3), strict=False)
    }
    assert len(starts) == 1, "columns are aligned"
    assert not any("\x1b" in line for line in (*lines, *rows))


def test_the_worst_scans_are_the_first(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PCRETRIEVE_CATALOGUE", str(tmp_path / "marked.sqlite"))
    backup(folder / "c.sqlite", tmp_path / "marked.sqlite")
    order = ["bad", "egg1", "egg0", "egg2"]
    for words, expected in (
        ("--worst 9", order),
        ("--worst 2", order[:2]),
        ("--sort error --offset 1", order[1:]),
        ("--worst 2 --class egg", order[1:3]),
        ("--sort class", ["egg0", "egg1", "egg2", "bad"]),
    ):
        assert [row["id"] for row in result("list", *words.split())] == expected, words
    assert "MARK" not in run("list").stdout
    run("mark", "egg1", "bad", "rescan", "a, foot")
    run("mark", "egg0", "accept")
    rows = list(csv.reader(io.StringIO(run("list", "--worst", 3, "--csv").stdout)))
    bad, egg1, egg0 = (dict(zip(rows[0], row, strict=True)) for row in rows[1:])
    assert (bad["error"], bad["reason"], bad["stage"]) == ("", "no scan", "read")
    assert (egg1["error"], egg1["reason"]) == ("0.40", REASON)
    assert (egg1["mark"], egg1["note"]) == ("rescan", "a, foot")
    assert (egg0["mark"], egg0["note"], egg0["path"][-8:]) == ("accept", "", "egg0.off")
    table = run("list", "--marked", "rescan", "--worst", 5).stdout.splitlines()
    assert [line.split()[:2] for line in table[1:]] == [
        ["bad", "rescan"],
        ["egg1", "rescan"],
    ]
    assert table[2].endswith(f"a, foot; {REASON}")
    run("mark", "bad", "egg1", "--clear")
    assert [row["id"] for row in result("list", "--marked", "any")] == ["egg0"]
    assert "write rescan, accept or note" in refusal("mark", "egg1")
    assert "choose one" in refusal("list", "--csv", "--json")


def test_colours_are_for_terminals_that_want_them(folder: Path) -> None:
    asked = ("list", "-c", "c.sqlite")
    coloured = on_terminal(folder, *asked).splitlines()
    without = on_terminal(folder, *asked, NO_COLOR="1").splitlines()
    assert "\x1b[33mincomplete" in coloured[3]
    assert "\x1b[31mfailed" in coloured[1]
    assert not any("\x1b" in line for line in without)
    assert [plain(line).rstrip() for line in coloured] == without


def test_wide_characters_take_two_columns(capsys: pytest.CaptureFixture[str]) -> None:
    rows = [("猫", "cat"), ("é", "e"), ("a\u0301", "a"), ("dog", "dog")]
    write_table({"ID": "text", "NAME": "text"}, rows)
    assert (
        capsys.readouterr().out == "ID   NAME\n猫   cat\né    e\na\u0301    a\ndog  dog\n"
    )


# --- waiting --------------------------------------------------------------------------------------------

WORKS = """
import logging, time
from pcretrieve.cli import messages
from pcretrieve.cli.output import write_lines

messages.FIRST_WORD = messages.NEXT_WORD = 0.3  # seconds
messages.tell_of_waiting("count")
time.sleep(1)
logging.getLogger("pcretrieve.somewhere").info("counted: 1 of 2 \\033[31m" + 200 * "o")
time.sleep(1)
messages.say("failed: the second")
write_lines("1")
logging.getLogger("pcretrieve.somewhere").info("counted: 2 of 2")
time.sleep(1)
"""


def test_the_line_of_waiting_has_the_latest_message_and_makes_place_for_others(
    tmp_path: Path,
) -> None:
    shown = on_terminal(tmp_path, program=WORKS, says=True)
    states = [plain(state).strip() for state in shown.replace("\n", "\r").split("\r")]
    assert any(state.startswith("count: at work, ") for state in states)
    counted = next(
        state
        for state in states
        if state.startswith("count: counted: 1 of 2 \\u001b[31mooo")
    )
    assert len(counted) <= COLUMNS
    assert "2 of 2" not in shown, "nothing is said when results are shown"
    assert "\x1b[31mfailed:\x1b[0m the second" in shown
    assert screen(shown) == ["failed: the second", "1"], "the line makes place"
    assert "\x1b[?25l" not in shown, "a program that is killed leaves the cursor"


BATCH = """
import time
from pcretrieve.cli import messages

with messages.Progress("ingest") as shown:
    shown.start(3)
    time.sleep(1.5)
    shown.advance({})
    shown.advance({}, "failed: [egg / read] " + 9 * "a-long-name" + ".off")
    time.sleep(1.5)
messages.say("done")
"""


def test_a_bar_stays_below_messages_which_are_whole(tmp_path: Path) -> None:
    shown = on_terminal(tmp_path, program=BATCH, says=True)
    states = [state for state in plain(shown).splitlines() if "scans" in state]
    assert any("0 of 3 scans, 0 failed, after " in state for state in states)
    *failed, bar, done = screen(shown)
    assert failed == ["failed: [egg / read]", 9 * "a-long-name" + ".off"], "not cut"
    assert done == "done"
    words = r"ingest ━+[╸╺]?━+ 2 of 3 scans, 1 failed, after \d s, \d s left"
    assert re.fullmatch(words, bar) and len(bar) <= COLUMNS


def test_progress_is_a_line_a_minute_in_a_log_file(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(messages, "LINE_INTERVAL", 0.3)
    with messages.Progress("ingest") as progress:
        progress.start(4)
        progress.advance({})
        time.sleep(0.4)
        progress.advance({})
        progress.advance({})
    assert capsys.readouterr().err.splitlines() == [
        "ingest: 4 scans",
        "ingest: 2 of 4 scans, 0 failed, after 0 s, 0 s left",
    ]


# --- streams that are closed, or on a full disk ---------------------------------------------------------


def redirected(folder: Path, command: str) -> subprocess.CompletedProcess[str]:
    """Run a command with redirections by the shell."""
    program = f"{sys.executable} -m pcretrieve {command}"
    return subprocess.run(
        ["/bin/sh", "-c", program],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.parametrize(
    "redirection", ["0<&- 2>&-", ">&-", pytest.param(f"2>{FULL}", marks=needs_full)]
)
def test_what_cannot_be_printed_ends_no_batch(redirection: str, tmp_path: Path) -> None:
    """Neither messages nor results, of one good scan and one that fails."""
    (tmp_path / "scans").mkdir()
    write_mesh(
        shapes.ellipsoid((1, 1, 2), subdivisions=3), tmp_path / "scans" / "egg.off"
    )
    (tmp_path / "scans" / "flat.xyz").write_text("1 2 3\n" * 200)
    done = redirected(tmp_path, f"ingest scans -c c.sqlite --json {redirection}")
    assert done.returncode == 3, done
    if redirection == ">&-":
        assert "1 done, 1 failed" in done.stderr and "Traceback" not in done.stderr
        return
    answer = json.loads(done.stdout)["result"]
    assert answer["done"] == ["egg"]
    assert [failure["id"] for failure in answer["failed"]] == ["flat"]


@needs_full
def test_results_that_cannot_be_printed_are_an_error(tmp_path: Path) -> None:
    done = redirected(tmp_path, f"lab options >{FULL}")
    assert done.returncode == 1
    assert done.stderr == (
        "Error: cannot print the result: No space left on device; print it to another place\n"
    )
