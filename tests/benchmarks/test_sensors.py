"""The benchmark of scans as sensors make them runs, and says which sets are missing."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "scripts" / "benchmark_sensors"


def printed(data: Path, *arguments: str) -> list[str]:
    """The lines below the head of the table; in a process of its own, which is confined to one core."""
    ended = subprocess.run(
        [sys.executable, SCRIPT, "--data", data, *arguments], capture_output=True, text=True
    )
    assert ended.returncode == 0, ended.stderr
    head, *lines = ended.stdout.splitlines()
    assert head.split() == ["figure", "asked", "measured"]
    return lines


def test_people_without_soles_are_held_against_their_whole_scans(tmp_path: Path) -> None:
    error, floods = printed(tmp_path, "--only", "people", "--limit", "2")
    assert error.startswith("2 people without soles and seats")
    assert 0 < float(error.split()[-1]) < 0.5
    assert floods.split()[-1] in ("0%", "50%", "100%")


@pytest.mark.parametrize("part", ["bunny", "dragon"])
def test_a_set_that_is_not_there_is_said(part: str, tmp_path: Path) -> None:
    assert printed(tmp_path, "--only", part) == [
        f"{part}: left out, {tmp_path / f'stanford_{part}'} is not there"
    ]
