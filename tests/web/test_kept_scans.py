"""Scans that are kept, which must be asked for: by whom, under which names, and for how long."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlencode

import pytest
from commands import refusal
from search_server import Server, egg, running

pytestmark = pytest.mark.slow


def files_in(folder: Path) -> set[str]:
    return {path.name for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def collection(eggs: Path, tmp_path: Path) -> Path:
    """A copy of the eggs that a server may change."""
    return Path(shutil.copy(eggs, tmp_path / "collection.sqlite"))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "kept").mkdir()
    return tmp_path / "kept"


@pytest.fixture
def keeper(collection: Path, folder: Path, tmp_path: Path) -> Iterator[Server]:
    """A server that keeps scans."""
    (tmp_path / "temporary").mkdir()
    with running(collection, "--keep", str(folder), temporary=tmp_path / "temporary") as server:
        yield server


REFUSED: list[tuple[dict[str, str], str]] = [
    *(
        ({"id": name}, "a name must be letters")
        for name in ("", "../../evil", "/etc/passwd", ".hidden", "a*", "x" * 101, "a\0b")
    ),
    ({}, "a name must be letters"),
    ({"id": "Egg00"}, "there is a shape 'Egg00' already"),
    ({"id": "fine", "label": "a\nb"}, "a class must be"),
    ({"id": "fine", "label": "x" * 201}, "a class must be"),
]


def test_nobody_else_and_under_no_other_name_may_have_a_scan_kept(
    keeper: Server, folder: Path, tmp_path: Path
) -> None:
    job = keeper.outcome("egg.off", egg(tmp_path))
    for fields, said in REFUSED:
        refused = keeper.ask(f"/scans/{job['job']}/keep?{urlencode(fields)}", method="POST")
        assert refused.status == 400, (fields, refused.body)
        assert said in refused.json["message"]
        by_form = keeper.ask(f"/scan/{job['job']}/keep", method="POST", body=urlencode(fields).encode())
        assert by_form.status == 400 and b"<main" in by_form.body, fields
    cookie = keeper.ask(f"/?token={keeper.token}", bearer=False).headers["set-cookie"].split(";")[0]
    for headers in ({}, {"Cookie": cookie}, {"Cookie": cookie, "Origin": "http://evil.example"}):
        for address in (f"/scans/{job['job']}/keep?id=evil", f"/scan/{job['job']}/keep"):
            answer = keeper.ask(address, method="POST", body=b"id=evil", headers=headers, bearer=False)
            assert answer.status == 403
    long = keeper.ask(f"/scan/{job['job']}/keep", method="POST", body=b"id=" + b"x" * 20_000)
    assert long.status == 413
    assert files_in(folder) == set()
    assert keeper.ask("/shapes").json["total"] == 13
    assert keeper.ask(f"/scans/{job['job']}").json["kept_as"] is None


def test_what_the_catalogue_has_or_cannot_have_is_not_kept_and_ends_with_the_server(
    keeper: Server, folder: Path, tmp_path: Path
) -> None:
    scan = egg(tmp_path)
    first, second = keeper.outcome("a.off", scan), keeper.outcome("b.off", scan)
    assert keeper.ask(f"/scans/{first['job']}/keep?id=one", method="POST").status == 201
    refused = keeper.ask(f"/scans/{second['job']}/keep?id=two", method="POST")
    assert (refused.status, refused.json["message"]) == (400, "the catalogue has this scan already, as 'one'")
    bad = keeper.outcome("bad.off", b"OFF\n1 1 1\nnothing")
    assert keeper.ask(f"/scans/{bad['job']}/keep?id=three", method="POST").status == 404
    assert keeper.ask("/scans/none/keep?id=four", method="POST").status == 404
    assert files_in(folder) == {"one.off"}
    assert keeper.ask("/shapes?q=one").json["total"] == 1
    assert "scan.off" in files_in(tmp_path / "temporary"), "until it is too late to ask for it"
    keeper.process.terminate()
    keeper.process.wait(60)
    assert files_in(tmp_path / "temporary") == set()


def test_a_server_that_only_reads_takes_and_keeps_no_scan(eggs: Path, tmp_path: Path) -> None:
    with running(eggs, "--read-only") as closed:
        assert closed.send("a.off", b"OFF").status == 404
        assert b'id="upload"' not in closed.ask("/").body
    words = refusal("serve", "-c", eggs, "--read-only", "--keep", tmp_path)
    assert "choose one of --read-only and --keep" in words


def test_what_a_killed_server_leaves_is_removed_by_the_next(
    keeper: Server, collection: Path, tmp_path: Path
) -> None:
    temporary = tmp_path / "temporary"
    keeper.outcome("egg.off", egg(tmp_path))
    keeper.process.kill()
    keeper.process.wait(60)
    assert "scan.off" in files_in(temporary)
    with running(collection, temporary=temporary) as server:
        assert server.ask("/shapes").status == 200
        assert "scan.off" not in files_in(temporary)
