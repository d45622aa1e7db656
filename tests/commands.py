"""Commands of pcretrieve that tests run: in this process, or in one of their own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from click.testing import CliRunner, Result

from pcretrieve.cli.main import CATALOGUE, COMMANDS, LAB, cli

NAMES = [name for name in COMMANDS if name not in ("catalogue", "lab")]
NAMES += [f"catalogue {name}" for name in CATALOGUE] + [f"lab {name}" for name in LAB]


def run(*words: object, code: int | None = 0, **environment: str | None) -> Result:
    """Run a command in this process: a new one takes seconds to import what it needs."""
    done = CliRunner().invoke(
        cli, [str(word) for word in words], prog_name="pcretrieve", env=environment
    )
    assert code in (None, done.exit_code), done.output
    return done


def refusal(*words: object) -> str:
    """The message of a command that ends with an error."""
    done = run(*words, code=None)
    assert done.exit_code not in (0, 3), done.output
    return f"{done.stderr}{done.exception}"


def result(*words: object, code: int = 0) -> Any:
    """The result in the JSON document of a command."""
    return json.loads(run(*words, "--json", code=code).stdout)["result"]


def program(
    *words: object,
    cwd: Path | None = None,
    code: int = 0,
    by: tuple[str, ...] = (),
    **environment: str,
) -> subprocess.CompletedProcess[str]:
    """Run a command in a process of its own, which another program may start."""
    command, known = (
        [*by, sys.executable, "-m", "pcretrieve", *map(str, words)],
        os.environ | environment,
    )
    done = subprocess.run(
        command,
        cwd=cwd,
        env=known,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    return done
