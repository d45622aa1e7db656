"""Each write to a catalogue fails once: an error with words, nothing lost, and the same ingest goes on.

By default some of the writes; PCRETRIEVE_EVERY_WRITE=1 lets every one of them fail.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import shapes

from pcretrieve.formats import write_mesh

PATIENCE = 1200  # seconds

# Of the writes, each of this number fails, unless all are asked for.
STEP = 1 if os.environ.get("PCRETRIEVE_EVERY_WRITE") else 17

N_SHAPES = 3

# Counts the calls that change files of a folder, and lets one of them fail.
FAILING_WRITES = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

static char folder[4096];
static long chosen = -1, seen;
static int code;

void fail_write(const char *place, long number, int error) {
    strncpy(folder, place, sizeof folder - 1);
    chosen = number;
    code = error;
    seen = 0;
}

long writes_seen(void) { return seen; }

static int fails(int file) {
    char link[64], path[4096];
    if (chosen < 0) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) return 0;
    path[length] = 0;
    if (strncmp(path, folder, strlen(folder))) return 0;
    if (seen++ != chosen) return 0;
    errno = code;
    return 1;
}

#define FAILING(result, name, parameters, arguments)                                      \\
    result name parameters {                                                              \\
        result (*actual) parameters = (result (*) parameters)dlsym(RTLD_NEXT, #name);     \\
        return fails(file) ? -1 : actual arguments;                                       \\
    }

FAILING(ssize_t, write, (int file, const void *data, size_t size), (file, data, size))
FAILING(ssize_t, pwrite, (int file, const void *data, size_t size, off_t at), (file, data, size, at))
FAILING(ssize_t, pwrite64, (int file, const void *data, size_t size, off64_t at), (file, data, size, at))
FAILING(int, ftruncate, (int file, off_t size), (file, size))
FAILING(int, ftruncate64, (int file, off64_t size), (file, size))
FAILING(int, fsync, (int file), (file))
FAILING(int, fdatasync, (int file), (file))
"""

# Ingests the same scans again and again, each time with another write that fails.
INGESTS = """
import ctypes, errno, shutil, sys
from itertools import count
from pathlib import Path
from processes import in_this_process
from stored import everything
from pcretrieve.catalogue import Catalogue, find_defects, sqlite
from pcretrieve.errors import CatalogueError
from pcretrieve import ingest as ingest_scans

scans, step, sqlite.MOUNTS = Path(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])
folder = scans.parent / "catalogues"
path = folder / "c.sqlite"
shim = ctypes.CDLL(None)
made = {}

def remembered(function, items, /, **limits):
    # What is computed of a scan is always the same, and need not be computed for each write.
    for item in items:
        if item.path.name not in made:
            made[item.path.name] = next(iter(in_this_process(function, [item])))[1]
        yield item, made[item.path.name]

def ingest():
    with Catalogue(path, create=True) as store:
        ingest_scans(sorted(scans.iterdir()), store, executor=remembered, workers=1)

def stored():
    with Catalogue(path) as store:
        assert find_defects(store) == [], find_defects(store)
    return [*everything(str(path)).values()]

def fresh():
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()

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


@pytest.mark.skipif(shutil.which("cc") is None, reason="a library that lets writes fail needs a C compiler")
@pytest.mark.parametrize("kind", ["ext4", pytest.param("nfs4", marks=pytest.mark.slow)])
def test_every_write_fails_once(kind: str, tmp_path: Path) -> None:
    """With a write-ahead log, and with the rollback journal of network file systems."""
    (tmp_path / "scans").mkdir()
    for number in range(N_SHAPES):
        egg = shapes.ellipsoid((1, 1.2, 1.5 + number / 5), subdivisions=2)
        write_mesh(egg, tmp_path / "scans" / f"{number}.off")
    mounts, shim = tmp_path / "mountinfo", tmp_path / "shim.so"
    mounts.write_text(f"22 27 0:21 / / rw - {kind} server:/scans rw\n")
    (tmp_path / "shim.c").write_text(FAILING_WRITES)
    compiling = ["cc", "-shared", "-fPIC", "-o", str(shim), str(tmp_path / "shim.c"), "-ldl"]
    subprocess.run(compiling, check=True, timeout=PATIENCE)
    done = subprocess.run(
        [sys.executable, "-c", INGESTS, str(tmp_path / "scans"), str(STEP), str(mounts)],
        env={**os.environ, "LD_PRELOAD": str(shim), "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        stderr=subprocess.PIPE,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
