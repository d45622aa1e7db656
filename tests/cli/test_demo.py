"""The demonstration runs from the package alone, and its commands can be repeated by hand."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote, urlparse

import pytest
from click.testing import CliRunner

from pcretrieve.cli.main import cli
from pcretrieve.errors import InputError
from pcretrieve.simulation.samples import DEMO_QUERY


@pytest.mark.slow
def test_the_demonstration_finds_whose_the_new_scan_is(tmp_path: Path) -> None:
    """Outside a checkout, in a folder that has to be made and whose name has to be quoted."""
    folder = "my demo"
    ended = subprocess.run(
        [sys.executable, "-m", "pcretrieve", "demo", folder], capture_output=True, text=True, cwd=tmp_path
    )
    assert ended.returncode == 0, ended.stderr
    head, first, *_ = ended.stdout.splitlines()
    assert head.split()[:4] == ["RANK", "DISTANCE", "SCORE", "CLASS"]
    assert first.split()[0] == "1"
    assert first.split()[3] == DEMO_QUERY.split("_")[0], "the nearest scan is one of the same person"
    assert "NN" in ended.stdout
    address = ended.stderr.split()[-1]
    page = Path(unquote(urlparse(address).path))
    assert page == tmp_path / folder / "index.html"
    assert page.read_text(encoding="utf-8").count("data:image/png") > 10

    shown = [shlex.split(line[2:]) for line in ended.stderr.splitlines() if line.startswith("$ ")]
    assert [words[1] for words in shown] == ["ingest", "query", "evaluate", "report"]
    for words in shown:
        assert words[0] == "pcretrieve"
        again = subprocess.run([sys.executable, "-m", *words], capture_output=True, text=True, cwd=tmp_path)
        assert again.returncode == 0, again.stderr
        assert again.stdout in ended.stdout


def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    result = CliRunner().invoke(cli, ["demo", str(tmp_path / "file")])
    assert isinstance(result.exception, InputError)
    assert f"cannot write scans into {tmp_path / 'file'}: Not a directory; name another" in str(
        result.exception
    )
