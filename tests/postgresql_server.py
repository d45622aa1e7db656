"""A throw-away PostgreSQL server in a temporary folder, which tests may stop and start."""

from __future__ import annotations

import os
import pwd
import shutil
import signal
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import pytest

# No test asks what a loss of power does.
SETTINGS = ("fsync=off", "shared_buffers=32MB", "max_connections=40")


def programs() -> Path:
    """The folder of the programs of a server: PCRETRIEVE_POSTGRESQL, or that of Debian, or of PATH."""
    given = os.environ.get("PCRETRIEVE_POSTGRESQL")
    on_path = shutil.which("initdb")
    folders = [Path(given)] if given else []
    folders += sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)
    folders += [Path(on_path).resolve().parent] if on_path else []
    for folder in folders:
        if (folder / "initdb").exists() and (folder / "pg_ctl").exists():
            return folder
    pytest.skip(
        "no PostgreSQL server is installed (Debian: postgresql), which scripts/test installs as root"
    )


class Server:
    """A server with its files in a folder, at a port of this computer and at a socket in the folder."""

    def __init__(self, folder: Path) -> None:
        self._tools = programs()
        self._folder = folder
        self._data = folder / "data"
        self._as_user: dict[str, Any] = {}
        if os.geteuid() == 0:  # PostgreSQL refuses to run as root
            nobody = pwd.getpwnam("nobody")
            self._as_user = {
                "user": nobody.pw_uid,
                "group": nobody.pw_gid,
                "extra_groups": [],
            }
            os.chown(folder, nobody.pw_uid, nobody.pw_gid)
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.url = f"postgresql://tester@127.0.0.1:{self.port}/postgres"
        self.socket_url = f"postgresql://tester@/postgres?host={folder}&port={self.port}"
        words = (
            "-D",
            self._data,
            "-U",
            "tester",
            "-A",
            "trust",
            "-E",
            "UTF8",
            "--no-sync",
        )
        self._run("initdb", *words)

    def start(self) -> None:
        """Start the server, and wait until it works."""
        given = (
            f"port={self.port}",
            "listen_addresses=127.0.0.1",
            f"unix_socket_directories={self._folder}",
            *SETTINGS,
        )
        options = " ".join(f"-c {setting}" for setting in given)
        log = self._folder / "log"
        self._run("pg_ctl", "-D", self._data, "-w", "-l", log, "-o", options, "start")

    def stop(self) -> None:
        """Stop the server as a crash does: it recovers when it is started again."""
        self._run("pg_ctl", "-D", self._data, "-m", "immediate", "stop")

    def processes(self) -> list[int]:
        """The process of the server, and then its children."""
        first = int((self._data / "postmaster.pid").read_text().split()[0])
        children = Path(f"/proc/{first}/task/{first}/children").read_text().split()
        return [first, *map(int, children)]

    @contextmanager
    def stands_still(self) -> Iterator[None]:
        """Stop all processes of the server, which keep their connections."""
        stopped = self.processes()
        for process in stopped:
            os.kill(process, signal.SIGSTOP)
        try:
            yield
        finally:
            for process in stopped:
                with suppress(ProcessLookupError):  # one that was about to end
                    os.kill(process, signal.SIGCONT)

    def _run(self, tool: str, *words: str | Path) -> None:
        command = [self._tools / tool, *words]
        subprocess.run(
            command,
            check=True,
            cwd=self._folder,
            capture_output=True,
            timeout=100,
            **self._as_user,
        )


@contextmanager
def server_of_its_own() -> Iterator[Server]:
    """A server that runs until the context ends."""
    pytest.importorskip(
        "psycopg", reason="psycopg is not installed (the extra postgresql)"
    )
    # Not below the folder of pytest, in which root lets no other user look.
    folder = Path(mkdtemp(prefix="pcretrieve-postgresql-"))
    try:
        server = Server(folder)
        server.start()
        try:
            yield server
        finally:
            server.stop()
    finally:
        shutil.rmtree(folder)


@contextmanager
def running_server() -> Iterator[str]:
    """The URL of the database of a server that runs until the context ends."""
    with server_of_its_own() as server:
        yield server.url
