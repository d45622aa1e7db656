"""A throw-away PostgreSQL server in a temporary folder."""

from __future__ import annotations

import os
import pwd
import shutil
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
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


@contextmanager
def running_server() -> Iterator[str]:
    """The URL of the database of a server that runs until the context ends."""
    pytest.importorskip("psycopg", reason="psycopg is not installed (the extra postgresql)")
    tools = programs()
    # Not below the folder of pytest, in which root lets no other user look.
    folder = Path(mkdtemp(prefix="pcretrieve-postgresql-"))
    as_user: dict[str, Any] = {}
    if os.geteuid() == 0:  # PostgreSQL refuses to run as root
        nobody = pwd.getpwnam("nobody")
        as_user = {"user": nobody.pw_uid, "group": nobody.pw_gid, "extra_groups": []}
        os.chown(folder, nobody.pw_uid, nobody.pw_gid)
    data = folder / "data"

    def run(*command: str | Path) -> None:
        subprocess.run(command, check=True, cwd=folder, capture_output=True, timeout=100, **as_user)

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    try:
        run(tools / "initdb", "-D", data, "-U", "tester", "-A", "trust", "-E", "UTF8", "--no-sync")
        given = (
            f"port={port}",
            "listen_addresses=127.0.0.1",
            f"unix_socket_directories={folder}",
            *SETTINGS,
        )
        options = " ".join(f"-c {setting}" for setting in given)
        run(tools / "pg_ctl", "-D", data, "-w", "-l", folder / "log", "-o", options, "start")
        try:
            yield f"postgresql://tester@127.0.0.1:{port}/postgres"
        finally:
            run(tools / "pg_ctl", "-D", data, "-m", "immediate", "stop")
    finally:
        shutil.rmtree(folder)
