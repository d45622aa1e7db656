"""The benchmark of the search page asks a real server."""

from __future__ import annotations

import re

import pytest

from pcretrieve.benchmarks.server import main

pytest.importorskip("starlette", reason="starlette is not installed (the extra web)")


def test_answers_of_all_clients_are_timed(capfd: pytest.CaptureFixture[str]) -> None:
    main(["--shapes", "200", "--parallel", "3", "--queries", "2"])
    lines = capfd.readouterr().out
    assert re.search(r"3 at a time, time of the server +median \d+, p95 \d+, most \d+ ms", lines), lines
    assert re.search(r"3 at a time +\d+ queries/s", lines), lines
