"""What helps to type commands: help that fits a screen, suggestions, completion, the environment."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Literal, get_args, get_origin

import click
import pytest
from commands import NAMES, refusal, run

from pcretrieve.cli.main import COMMANDS, cli
from pcretrieve.cli.options import Option
from pcretrieve.options import PipelineOptions, tables
from pcretrieve.plugins import option_texts

MOST_LINES, MOST_OPTIONS, COLUMNS = 40, 10, 80


def shown(*words: str) -> str:
    return run(*words, COLUMNS=str(COLUMNS)).stdout


def options(words: tuple[str, ...]) -> list[click.Option]:
    command: click.Command = cli
    for word in words:
        assert isinstance(command, click.Group)
        command = command.get_command(click.Context(cli), word) or command
    return [one for one in command.params if isinstance(one, click.Option)]


def flags(words: tuple[str, ...]) -> set[str]:
    return {one.opts[0] for one in options(words)}


@pytest.mark.parametrize(
    "words", [(), *(tuple(name.split()) for name in NAMES)], ids=" ".join
)
def test_the_help_fits_a_screen_and_names_and_explains_all_options(
    words: tuple[str, ...],
) -> None:
    short = shown(*words, "--help")
    assert len(short.splitlines()) <= MOST_LINES
    assert max(map(len, short.splitlines())) <= COLUMNS
    if not words:
        lines = short.split("Commands:\n")[1].splitlines()
        assert [line.split()[0] for line in lines] == [*COMMANDS], "one line each"
        return
    assert flags(words) <= {word.rstrip(",") for word in short.split()}
    listed = short.split("Options:")[1].split("More options")[0]
    assert (
        words[0] == "lab"
        or len(re.findall(r"^  -", listed, re.MULTILINE)) <= MOST_OPTIONS
    )
    if "--help-all" in short:
        full = shown(*words, "--help-all")
        assert max(map(len, full.splitlines())) <= COLUMNS
        # Each option begins a line, after its short name.
        begun = [line.split()[:2] for line in full.split("Options:")[1].splitlines()]
        assert flags(words) <= {word.rstrip(",") for line in begun for word in line}
        assert "More options" not in full
    else:
        assert "More options" not in short


def test_options_of_the_pipeline_have_its_texts_its_defaults_and_its_values() -> None:
    """These are written once, in `options/tables.py`."""
    texts = option_texts(Path(str(tables.__file__)).read_text("utf-8"))
    seen = {}
    for command in NAMES:
        words = tuple(command.split())
        setting = [one for one in options(words) if isinstance(one, Option) and one.sets]
        full = " ".join(shown(*words, "--help-all").split()) if setting else ""
        for one in setting:
            text, default = texts[one.sets]
            # The help breaks names at their hyphens.
            assert "".join(text.split()) in full.replace(" ", ""), (command, one.name)
            assert default.replace(" ", "") in full.replace(" ", "")
            seen[one.sets] = one.type
    for name, kind in seen.items():
        table, _, option = name.partition(".")
        annotation = (
            type(getattr(PipelineOptions(), table)).model_fields[option].annotation
        )
        if get_origin(annotation) is Literal:
            assert isinstance(kind, click.Choice) or name == "retrieval.whitening"
        if isinstance(kind, click.Choice):
            # Nobody types a unit to say that there is none.
            assert {*get_args(annotation)} - {*kind.choices} <= {"none"}, name
            assert {*kind.choices} <= {*get_args(annotation)}, name
    assert len(seen) >= 15


def test_the_environment_names_the_catalogue(eggs: Path, tmp_path: Path) -> None:
    """The option, where it is given, has priority."""
    path = str(eggs)
    listed = run("list", PCRETRIEVE_CATALOGUE=path).stdout
    assert (
        listed
        == run(
            "list", "-c", path, PCRETRIEVE_CATALOGUE=str(tmp_path / "absent.sqlite")
        ).stdout
    )
    run("list", PCRETRIEVE_CATALOGUE=None, code=2)
    for words in (("status",), ("catalogue", "check")):
        assert (
            run(*words, PCRETRIEVE_CATALOGUE=path).stdout
            == run(*words, "-c", path).stdout
            != ""
        )
        run(*words, PCRETRIEVE_CATALOGUE=None, code=2)


def test_a_similar_name_is_suggested(eggs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PCRETRIEVE_CATALOGUE", str(eggs))
    for words, said in (
        ("qurey a", "there is no command 'qurey'; did you mean 'query'?"),
        ("list --faild", "did you mean '--failed'?"),
        (
            "show egg01",
            "holds no shape 'egg01'; `pcretrieve list` names them; did you mean 'Egg01'?",
        ),
        (
            "query Egg00 --filter label=kind1",
            "`pcretrieve list` shows the classes; did you mean '<kind 1>'?",
        ),
        ("query Egg00 --filter cat", "must be label=CLASS, got 'cat'"),
        ("query Ego00", "no file and no shape of"),
        ("query Ego00", "did you mean 'Egg00'?"),
        (
            "lab options --config bodyscanner",
            "there is no preset or file 'bodyscanner'; the presets are body-scanner, handheld, depth-camera, "
            "clean-mesh, paper, classic; did you mean 'body-scanner'?",
        ),
        ("query Egg00 --method hpat", "did you mean 'hapt'?"),
        ("query Egg00 --method hapt+wsk", "did you mean 'wks'?"),
        ("query Egg00 --whitening peple", "did you mean 'people'?"),
        ("query Egg0", "did you mean 'Egg00'?"),
        (
            "query Egg00 --filter label=kind --filter label=<kind_1>",
            "did you mean '<kind 1>'?",
        ),
        ("ingest c.sqlit", "no file or folder c.sqlit"),
        ("list --catalog c.sqlite", "did you mean"),
        ("evaluate --labels shrec1", "did you mean 'shrec11'?"),
    ):
        assert said.lower() in refusal(*words.split()).lower()


def test_the_shell_completes(eggs: Path) -> None:
    for typed, completed in (
        ("show Egg1", ["Egg10", "Egg11", "Egg12", "Egg13"]),
        ("query b", ["broken"]),
        ("query Egg00 --filter l", [f"label=<kind {number}>" for number in range(3)]),
        ("query --config de", ["depth-camera"]),
        ("query --method hks-bow-", ["hks-bow-spatial"]),
        ("dup", ["duplicates"]),
    ):
        words = f"pcretrieve {typed}"
        environment = {
            "_PCRETRIEVE_COMPLETE": "bash_complete",
            "COMP_WORDS": words,
            "COMP_CWORD": str(len(words.split()) - 1),
            "PCRETRIEVE_CATALOGUE": str(eggs),
        }
        program = [sys.executable, "-m", "pcretrieve"]
        done = subprocess.run(
            program,
            env=os.environ | environment,
            capture_output=True,
            text=True,
            check=True,
        )
        assert [line.partition(",")[2] for line in done.stdout.splitlines()] == completed
