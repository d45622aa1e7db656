"""What an upload may cost: its bytes, as they stream, and how many wait; a failure leaves no file.

Hostile files and names are in `test_uploads`.
"""

from __future__ import annotations

import asyncio
import shutil
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from search_server import egg, running
from search_site import OWN_ORIGIN, ask, opened
from starlette.requests import Request

from pcretrieve import Catalogue
from pcretrieve.errors import InputError
from pcretrieve.web import application as application_module, requests as requests_module
from pcretrieve.web.application import Site
from pcretrieve.web.keeping import Collection
from pcretrieve.web.requests import Refused, received

UPLOAD = "/scans?name=a.off"


@pytest.fixture(autouse=True)
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """Connections of refused scans are closed at once."""
    monkeypatch.setattr(application_module, "LINGER", 0.0)


@pytest.fixture
def site(eggs: Path) -> Iterator[Site]:
    with opened(eggs, most_bytes=1000) as site:
        yield site


def upload(site: Site, chunks: Iterable[bytes], **headers: str) -> Any:
    return ask(site, UPLOAD, method="POST", headers=OWN_ORIGIN | headers, chunks=chunks)


class Chunks:
    """Chunks of a body without an end, and how many of them were asked for."""

    n_read = 0

    def __iter__(self) -> Iterator[bytes]:
        while True:
            self.n_read += 1
            yield bytes(100)


def store(chunks: Iterable[bytes], path: Path, most_bytes: int, *announced: str) -> None:
    left = iter(chunks)

    async def receive() -> dict[str, Any]:
        for chunk in left:
            return {"type": "http.request", "body": chunk, "more_body": True}
        return {"type": "http.request", "body": b"", "more_body": False}

    headers = [(b"content-length", each.encode()) for each in announced]
    request = Request({"type": "http", "headers": headers}, receive)
    asyncio.run(received(request, path, most_bytes=most_bytes))


def test_an_upload_of_the_largest_size_is_stored(tmp_path: Path) -> None:
    body = [b"abc", b"", b"defghij"]
    for number, announced in enumerate(((), ("10",), ("3",), ("nonsense",))):
        store(body, path := tmp_path / str(number), 10, *announced)
        assert path.read_bytes() == b"abcdefghij"
    with pytest.raises(FileExistsError):
        store(body, path, 10)


def test_bytes_are_counted_while_they_stream(site: Site, tmp_path: Path) -> None:
    """Whatever length was announced, or none: no more is read than what is one too many."""
    for announced in ((), ("5",), ("-1",), ("nonsense",)):
        endless, path = Chunks(), tmp_path / "-".join(("scan", *announced))
        with pytest.raises(Refused, match="at most 1000 bytes") as caught:
            store(endless, path, 1000, *announced)
        assert caught.value.status == 413
        assert endless.n_read == 11
        assert path.stat().st_size == 1000
    endless = Chunks()
    answer = upload(site, endless)
    assert (answer.status, endless.n_read) == (413, 11)
    assert "at most 1000 bytes" in answer.json["message"]
    assert answer.headers["connection"] == "close"
    # One byte more than the limit, in the last chunk.
    assert upload(site, [bytes(1000), b"x"]).status == 413


def test_a_length_that_is_too_large_is_refused_before_a_byte_is_read(site: Site) -> None:
    for announced in ("1001", "9" * 5000):
        endless = Chunks()
        assert upload(site, endless, **{"content-length": announced}).status == 413
        assert endless.n_read == 0
    assert upload(site, []).status == 400


def test_a_body_that_does_not_end_is_given_up(
    site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(requests_module, "RECEIVING_TIMEOUT", 0.1)

    async def never() -> dict[str, Any]:
        await asyncio.sleep(60)
        raise AssertionError("waited for")

    request = Request({"type": "http", "headers": []}, never)
    started = time.monotonic()
    with pytest.raises(Refused, match="has not arrived within") as caught:
        asyncio.run(received(request, tmp_path / "scan", most_bytes=10))
    assert caught.value.status == 408
    assert time.monotonic() < started + 30


def test_a_ninth_scan_is_refused_until_one_of_eight_is_gone(site: Site) -> None:
    jobs = [site.jobs.begin(f"{number}.off") for number in range(8)]
    endless = Chunks()
    answer = upload(site, endless)
    assert (answer.status, endless.n_read) == (503, 0)
    assert "8 scans are waiting" in answer.json["message"]
    # A refused upload gives its place back, and its folder is removed.
    site.jobs.abandon(jobs.pop())
    for _ in range(3):
        assert upload(site, Chunks()).status == 413
    jobs.append(site.jobs.begin("last.off"))
    assert upload(site, []).status == 503
    folders = {job.folder for job in jobs}
    assert {*jobs[0].folder.parent.glob("upload-*")} == folders


def test_a_server_with_a_limit_refuses_a_scan_beyond_it(
    eggs: Path, tmp_path: Path
) -> None:
    """`--max-upload` is in megabytes, of 1,000,000 bytes; the smallest is one."""
    first = "import pcretrieve.web.application as a; a.LINGER = 0.0"
    with running(eggs, "--max-upload", "1", first=first, temporary=tmp_path) as server:
        assert b"at most 1 MB" in server.ask("/").body
        for body in (bytes(1_000_001), iter([bytes(500_000), bytes(500_000), b"x"])):
            refused = server.send("a.npy", body)
            assert refused.status == 413
            assert "at most 1000000 bytes" in refused.json["message"]
        assert not [*tmp_path.rglob("scan.npy")]
        accepted = server.send("a.npy", iter([bytes(500_000), bytes(500_000)]))
        assert accepted.status == 202


def test_what_cannot_be_kept_leaves_no_file_and_no_shape(
    eggs: Path, tmp_path: Path
) -> None:
    """A scan that fails, and one that the catalogue has already under another name."""
    folder = tmp_path / "kept"
    folder.mkdir()
    path = Path(shutil.copy(eggs, tmp_path / "collection.sqlite"))
    collection = Collection(str(path), folder, timeout=60.0, memory=4.0)
    (tmp_path / "bad.off").write_bytes(b"OFF\n1 1 1\nnothing")
    egg(tmp_path)
    with Catalogue(path) as catalogue:
        before = catalogue.labels()
        with pytest.raises(InputError, match="the scan failed in read"):
            collection.add(tmp_path / "bad.off", "bad", None)
        assert [*folder.iterdir()] == []
        assert catalogue.labels() == before
        kept = collection.add(tmp_path / "egg.off", "mine", "a class")
        assert (kept.id, kept.label) == ("mine", "a class")
        with pytest.raises(InputError, match="has this scan already, as 'mine'"):
            collection.add(tmp_path / "egg.off", "again", None)
        with pytest.raises(InputError, match="there is a shape 'mine' already"):
            collection.add(tmp_path / "bad.off", "mine", None)
        assert [*folder.iterdir()] == [folder / "mine.off"]
        assert catalogue.labels() == before | {"mine": "a class"}


def test_lists_are_those_of_this_moment(eggs: Path, tmp_path: Path) -> None:
    """Answers are kept, until anything changes: shapes, failures, paths, and which way is up."""
    path = Path(shutil.copy(eggs, tmp_path / "collection.sqlite"))
    with ExitStack() as stack:
        site = stack.enter_context(opened(path))
        other = stack.enter_context(Catalogue(path))

        def ids(query: str = "") -> list[str]:
            return [shape["id"] for shape in ask(site, f"/shapes{query}").json["shapes"]]

        first = ask(site, "/")
        assert ask(site, "/").body == first.body
        assert len(ids()) == 13 and ids("?state=failed") == ["broken"]
        failed = other.record("broken")
        other.put(replace(failed, message="other words"))  # which is no new revision
        shown = ask(site, "/shapes?state=failed").json["shapes"]
        assert [shape["message"] for shape in shown] == ["other words"]
        other.remove("Egg00")
        assert "Egg00" not in ids() and b"Egg00" not in ask(site, "/").body
        other.rows.revise(moved={other.record("Egg01").path: "/elsewhere/moved.off"})
        assert ask(site, "/shapes?q=Egg01").json["shapes"][0]["file"] == "moved.off"
        assert b"the axis y is up" not in ask(site, "/").body
        turned = ask(site, "/up", method="POST", headers=OWN_ORIGIN, chunks=[b"up=y"])
        assert turned.status == 303
        assert b"the axis y is up" in ask(site, "/").body


def test_a_page_names_classes_unless_they_are_too_many(
    eggs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    typed = b'<input type="search" name="label"'
    for most, address, choice in (
        (3, "/?label=none", b'<ul class="classes"'),
        (2, "/?label=none", typed),
        (3, "/shape/Egg00?label=%3Ckind+0%3E", b'<select name="label">'),
        (2, "/shape/Egg00?label=%3Ckind+0%3E", typed),
    ):
        monkeypatch.setattr(application_module, "MOST_CLASSES", most)
        with opened(eggs) as site:
            page = ask(site, address).body
        assert choice in page
        assert (b"&lt;kind 2&gt;" in page) == (most == 3)
