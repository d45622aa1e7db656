"""What a terminal shows while a command works: the latest message of the library, in one line."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from contextlib import suppress

WORKS = """
import logging, time
from pcretrieve.cli.messages import FIRST_WORD, NEXT_WORD, say, tell_of_waiting
from pcretrieve.cli.output import write_line

tell_of_waiting("count")
time.sleep(FIRST_WORD + NEXT_WORD)
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
    shown = text.decode()
    states = [state.strip() for state in shown.replace("\n", "\r").split("\r")]
    assert any(state.startswith("count: at work, ") for state in states)
    counted = next(state for state in states if state.startswith("count: counted: 1 of 2 ?[31mooo"))
    assert len(counted) < 80
    assert "2 of 2" not in shown, "nothing is said when results are shown"
    assert "\x1b[31mfailed:\x1b[0m the second" in states
    assert [state for state in states if state][-1] == "1"
    assert "\r" + " " * 60 in shown[: shown.index("failed:")], "the line is cleared before the message"
