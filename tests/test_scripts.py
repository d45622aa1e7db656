"""Scripts in Python are doors: a few lines that call a module's `main`."""

from __future__ import annotations

import ast
import os
from importlib import import_module
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[1] / "scripts"
PYTHON = sorted(
    path
    for path in SCRIPTS.iterdir()
    if path.suffix == "" and path.read_text(encoding="utf-8").startswith("#!/usr/bin/env python3\n")
)


@pytest.mark.parametrize("script", PYTHON, ids=lambda path: path.name)
def test_a_script_is_a_door(script: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert os.access(script, os.X_OK)
    tree = ast.parse(script.read_text(encoding="utf-8"))
    assert ast.get_docstring(tree)
    (module,) = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert module is not None
    assert len(tree.body) == 3, "a docstring, an import and a call: what it does is in the module"
    with pytest.raises(SystemExit) as stop:
        import_module(module).main(["--help"])
    assert stop.value.code == 0
    assert "usage:" in capsys.readouterr().out


def test_there_are_such_scripts() -> None:
    assert {"make_scans", "benchmark_fidelity", "reproduce_paper"} <= {path.name for path in PYTHON}
