"""The README is held to the code: its Python runs, its commands exist."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from click.testing import CliRunner

from pcretrieve.cli.main import COMMANDS, cli

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
DOCUMENTS = README + "".join(
    path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs").rglob("*.md"))
)
PYTHON_BLOCKS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


def commands(text: str) -> list[list[str]]:
    """Indented lines that call pcretrieve, as words; not those of scripts in other languages."""
    text = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    return [
        shlex.split(line, comments=True) for line in re.findall(r"^ {4}(pcretrieve .*)$", text, re.MULTILINE)
    ]


def test_python_blocks_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run in order, in the root of a checkout, on a sample scan and a catalogue of sample scans."""
    samples = sorted((ROOT / "scans" / "person-1").glob("*.ply"))[:2]
    (tmp_path / "scans").symlink_to(ROOT / "scans")
    (tmp_path / "new_scan.ply").symlink_to(samples[0])
    monkeypatch.chdir(tmp_path)
    ingest = ["ingest", *map(str, samples), "--catalogue", "bodies.sqlite", "--workers", "2"]
    assert CliRunner().invoke(cli, ingest).exit_code == 0
    assert PYTHON_BLOCKS
    names: dict[str, object] = {}
    for block in PYTHON_BLOCKS:
        exec(compile(block, "README.md", "exec"), names)


@pytest.mark.parametrize("words", commands(DOCUMENTS), ids=" ".join)
def test_commands_of_the_readme_exist(words: list[str]) -> None:
    """Every option that the README shows is one that the command has."""
    command = words[1:3] if words[1] == "catalogue" else words[1:2]  # the one with commands of its own
    result = CliRunner().invoke(cli, [*command, "--help"])
    assert result.exit_code == 0
    for word in words[2:]:
        if word.startswith("-"):
            assert re.search(rf"(^|[\s,]){re.escape(word)}\b", result.output), word


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_shows_an_example(name: str) -> None:
    """Help ends guessing: what it does, and a line that can be typed."""
    output = CliRunner().invoke(cli, [name, "--help"]).output
    assert f"  pcretrieve {name} " in output


def test_the_readme_is_short() -> None:
    assert README.count("\n") <= 150


def test_every_command_is_in_the_readme() -> None:
    assert [
        name for name in COMMANDS if f"`{name}`" not in README and f"pcretrieve {name} " not in README
    ] == []


def test_every_script_is_in_the_readme() -> None:
    scripts = {path.name for path in (ROOT / "scripts").iterdir()} - {"setup"}
    assert [name for name in sorted(scripts) if f"scripts/{name}" not in DOCUMENTS] == []
