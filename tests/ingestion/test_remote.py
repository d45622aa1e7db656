"""Scans at URLs: found, hashed by what their stores say, and read from copies that do not stay."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Event, Thread
from typing import Any
from uuid import uuid4

import numpy as np
import pytest
import shapes
from commands import run
from processes import in_this_process

from pcretrieve import Catalogue, ingest, read_scan, write_mesh
from pcretrieve.errors import InputError, ScanReadError
from pcretrieve.formats import ScanPath, remote
from pcretrieve.gallery.fitted import signatures
from pcretrieve.ingestion.discover import discover

fsspec = pytest.importorskip(
    "fsspec", reason="fsspec is not installed (the extra remote)"
)

OPTIONS: dict[str, Any] = {"surface": {"mode": "keep"}}


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two meshes, one of them in a subfolder; an array file, and files that are not scans."""
    made = tmp_path_factory.mktemp("scans")
    (made / "more").mkdir()
    write_mesh(shapes.ellipsoid((1, 2, 3), subdivisions=3), made / "egg.ply")
    write_mesh(shapes.ellipsoid((1, 1, 3), subdivisions=3), made / "more" / "cigar.off")
    (made / "labels.csv").write_text("file,class\negg,round\n")
    (made / "photo.jpg").write_bytes(b"jpg")
    return made


@pytest.fixture
def http(tmp_path: Path) -> Iterator[str]:
    pytest.importorskip("aiohttp", reason="aiohttp is not installed (the extra remote)")
    with ThreadingHTTPServer(
        ("127.0.0.1", 0), partial(Quiet, directory=str(tmp_path))
    ) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()


@pytest.fixture(scope="module")
def s3(folder: Path) -> Iterator[str]:
    """A bucket of a server that is written in Python; its address is told to clients by the environment."""
    s3fs = pytest.importorskip("s3fs", reason="s3fs is not installed (the extra remote)")
    server_module = pytest.importorskip(
        "moto.server", reason="moto is not installed (the extra dev)"
    )
    server = server_module.ThreadedMotoServer(
        ip_address="127.0.0.1", port=0, verbose=False
    )
    server.start()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(
            "AWS_ENDPOINT_URL", "http://{}:{}".format(*server.get_host_and_port())
        )
        for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_DEFAULT_REGION"):
            patch.setenv(name, "us-east-1")
        # A worker of pytest-xdist may set this fixture up twice. Clients are kept, with the address of the
        # server that they were made for, and the buckets of all servers of a process are the same.
        s3fs.S3FileSystem.clear_instance_cache()
        store, bucket = s3fs.S3FileSystem(), f"bucket-{uuid4().hex}"
        store.mkdir(bucket)
        store.put(f"{folder}/", bucket, recursive=True)
        yield f"s3://{bucket}"
    s3fs.S3FileSystem.clear_instance_cache()
    server.stop()


def test_ingest_skips_what_it_has_until_the_content_changes(
    folder: Path, tmp_path: Path
) -> None:
    store, memory = fsspec.filesystem("file"), f"file://{tmp_path}/store"
    store.put(f"{folder}/", memory, recursive=True)
    catalogue, here = tmp_path / "c.sqlite", in_this_process
    first = ingest(memory, catalogue, options=OPTIONS, executor=here)
    assert [record.path for record in first.done] == [
        f"{memory}/egg.ply",
        f"{memory}/more/cigar.off",
    ]
    assert len(ingest(memory, catalogue, executor=here).held) == 2
    write_mesh(shapes.ellipsoid((2, 2, 3), subdivisions=3), tmp_path / "other.off")
    store.put_file(str(tmp_path / "other.off"), f"{memory}/more/cigar.off")
    again = ingest(memory, catalogue, executor=here)
    assert [record.path for record in again.held] == [f"{memory}/egg.ply"]
    assert [record.path for record in again.done] == [f"{memory}/more/cigar.off"]


@pytest.mark.slow
def test_ingest_of_a_bucket_equals_that_of_a_folder(
    s3: str, folder: Path, tmp_path: Path
) -> None:
    """The worker processes make the copies."""
    arguments = ("--surface", "keep", "--labels", folder / "labels.csv", "--json")
    run("ingest", s3, "-c", tmp_path / "s3.sqlite", *arguments)
    ingest(folder, tmp_path / "f.sqlite", options=OPTIONS, labels=folder / "labels.csv")
    with (
        Catalogue(tmp_path / "s3.sqlite") as made,
        Catalogue(tmp_path / "f.sqlite") as expected,
    ):
        assert signatures(made) == signatures(expected)
        assert sorted(record.path for record in made.records()) == [
            f"{s3}/egg.ply",
            f"{s3}/more/cigar.off",
        ]
    assert "2 known already" in run("ingest", s3, "-c", tmp_path / "s3.sqlite").output


def test_copies_of_what_a_scan_names(
    http: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files that are elsewhere, or large, are not copied."""
    views = tmp_path / "views"
    views.mkdir()
    for path in (tmp_path / "egg.ply", views / "one.ply"):
        write_mesh(shapes.ellipsoid((1, 2, 3), subdivisions=3), path)
    (views / "all.conf").write_text("bmesh one.ply 0 0 0 0 0 0 1\n")
    (views / "out.conf").write_text("bmesh ../egg.ply 0 0 0 0 0 0 1\n")
    read, expected = read_scan(f"{http}/views/all.conf"), read_scan(views / "all.conf")
    np.testing.assert_array_equal(read.to_open3d().points, expected.to_open3d().points)
    with pytest.raises(ScanReadError, match=r"egg\.ply"):
        read_scan(f"{http}/views/out.conf")
    monkeypatch.setattr(remote, "LARGEST", 100)
    with pytest.raises(
        ScanReadError, match=r"/egg\.ply has more than 100 bytes: copy it"
    ):
        read_scan(f"{http}/egg.ply")


# --- limits ---------------------------------------------------------------------------------------------

# The largest size of a file at a URL, as the guide says; bytes.
LARGEST = 4 << 30

# Where an endless file ends nevertheless, so that a disk is not filled where nothing limits it; bytes.
MOST_SENT = 1 << 27


class Odd(Quiet):
    """Answers with more than it should, or never, by the name of the file."""

    has_ended = Event()
    sent = 0

    def do_HEAD(self) -> None:
        if self.path == "/silent.ply":
            self.has_ended.wait()
            return
        self.send_response(200)
        if self.path != "/endless.ply":
            self.send_header("ETag", "x")
            self.send_header("Content-Length", self.path[1:].removesuffix(".ply"))
        self.end_headers()

    def do_GET(self) -> None:
        self.do_HEAD()
        with suppress(ConnectionError):
            while self.path == "/endless.ply" and Odd.sent < MOST_SENT:
                Odd.sent += self.wfile.write(bytes(1 << 16))


@pytest.fixture
def odd() -> Iterator[str]:
    pytest.importorskip("aiohttp", reason="aiohttp is not installed (the extra remote)")
    Odd.has_ended, Odd.sent = Event(), 0
    with ThreadingHTTPServer(("127.0.0.1", 0), Odd) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        Odd.has_ended.set()
        server.shutdown()


def test_a_file_that_is_declared_too_large_is_not_fetched(odd: str) -> None:
    with pytest.raises(
        ScanReadError, match=rf"\.ply has more than {LARGEST} bytes: copy it to"
    ):
        read_scan(f"{odd}/{LARGEST + 1}.ply")
    with pytest.raises(ScanReadError) as raised:
        read_scan(f"{odd}/{LARGEST}.ply")  # of which nothing comes
    assert "has more than" not in str(raised.value)


def test_a_file_without_an_end_is_not_fetched_further(
    odd: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(remote, "LARGEST", 1 << 20)
    with pytest.raises(
        ScanReadError, match=r"/endless\.ply has more than 1048576 bytes: copy it"
    ):
        read_scan(f"{odd}/endless.ply")
    assert Odd.sent < MOST_SENT


def test_a_server_that_does_not_answer_is_one_failure(odd: str, tmp_path: Path) -> None:
    silent = f"{odd}/silent.ply"
    (failure,) = ingest(
        silent, tmp_path / "c.sqlite", executor=in_this_process, timeout=1
    ).failed
    assert (failure.path, failure.stage) == (silent, "read")
    assert (
        failure.message is not None
        and "was not read within 1 s: raise --t" in failure.message
    )


@pytest.mark.slow
def test_a_scan_that_does_not_arrive_is_one_failure(odd: str, tmp_path: Path) -> None:
    (failure,) = ingest(
        f"{odd}/7.ply", tmp_path / "c.sqlite", timeout=1, workers=1
    ).failed
    assert (failure.stage, failure.error) == ("worker", "StageTimeout")


def test_what_is_a_url() -> None:
    for name, url in {
        "https://host/a.ply": "https://host/a.ply",
        "s3://bucket/a b.ply": "s3://bucket/a b.ply",
        "FILE:///a.ply": "FILE://a.ply",
        "file:///a.ply": "file:///a.ply",
        "c:/scans/a.ply": None,
        "/scans/http://host/a.ply": None,
        "simplecache::https://host/a.ply": None,
        "http:a.ply": None,
        "3d://a.ply": None,
    }.items():
        assert ScanPath.parse(name).url == url, name


def test_stores_that_are_not_there() -> None:
    for name, words in {
        "nowhere://a/b/": "a URL must begin with http, https, s3, file, got nowhere://a/b: copy",
        "sftp://host/folder/": "a URL must begin with http, https, s3, file",
        "http://127.0.0.1:9/folder/": "cannot look into",
        "file:///nowhere/at/all/": "names no scans",
    }.items():
        with pytest.raises(InputError, match=words):
            discover([name])
