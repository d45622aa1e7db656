"""Open3D is imported once, also if several threads ask for it at the same time."""

from __future__ import annotations

import subprocess
import sys

THREADS = """
import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

from pcretrieve.draw.open3d import library

sys.setswitchinterval(1e-6)
barrier = Barrier(8)

def asked(_):
    barrier.wait()
    return library()

with ThreadPoolExecutor(8) as threads:
    assert len({id(found) for found in threads.map(asked, range(8))}) == 1
"""


def test_threads_that_ask_at_once_get_one_library() -> None:
    done = subprocess.run([sys.executable, "-c", THREADS], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
