"""What only POSIX, or only Linux, has is hidden from the package, in all processes: it works without."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import shapes
from commands import program
from search_server import egg, running, write_eggs

from pcretrieve.formats import write_mesh

ROOT = Path(__file__).parents[1]

# Python imports it at the start of each process, also of workers. Modules are hidden from pcretrieve alone,
# because other packages ask which system this is, and not what it has.
HIDES = """
import builtins, os, signal
from multiprocessing import popen_fork

HIDDEN = {"fcntl", "resource", "termios", "pwd", "grp"}
find = builtins.__import__

def found(name, globals=None, *others, **named):
    if name in HIDDEN and (globals or {}).get("__name__", "").startswith("pcretrieve"):
        raise ModuleNotFoundError(f"{name} is hidden", name=name)
    return find(name, globals, *others, **named)

builtins.__import__ = found
# By its number, because the name goes.
popen_fork.Popen.kill = lambda process: process._send_signal(9)
for module, names in (
    (os, "fork sched_getaffinity getuid geteuid set_blocking O_DIRECTORY O_NOFOLLOW"),
    (signal, "SIGKILL SIGHUP pthread_sigmask"),
):
    for name in names.split():
        delattr(module, name)
"""

# Of a module that has such a name, as those of the package have.
SHOWS = """
import os, signal
assert not hasattr(os, "fork") and not hasattr(signal, "SIGKILL")
try:
    exec("import fcntl", {"__name__": "pcretrieve.any", "__builtins__": __builtins__})
except ImportError:
    print("hidden")
"""

IMPORTS = """
import importlib, pkgutil, pcretrieve
names = [one.name for one in pkgutil.walk_packages(pcretrieve.__path__, "pcretrieve.")]
for name in names:
    if not name.endswith("__main__"):
        importlib.import_module(name)
print(len(names))
"""


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes that are started have none of it."""
    (tmp_path / "sitecustomize.py").write_text(HIDES)
    places = [str(tmp_path), str(ROOT), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, places)))


def printed(code: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_all_modules_are_imported() -> None:
    assert printed(SHOWS) == "hidden"
    assert int(printed(IMPORTS)) > 100


def test_scans_are_ingested_and_found(tmp_path: Path) -> None:
    """By worker processes, one of which is given something that is no scan."""
    scans, catalogue = tmp_path / "scans", tmp_path / "c.sqlite"
    scans.mkdir()
    for number in range(2):
        egg = shapes.ellipsoid((1, 0.6 + 0.1 * number, 0.5), 3)
        write_mesh(egg, scans / f"egg{number}.off")
    (scans / "flat.xyz").write_text("1 2 3\n" * 200)
    asked = ("-c", catalogue)
    done = program("ingest", scans, *asked, "--workers", 1, code=3)
    assert "2 done, 1 failed" in done.stderr
    found = program("query", "egg0", *asked, "-k", 2).stdout
    assert [line.split()[4] for line in found.splitlines()[1:3]] == ["egg0", "egg1"]
    new = program("query", scans / "egg1.off", *asked, "-k", 1).stdout
    assert "egg1" in new
    program("mark", "flat", "note", "no scan", *asked)
    program("remove", "egg0", *asked)
    assert "no scan" in program("list", *asked).stdout
    said = program("ingest", scans, *asked, "--memory", 4, "--retry-failed", code=2)
    assert "leave --memory out" in said.stderr


def test_a_scan_is_served(tmp_path: Path) -> None:
    """By a server, whose worker finds what a browser sends."""
    write_eggs(tmp_path / "eggs.sqlite")
    with running(tmp_path / "eggs.sqlite") as server:
        assert b"Egg10" in server.ask("/shapes").body
        found = server.outcome("egg.off", egg(tmp_path))
        page = server.ask(f"/scan/{found['job']}").body
    assert found["grade"]["name"] == "good"
    assert b"&lt;kind 1&gt;" in page
