"""A Dask cluster of real processes: a scheduler and workers, as its command line starts them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from processes import PATIENCE, wait_for


class DaskCluster:
    """A scheduler and two workers of one thread each, with the nannies that restart them."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "scheduler.json"
        self._folder = folder
        self.scheduler = self._start("dask_scheduler", "--port", "0")
        assert wait_for(self.file.is_file), "the scheduler has not started"
        limits = (
            "--nthreads",
            "1",
            "--memory-limit",
            "0",
            "--local-directory",
            str(folder),
        )
        self.workers = [self._start("dask_worker", *limits) for _ in range(2)]

    def kill(self, process: subprocess.Popen[bytes]) -> None:
        """Kill a process and its children, as a computer that loses its power."""
        os.killpg(process.pid, signal.SIGKILL)
        process.wait(PATIENCE)

    def _start(self, command: str, *arguments: str) -> subprocess.Popen[bytes]:
        module = [sys.executable, "-m", f"distributed.cli.{command}", "--no-dashboard"]
        number = len(list(self._folder.glob("*.log")))
        with (self._folder / f"{command}{number}.log").open("wb") as log:
            return subprocess.Popen(
                [*module, "--scheduler-file", str(self.file), *arguments],
                # Functions of tests are unpickled by their workers.
                env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
                stdout=log,
                stderr=log,
                start_new_session=True,
            )


@contextmanager
def dask_cluster(folder: Path) -> Iterator[DaskCluster]:
    """A cluster that is killed at the end of the context."""
    folder.mkdir(parents=True)
    cluster = DaskCluster(folder)
    try:
        yield cluster
    finally:
        for process in (*cluster.workers, cluster.scheduler):
            if process.poll() is None:
                cluster.kill(process)
