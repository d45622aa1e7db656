"""What helps to type names: the catalogue of the environment, suggestions, and completion by the shell."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import shapes
from click.testing import CliRunner, Result

from pcretrieve import Catalogue
from pcretrieve.catalogue import Content, Record
from pcretrieve.cli.main import cli
from pcretrieve.descriptors import describe
from pcretrieve.options import PipelineOptions
from pcretrieve.pipeline.process import process

OPTIONS = PipelineOptions()


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    shape = process(shapes.icosphere(2), OPTIONS)
    with Catalogue(tmp_path_factory.mktemp("names") / "c.sqlite", create=True) as store:
        for name, label in (("cat0", "cat"), ("cat1", "cat"), ("dog0", "dog")):
            content = Content(shape, describe(shape, OPTIONS.signature).values)
            store.put(Record(name, f"/{name}.off", name, label=label), content)
    return Path(store.location)


def run(*arguments: object, catalogue: Path | None = None) -> Result:
    environment = {"PCRETRIEVE_CATALOGUE": str(catalogue) if catalogue else None}
    return CliRunner().invoke(cli, [str(word) for word in arguments], env=environment)


def test_the_environment_names_the_catalogue(path: Path, tmp_path: Path) -> None:
    """The option, where it is given, has priority."""
    listed = run("list", catalogue=path)
    assert listed.exit_code == 0
    assert listed.stdout == run("list", "-c", path, catalogue=tmp_path / "absent.sqlite").stdout
    assert run("list").exit_code == 2
    for command in ("status", "check"):
        assert run(command, catalogue=path).stdout == run(command, path).stdout != ""
        assert run(command).exit_code == 2
    assert "failed" in str(run("retry", catalogue=path).exception)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("qurey a", "there is no command 'qurey'; did you mean 'query'?"),
        ("list --faield", "did you mean '--failed'?"),
        ("show Cat1", "holds no shape 'Cat1'; `pcretrieve list` names them; did you mean 'cat1'?"),
        ("query cat0 --filter label=ct", "`pcretrieve list` shows the classes; did you mean 'cat'?"),
        ("query dgo0", "no file and no shape of"),
        ("query dgo0", "did you mean 'dog0'?"),
        (
            "options --config bodyscanner",
            "there is no preset or file 'bodyscanner'; the presets are body-scanner, handheld, depth-camera, "
            "clean-mesh, paper, classic; did you mean 'body-scanner'?",
        ),
        ("query cat0 --method hpat", "did you mean 'hapt'?"),
    ],
)
def test_a_similar_name_is_suggested(words: str, said: str, path: Path) -> None:
    result = run(*words.split(), catalogue=path)
    assert result.exit_code != 0
    message = result.stderr or str(result.exception)
    assert said.lower() in message.lower()


@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        ("show c", ["cat0", "cat1"]),
        ("query d", ["dog0"]),
        ("query cat0 --filter l", ["label=cat", "label=dog"]),
        ("query --config de", ["depth-camera"]),
        ("query --method hks-bow-", ["hks-bow-spatial"]),
        ("dup", ["duplicates"]),
    ],
)
def test_the_shell_completes(typed: str, completed: list[str], path: Path) -> None:
    words = f"pcretrieve {typed}"
    environment = {
        "_PCRETRIEVE_COMPLETE": "bash_complete",
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split()) - 1),
        "PCRETRIEVE_CATALOGUE": str(path),
    }
    done = subprocess.run(
        [sys.executable, "-m", "pcretrieve"],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert [line.partition(",")[2] for line in done.stdout.split()] == completed
