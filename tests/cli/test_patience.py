"""What a terminal shows while a command works: the latest message of the library, in one line."""

from __future__ import annotations

import logging
import os
import pty
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
import shapes

import pcretrieve as pr
from pcretrieve.formats import write_mesh
from pcretrieve.matching import MATCHERS, PairwiseIndex, distance_matrix

WORKS = """
import logging, time
from pcretrieve.cli.messages import say, write_line
from pcretrieve.cli.patience import FIRST_WORD, NEXT_WORD, tell_of_waiting

tell_of_waiting("count")
time.sleep(FIRST_WORD + NEXT_WORD / 2)
logging.getLogger("pcretrieve.somewhere").info("counted: 1 of 2 \\033[31m" + 200 * "o")
time.sleep(2 * NEXT_WORD)
say("failed: the second")
write_line("1")
logging.getLogger("pcretrieve.somewhere").info("counted: 2 of 2")
time.sleep(2 * NEXT_WORD)
"""

PATIENCE = 60


def test_the_line_has_the_latest_message_and_makes_place_for_others() -> None:
    terminal, end = pty.openpty()
    known = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "NO_COLOR")}
    program = [sys.executable, "-c", WORKS]
    with subprocess.Popen(program, env=known | {"COLUMNS": "80"}, stdout=end, stderr=end) as running:
        os.close(end)
        text = b""
        with suppress(OSError), os.fdopen(terminal, "rb", buffering=0) as screen:  # the end of a terminal
            while part := screen.read(1000):
                text += part
        running.wait(PATIENCE)
    _, *states = text.decode().split("\r\x1b[K")
    assert states[0].startswith("count: at work, ")
    counted = next(state for state in states if state.startswith("count: counted: 1 of 2 ?[31mooo"))
    assert len(counted) < 80
    assert "2 of 2" not in text.decode(), "nothing is said when results are shown"
    # The line is cleared before the message, which is the whole last line before the result.
    assert states[-1].splitlines() == ["\x1b[31mfailed:\x1b[0m the second", "1"]


def test_long_steps_say_how_far_they_are(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for name in ("a", "b"):
        write_mesh(shapes.ellipsoid((1, 1, 2 + (name == "a")), subdivisions=3), tmp_path / f"{name}.off")
        pr.ingest(tmp_path / f"{name}.off", tmp_path / f"{name}.sqlite", workers=1)
    with caplog.at_level(logging.INFO, "pcretrieve"):
        pr.merge_catalogues([tmp_path / "a.sqlite", tmp_path / "b.sqlite"], tmp_path / "all.sqlite")
        assert caplog.messages[-2:] == ["stored: 1 of 2 shapes", "stored: 2 of 2 shapes"]
        with pr.Catalogue(tmp_path / "all.sqlite") as store:
            distance_matrix(PairwiseIndex(MATCHERS["heat-hausdorff"], ["a", "b"], store.shape))
    assert caplog.messages[-4:] == [
        *("prepared: 1 shapes", "prepared: 2 shapes"),
        *("compared with all: 1 of 2 shapes", "compared with all: 2 of 2 shapes"),
    ]
