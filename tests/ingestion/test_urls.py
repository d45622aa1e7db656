"""Servers that never end, are silent, or lead elsewhere; and catalogues that name them."""

from __future__ import annotations

import os
import pty
import re
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import repeat
from pathlib import Path
from threading import Thread
from typing import Any, ClassVar

import pytest
import shapes
from commands import refusal
from processes import MEASURE, peak_of

from pcretrieve import (
    Catalogue,
    PipelineOptions,
    check,
    describe,
    process,
    read_scan,
    retry,
)
from pcretrieve.catalogue import Content, Record
from pcretrieve.errors import InputError, ScanReadError
from pcretrieve.formats import ScanPath
from pcretrieve.formats.identity import content_hash
from pcretrieve.ingestion.discover import discover

LIMITS: dict[str, Any] = {"workers": 1, "timeout": 60, "memory": None}


class Server(BaseHTTPRequestHandler):
    """Pages without an end, redirects, and silence."""

    asked: ClassVar[list[str]] = []

    def do_HEAD(self) -> None:
        self.do_GET()

    def do_GET(self) -> None:
        self.asked.append(self.path)
        if self.path.startswith("/silent"):
            time.sleep(30)
        elif self.path.startswith("/to/"):
            self.send_response(302)
            # Paths have no "//".
            self.send_header("Location", self.path.split("/")[2].replace("!", "/"))
            self.end_headers()
        elif self.path.startswith("/deep"):
            self._page([f'<a href="{k}/">' for k in range(20_000)])
        elif self.path.startswith("/endless"):
            self._page(repeat(10_000 * '<a href="x/">', 100_000))
        else:
            self._page(["o egg\nv 0 0 0\n"])

    def _page(self, lines: Any) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        try:
            for line in lines if self.command == "GET" else ():
                self.wfile.write(line.encode())
        except OSError:
            self.close_connection = True

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def http() -> Iterator[str]:
    pytest.importorskip("aiohttp", reason="aiohttp is not installed (the extra remote)")
    server = ThreadingHTTPServer(("127.0.0.1", 0), Server)
    server.daemon_threads = True
    server.block_on_close = False
    Thread(target=server.serve_forever, daemon=True).start()
    Server.asked.clear()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()
    server.server_close()


def test_a_listing_without_an_end(http: str) -> None:
    words = "a listing must have at most 16777216 bytes, .* a folder below it; or name its files"
    assert peak_of(lambda: discover([f"{http}/endless/"]), InputError, words) < 100


@pytest.mark.slow
def test_a_listing_is_made_in_a_process_with_limits(http: str) -> None:
    for folder in ("endless/", "deep/"):
        command = [sys.executable, "-c", MEASURE, f"{http}/{folder}"]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        assert float(done.stdout) < 50


def test_a_server_that_does_not_answer(http: str) -> None:
    started = time.monotonic()
    with pytest.raises(
        InputError, match=r"/silent: not finished within 1 s: raise --timeout"
    ):
        discover([f"{http}/silent/"], limits=LIMITS | {"timeout": 1})
    assert time.monotonic() - started < 25


def test_link_local_addresses_are_refused_however_they_are_named(
    http: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Not the address of the metadata of clouds, which a test that fails would ask.
    resolve = socket.getaddrinfo

    def resolved(host: Any, *others: Any, **named: Any) -> Any:
        return resolve("169.254.7.9" if host == "scans.test" else host, *others, **named)

    monkeypatch.setattr(socket, "getaddrinfo", resolved)
    words = "must not lead to the address .*, which is link-local"
    # fsspec does not take the short forms of addresses.
    mapped, local = "[0:0:0:0:0:ffff:a9fe:709]", "[fe80:0:0:0:0:0:0:1]"
    for host in ("169.254.7.9", mapped, local, "scans.test"):
        with pytest.raises(ScanReadError, match=words):
            read_scan(f"http://{host}/a.ply")
        with pytest.raises(ScanReadError, match=words):
            content_hash(ScanPath.parse(f"http://{host}/a.ply"))
        with pytest.raises(ScanReadError, match="a URL must begin with http"):
            read_scan(f"ftp://{host}/a.ply")
    for host in ("169.254.7.9", "scans.test"):  # brackets are of a pattern
        with pytest.raises(InputError, match=words):
            discover([f"http://{host}/folder/"])
    for host in ("2851997449", "0xa9fe0709"):
        with pytest.raises(ScanReadError, match=f"{words}|not a canonical IPv4"):
            read_scan(f"http://{host}/a.ply")


def test_redirects(http: str) -> None:
    """To the same host they are followed; to another one, only to public addresses."""
    port = http.rpartition(":")[2]
    words = "must not lead to the address .*, which is link-local or, by a redirect"

    def to(target: str) -> str:
        return f"{http}/to/{target.replace('/', '!')}/a.obj"

    for target in (
        "http://169.254.7.9/a.obj",
        f"http://localhost:{port}/a.obj",
        f"//localhost:{port}/a.obj",
        f"http://127.0.0.2:{port}/a.obj",
    ):
        with pytest.raises(ScanReadError, match=words):
            read_scan(to(target))
    assert "/a.obj" not in Server.asked
    assert len(read_scan(to("/b.obj")).points) == 1  # type: ignore[union-attr]
    assert Server.asked[-1] == "/b.obj"


# --- URLs in catalogues -----------------------------------------------------------------------------------


@pytest.fixture
def catalogue(tmp_path: Path, http: str) -> Path:
    """A finished shape and a failed one whose rows say that they are of scans at a server."""
    options = PipelineOptions.of({"catalogue": {"keep": []}})
    shape = process(shapes.ellipsoid((1, 0.6, 0.5), 3), options)
    values = describe(shape, options.signature).values
    with Catalogue(tmp_path / "c.sqlite", options, create=True) as store:
        store.put(Record("a", f"{http}/a.ply", "hash"), Content(replace(shape), values))
        failed = Record(
            "b", f"{http}/b.ply", "", status="failed", stage="read", message="no"
        )
        store.put(failed, None)
    return tmp_path / "c.sqlite"


def test_stored_urls_are_not_fetched_unasked(catalogue: Path, http: str) -> None:
    words = (
        rf"names scans at {re.escape(http)}, which are not fetched unasked, .*--remote"
    )
    for again in (check, retry):
        with pytest.raises(InputError, match=words):
            again(catalogue)
    asked: list[str] = []

    def unwilling(hosts: Sequence[str]) -> bool:
        asked.extend(hosts)
        return False

    with pytest.raises(InputError, match=words):
        retry(catalogue, remote=unwilling)
    assert asked == [http]
    assert re.search(words, refusal("catalogue", "check", "-c", catalogue))
    assert Server.asked == []


@pytest.mark.slow
def test_stored_urls_are_fetched_when_that_is_allowed(catalogue: Path) -> None:
    assert check(catalogue, remote=True).n_recomputed == 0  # its content is another one
    assert [record.id for record in retry(catalogue, remote=True, workers=1).failed] == [
        "b"
    ]
    assert {path for path in Server.asked} == {"/a.ply", "/b.ply"}


@pytest.mark.slow
@pytest.mark.parametrize(("answer", "asked"), [("n", set()), ("y", {"/a.ply"})])
def test_a_terminal_is_asked(
    catalogue: Path, http: str, answer: str, asked: set[str]
) -> None:
    ours, theirs = pty.openpty()
    words = ["catalogue", "check", "-c", str(catalogue)]
    os.write(ours, f"{answer}\n".encode())
    with subprocess.Popen(
        [sys.executable, "-m", "pcretrieve", *words],
        stdin=theirs,
        stdout=subprocess.DEVNULL,
        stderr=theirs,
    ) as running:
        os.close(theirs)
        text = b""
        try:
            while part := os.read(ours, 4096):
                text += part
        except OSError:
            pass
        running.wait()
    os.close(ours)
    shown = " ".join(text.decode().split())
    assert f"names scans at {http}. Fetch them?" in shown
    assert set(Server.asked) == asked
