"""Each write to a catalogue fails once: an error with words, nothing lost, and the same ingest goes on.

By default some of the writes; PCRETRIEVE_EVERY_WRITE=1 lets every one of them fail.
"""

from __future__ import annotations

import os
import pickle
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import shapes
from benchmarks.damage import calls_of, cut_power
from processes import remembered
from stored import everything

from pcretrieve import Catalogue, ingest
from pcretrieve.errors import CatalogueError
from pcretrieve.formats import write_mesh
from pcretrieve.ingestion.recomputing import find_defects

PATIENCE = 1200  # seconds

# Of the writes, each of this number fails, unless all are asked for.
STEP = 1 if os.environ.get("PCRETRIEVE_EVERY_WRITE") else 17

N_SHAPES = 3

# Number of power cuts.
N_CUTS = int(os.environ.get("PCRETRIEVE_CUTS", "50"))

# Of file systems: with a write-ahead log, and with the rollback journal of networks.
KINDS = ["ext4", pytest.param("nfs4", marks=pytest.mark.slow)]

needs_compiler = pytest.mark.skipif(
    shutil.which("cc") is None, reason="needs a C compiler"
)

COMMON = """
import ctypes, errno, pickle, shutil, sys
from itertools import count
from pathlib import Path
from benchmarks.damage import calls_of, cut_power
from processes import remembered
from stored import everything
from pcretrieve.catalogue import Catalogue, sqlite
from pcretrieve.errors import CatalogueError
from pcretrieve.ingestion.recomputing import find_defects
from pcretrieve import ingest as ingest_scans

sqlite.MOUNTS, scans = Path(sys.argv[1]), sorted(Path(sys.argv[2]).iterdir())
folder = scans[0].parents[1] / "catalogues"
path = folder / "c.sqlite"
shim = ctypes.CDLL(None)
"""

# Ingests the same scans again and again, each time with another write that fails.
INGESTS = """
def ingest():
    with Catalogue(path, create=True) as store:
        ingest_scans(scans, store, executor=remembered, workers=1)

def stored():
    with Catalogue(path) as store:
        assert find_defects(store) == [], find_defects(store)
    return [*everything(str(path)).values()]

def fresh():
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()

step = int(sys.argv[3])
fresh()
ingest()
whole = stored()
refused = []
codes = (errno.ENOSPC, errno.EIO)
for turn in count():
    # One error after the other; both for each write, if all are asked for.
    number, code = turn // 2 if step == 1 else turn * step, codes[turn % 2]
    fresh()
    shim.fail_write(str(folder).encode(), ctypes.c_long(number), code)
    words = ""
    try:
        ingest()
    except CatalogueError as error:
        words = error.message.replace(str(path), "PATH")
    seen = shim.writes_seen()
    shim.fail_write(b"", ctypes.c_long(-1), 0)
    if seen <= number:
        break
    # What is there is what was stored before the write failed, in the order in which it was stored.
    try:
        there = stored()
    except CatalogueError as error:
        assert "there is no catalogue" in error.message, (number, error)
        there = []
    assert there == whole[:len(there)], number
    assert words or there == whole, (number, "lost without a word")
    if words:
        refused.append((words, len(there)))
    ingest()
    assert stored() == whole, number
assert seen > 40
# Failures at different moments: before the first shape, between shapes, after the last.
assert {0, 1} <= {n_stored for _, n_stored in refused}, refused
said = " ".join(words for words, _ in refused)
assert "the disk is full: make room and run the same command again" in said
assert "the disk or the network reports an error" in said
"""


# Changes a catalogue in all ways, and notes each state after the call that made it, with all that it wrote.
RECORDED = """
states, trace = [{}], scans[0].parents[1] / "trace"

def noted(*_):
    states.append(everything(path))
    shim.note(ctypes.c_char(b"m"), str(folder).encode(), ctypes.c_long(0), ctypes.c_long(0), None)

def ingest(store, *scans, **given):
    ingest_scans(scans, store, executor=remembered, workers=1, **given)
    noted()

folder.mkdir()
shim.record(str(folder).encode(), str(trace).encode())
with Catalogue(path, create=True) as store:
    noted()
    for scan in scans[:-1]:
        ingest(store, scan)
    ingest(store, scans[0], labels={scans[0].name: "egg"})
    store.remove(*[scan.stem for scan in scans[:-2]])
    noted()
    ingest(store, scans[0])
for scan in scans[1:]:
    with Catalogue(path) as store:
        ingest(store, scan)
trace.with_name("states").write_bytes(pickle.dumps(states))
"""


def run(script: str, kind: str, folder: Path, *given: object) -> Path:
    """Run a script beside scans, with a library that sees its writes, on a file system of some kind."""
    (folder / "scans").mkdir()
    for number in range(N_SHAPES):
        egg = shapes.ellipsoid((1, 1.2, 1.5 + number / 5), subdivisions=2)
        write_mesh(egg, folder / "scans" / f"{number}.off")
    mounts, library = folder / "mountinfo", folder / "calls.so"
    device = folder.stat().st_dev
    of_device = f"{os.major(device)}:{os.minor(device)}"
    mounts.write_text(f"22 27 {of_device} / / rw - {kind} server:/scans rw\n")
    compiling: list[str | Path] = [
        "cc",
        "-shared",
        "-fPIC",
        "-o",
        library,
        Path(__file__).with_name("calls.c"),
        "-ldl",
    ]
    subprocess.run(compiling, check=True, timeout=PATIENCE)
    known = {
        "LD_PRELOAD": str(library),
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
    }
    command: list[str | Path] = [
        sys.executable,
        "-c",
        COMMON + script,
        mounts,
        folder / "scans",
        *map(str, given),
    ]
    subprocess.run(command, env=os.environ | known, check=True, timeout=PATIENCE)
    return mounts


@needs_compiler
@pytest.mark.parametrize("kind", KINDS)
def test_every_write_fails_once(kind: str, tmp_path: Path) -> None:
    run(INGESTS, kind, tmp_path, STEP)


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_power_fails(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What counted as stored is on the disk, no shape is there in part, and the same command goes on."""
    monkeypatch.setattr(
        "pcretrieve.catalogue.sqlite.MOUNTS", run(RECORDED, kind, tmp_path)
    )
    calls = calls_of((tmp_path / "trace").read_bytes())
    states = pickle.loads((tmp_path / "states").read_bytes())
    assert sum(call[0] == "m" for call in calls) == len(states) - 1
    for number in range(N_CUTS):
        place = tmp_path / f"cut{number}"
        n_noted = cut_power(calls, number, place)
        path, found = place / "c.sqlite", {}
        try:
            with Catalogue(path) as store:
                assert find_defects(store) == [], number
            found = everything(str(path))
        except CatalogueError as error:
            assert re.search("there is no catalogue|but no catalogue", error.message), (
                number,
                error,
            )
            assert n_noted == 0
        assert found in states[n_noted : n_noted + 2], (number, n_noted, [*found])
        again = ingest(tmp_path / "scans", path, executor=remembered)
        assert {record.id for record in again.done + again.held} == {
            f"{one}" for one in range(N_SHAPES)
        }
        with Catalogue(path) as store:
            assert find_defects(store) == [], number
        shutil.rmtree(place)
