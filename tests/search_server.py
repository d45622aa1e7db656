"""A server of the search page in a process of its own, as users start it, and requests to it."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from http.client import HTTPConnection, HTTPResponse
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote, urlsplit

import shapes
from processes import wait_for

from pcretrieve import Catalogue, PipelineOptions, Step, process, write_mesh
from pcretrieve.catalogue import Content, Record
from pcretrieve.descriptors import describe
from pcretrieve.values import UNIT, Grade

OPTIONS = PipelineOptions().changed(signature={"method": "r-bihdm", "n_values": 20})

# A name that is no part of an address, and would be a tag of a page, as it is.
NASTY = "a/<b> %2F?&#'\".."

SECRETS = (
    *(str(Path.cwd()), str(Path.home()) + "/", "/secret", "own folder"),
    *("root:x:0", "Traceback", "site-packages"),
)


def write_eggs(path: Path) -> None:
    """A catalogue of four eggs of each of three kinds, one of which is incomplete, and of a failure."""
    judged = {(2, 3): Grade("incomplete", 0.5, ("a large hole",))}
    with Catalogue(path, OPTIONS, create=True) as store:
        for kind in range(3):
            for number, width in enumerate((1, 1.04, 1.08, 1.12)):
                shape = process(
                    shapes.ellipsoid((width, 1, 1.3 + 0.5 * kind), 3), OPTIONS
                )
                grade = judged.get((kind, number), Grade("good", 0.01))
                name = NASTY if (kind, number) == (2, 2) else f"Egg{kind}{number}"
                values = describe(shape, OPTIONS.signature).values
                steps = (Step("read", 0.0, {UNIT: 1.0}),) if kind else ()
                where = f"/secret/folder/{kind}{number}.off"
                record = Record(name, where, name, f"<kind {kind}>", steps=steps)
                store.put(record, Content(replace(shape, grade=grade), values))
        failed = Record(
            "broken", "/secret/own folder/broken.off", "", status="failed", stage="read"
        )
        store.put(
            replace(
                failed,
                error="ScanReadError",
                message="/secret/own folder/broken.off is empty",
            )
        )


def write_many(path: Path) -> Path:
    """A catalogue of two eggs of each of fourteen kinds."""
    with Catalogue(path, OPTIONS, create=True) as store:
        for kind in range(14):
            for number in range(2):
                size = (1 + 0.02 * number, 1, 1.3 + 0.1 * kind)
                shape = process(shapes.ellipsoid(size, 2), OPTIONS)
                name = f"Egg{kind}-{number}"
                record = Record(name, f"/{name}.off", name, f"kind {kind}")
                values = describe(shape, OPTIONS.signature).values
                store.put(record, Content(shape, values))
    return path


def egg(folder: Path, width: float = 1.06) -> bytes:
    """An egg that is not in the catalogue, which is `egg.off` in a folder too."""
    write_mesh(shapes.ellipsoid((width, 1, 1.8), 3), folder / "egg.off")
    return (folder / "egg.off").read_bytes()


class Answer(NamedTuple):
    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


@dataclass(frozen=True)
class Server:
    """A server, of which no answer may name a folder, a traceback, or what is in a file of the computer."""

    address: str
    process: subprocess.Popen[str]
    secrets: tuple[str, ...]

    @property
    def port(self) -> int:
        return urlsplit(self.address).port or 0

    @property
    def token(self) -> str:
        return self.address.partition("token=")[2]

    def ask(
        self,
        path: str,
        *,
        method: str = "GET",
        headers: dict[str, str] | None = None,
        body: bytes | Iterator[bytes] | None = None,
        bearer: bool = True,
    ) -> Answer:
        """What the server answers to one request; redirections are not followed."""
        sent = {"Authorization": f"Bearer {self.token}"} if bearer else {}
        connection = HTTPConnection("127.0.0.1", self.port, timeout=60)
        try:
            connection.request(method, path, body, sent | (headers or {}))
            answer: HTTPResponse = connection.getresponse()
            found = Answer(
                answer.status,
                {k.lower(): v for k, v in answer.getheaders()},
                answer.read(),
            )
        finally:
            connection.close()
        told = found.body + str(found.headers).encode()
        assert not [secret for secret in self.secrets if secret.encode() in told], told
        return found

    def send(self, name: str, body: bytes | Iterator[bytes], **request: Any) -> Answer:
        """The answer to an upload."""
        return self.ask(
            f"/scans?name={quote(name, safe='')}", method="POST", body=body, **request
        )

    def outcome(self, name: str, body: bytes, **request: Any) -> Any:
        """The document of an uploaded scan, which was processed and inspected."""
        begun = self.send(name, body, **request)
        assert begun.status == 202, begun
        address = begun.headers["location"]
        assert wait_for(lambda: self.ask(address).json["inspection"] != "waiting")
        assert b"<script>alert" not in self.ask(address.replace("scans", "scan")).body
        return self.ask(address).json


@contextmanager
def running(
    catalogue: Path, *options: str, first: str = "", temporary: Path | None = None
) -> Iterator[Server]:
    """A server, from when it has printed its address; it must end by SIGTERM as told.

    `first` is code that its process runs first, such as a shorter limit of time; `temporary` is its folder of
    temporary files.
    """
    program = (
        ["-c", f"{first}; from pcretrieve.cli.main import cli; cli()"]
        if first
        else ["-m", "pcretrieve"]
    )
    command = [
        sys.executable,
        *program,
        "serve",
        "-c",
        str(catalogue),
        "--port",
        "0",
        *options,
    ]
    place = os.environ | ({} if temporary is None else {"TMPDIR": str(temporary)})
    folders = [catalogue.parent] if temporary is None else [catalogue.parent, temporary]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=place
    ) as process:
        try:
            assert process.stdout is not None
            address = process.stdout.readline().strip()
            assert address, process.stderr and process.stderr.read()
            yield Server(address, process, SECRETS + tuple(map(str, folders)))
        finally:
            process.terminate()
            process.communicate(timeout=60)


def raw(server: Server, request: str, body: bytes = b"") -> socket.socket:
    """A connection on which a request with the token, or its beginning, was sent."""
    connection = socket.create_connection(("127.0.0.1", server.port), timeout=60)
    known = f"Host: 127.0.0.1\r\nAuthorization: Bearer {server.token}\r\n"
    connection.sendall(request.replace("KNOWN\r\n", known).encode() + body)
    return connection


def status(connection: socket.socket) -> int:
    with connection, connection.makefile("rb") as file:
        return int(file.readline().split()[1])
