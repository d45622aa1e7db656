"""The public names: exact, documented, and imported only when they are used."""

import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from benchmarks.synthetic import synthetic_catalogue, synthetic_id
from commands import NAMES

import pcretrieve

HEAVY = (
    "numpy",
    "scipy",
    "sklearn",
    "numba",
    "open3d",
    "pytetwild",
    "trimesh",
    "pydantic",
)


def test_every_command_has_a_function() -> None:
    """All that the command line does can be done in Python."""
    functions = {
        "merge": "merge_views",
        "query": "search_many",
        "map": "draw_map",
        "list": "Catalogue",
        "show": "Catalogue",
        "remove": "Catalogue",
        "export": "write_mesh",
        "options": "PipelineOptions",
        "demo": "ingest",
    }
    for command in NAMES:
        name = command.removeprefix("lab ").removeprefix("catalogue ").replace("-", "_")
        assert functions.get(name, name) in pcretrieve.__all__, command


def test_every_public_name_is_there_and_documented() -> None:
    for name in set(pcretrieve.__all__) - {"__version__"}:
        value = getattr(pcretrieve, name)
        assert value.__name__ == name
        documentation = inspect.getdoc(value)
        assert documentation, name
        if inspect.isfunction(value):
            assert "Parameters\n---" in documentation, name
            assert "Raises\n---" in documentation, name
            for parameter in inspect.signature(value).parameters:
                documented = rf"^(\w+, )*{parameter}(, \w+)* : "
                assert re.search(documented, documentation, re.MULTILINE), (
                    name,
                    parameter,
                )


def imported_by(*arguments: str) -> set[str]:
    """Packages that a fresh interpreter has imported after running with these arguments."""
    done = subprocess.run(
        [sys.executable, "-X", "importtime", *arguments],
        capture_output=True,
        text=True,
        check=True,
    )
    return {
        line.rsplit("|", 1)[1].strip().split(".")[0]
        for line in done.stderr.splitlines()
        if "|" in line
    }


@pytest.mark.parametrize(
    "arguments",
    [
        ("-c", "import pcretrieve; dir(pcretrieve); pcretrieve.__version__"),
        ("-m", "pcretrieve", "--help"),
        ("-m", "pcretrieve", "query", "--help"),  # lists descriptors and distances
        ("-m", "pcretrieve", "--version"),
    ],
    ids=" ".join,
)
def test_starting_is_light(arguments: tuple[str, ...]) -> None:
    imported = imported_by(*arguments)
    assert "pcretrieve" in imported
    assert imported.isdisjoint(HEAVY)


def test_a_query_by_id_fits_and_imports_nothing_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After the first one, which keeps the index: SciPy alone would take half of the time."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    path = tmp_path / "c.sqlite"
    synthetic_catalogue(path, pcretrieve.PipelineOptions(), 100, 1)
    query = ("-m", "pcretrieve", "query", "-c", str(path), synthetic_id(7))
    assert "scipy" in imported_by(*query)
    slow = {"scipy", "sklearn", "numba", "open3d", "trimesh", "rich"}
    assert imported_by(*query).isdisjoint(slow)


@pytest.mark.parametrize(
    "name", ["read_scan", "SignatureIndex", "eigenpairs", "reconstruct"]
)
def test_third_parties_wait_until_they_are_needed(name: str) -> None:
    assert imported_by("-c", f"from pcretrieve import {name}").isdisjoint(
        {"open3d", "pytetwild", "trimesh"}
    )


# Imports every module where nothing can be written, and prints what that opened for writing, made or set.
IMPORTS = """
import os, pkgutil, signal, sys
import numpy, sklearn  # which set variables themselves

effects = []
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT
CHANGES = ("os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.putenv", "os.unsetenv", "tempfile.",
           "resource.setrlimit", "shutil.", "subprocess.Popen", "socket.connect", "ctypes.call_function")

def note(event, arguments):
    if event == "open" and arguments[2] & WRITING or event.startswith(CHANGES):
        effects.append(f"{event} {arguments}")

def settings():
    handlers = [signal.getsignal(number) for number in signal.valid_signals()]
    umask = os.umask(0o077)
    os.umask(umask)
    return dict(os.environ), handlers, umask, os.getcwd(), os.nice(0)

before = settings()
sys.addaudithook(note)
import pcretrieve
for module in pkgutil.walk_packages(pcretrieve.__path__, "pcretrieve."):
    if not module.name.endswith("__main__"):
        __import__(module.name)
effects += [f"{a} -> {b}" for a, b in zip(before, settings()) if a != b]
effects += [f"import {name}" for name in ("numba", "open3d") if name in sys.modules]
print("\\n".join(effects))
"""


def test_importing_any_module_does_nothing(tmp_path: Path) -> None:
    """No file, folder, variable of the environment or setting of the process is touched."""
    tmp_path.chmod(0o555)
    environment = os.environ | {
        "HOME": "/nonexistent",
        "TMPDIR": str(tmp_path),
        "PYTHONPATH": os.pathsep.join(sys.path),
        "XDG_CACHE_HOME": "",
        "NUMBA_CACHE_DIR": "",
    }
    done = subprocess.run(
        [sys.executable, "-B", "-c", IMPORTS],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == []
