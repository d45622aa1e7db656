"""Uploaded scans: their inspection page and picture, and how they are kept, which must be asked for."""

from __future__ import annotations

import os
import re
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlencode

import pytest
from browsers import DESKTOP, PHONE, opened, origin, overflow, violations
from click.testing import CliRunner
from search_server import Server, egg, running

from pcretrieve import Catalogue
from pcretrieve.catalogue import find_defects
from pcretrieve.cli.main import cli

if TYPE_CHECKING:
    from playwright.sync_api import Browser

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


# --- the inspection ---------------------------------------------------------------------------------------


def test_a_scan_is_inspected_beside_its_answer(server: Server, tmp_path: Path) -> None:
    job = server.outcome("my <b>.off", egg(tmp_path))
    assert (job["state"], job["inspection"], job["kept_as"]) == ("done", "done", None)
    page = server.ask(f"/scan/{job['job']}").body.decode()
    assert f'href="/scan/{job["job"]}/inspection"' in page
    assert "/keep" not in page, "this server keeps nothing"
    refused = server.ask(f"/scans/{job['job']}/keep?id=mine", method="POST")
    assert refused.status == 404
    assert "this server keeps no scans: start it with --keep FOLDER" in refused.json["message"]
    picture = server.ask(f"/scans/{job['job']}/thumbnail.png")
    assert picture.headers["content-type"] == "image/png" and picture.body.startswith(b"\x89PNG")
    answer = server.ask(f"/scan/{job['job']}/inspection")
    inspection = answer.body.decode()
    assert "my &lt;b&gt;.off" in inspection and "From four sides" in inspection
    # What the content policy of the server would not let the browser do, and what is nobody's business.
    assert not re.findall(r"<style|style=|<script>|\son\w+=", inspection)
    assert "'unsafe-inline'" not in inspection + answer.headers["content-security-policy"]
    assert str(tmp_path) not in inspection and "/tmp" not in inspection


def test_a_scan_that_fails_is_inspected_too(server: Server) -> None:
    job = server.outcome("bad.off", b"OFF\n1 1 1\nnothing")
    assert (job["state"], job["inspection"]) == ("failed", "done")
    inspection = server.ask(f"/scan/{job['job']}/inspection").body.decode()
    assert "No signature, the read stage failed" in inspection
    assert "/tmp" not in inspection
    assert server.ask(f"/scans/{job['job']}/thumbnail.png").status == 404


def test_inspections_are_accessible_and_fit(browser: Browser, server: Server, tmp_path: Path) -> None:
    job = server.outcome("egg.off", egg(tmp_path))
    for size, dark in ((DESKTOP, False), (PHONE, True)):
        with opened(browser, server.address, size, dark=dark) as page:
            for address in (f"/scan/{job['job']}", f"/scan/{job['job']}/inspection"):
                page.goto(f"{origin(server.address)}{address}")
                assert not violations(page)
                assert overflow(page) <= 0
            assert page.locator("canvas").is_visible(), "the viewer runs"
            colours = page.locator(".key rect").evaluate_all(
                "all => all.map(it => getComputedStyle(it).fill)"
            )
            assert colours and "rgb(0, 0, 0)" not in colours


# --- keeping ----------------------------------------------------------------------------------------------


def test_a_scan_is_kept_when_it_is_asked_for(
    browser: Browser, keeper: Server, collection: Path, folder: Path, tmp_path: Path
) -> None:
    scan = egg(tmp_path)
    with opened(browser, keeper.address) as page:
        page.locator("input[type=file]").set_input_files(tmp_path / "egg.off")
        page.get_by_role("link", name="Inspection of the scan").wait_for()
        assert files_in(folder) == set()
        page.keyboard.press("Tab")
        page.get_by_text("Keep this scan in the collection").press("Enter")
        page.get_by_label("Name", exact=True).fill("anna sits")
        page.locator("input[name=label]").fill("anna")
        assert not violations(page)
        page.locator("input[name=label]").press("Enter")
        page.wait_for_url("**/shape/anna%20sits")
        page.get_by_role("heading", name="anna sits").wait_for()
        page.goto(f"{origin(keeper.address)}/?q=anna")
        page.get_by_text("1 shape", exact=True).wait_for()
    assert (folder / "anna sits.off").read_bytes() == scan
    found = keeper.outcome("again.off", scan)
    nearest = keeper.ask(f"/scans/{found['job']}/similar?k=1").json["results"][0]
    assert (nearest["id"], nearest["label"]) == ("anna sits", "anna")
    assert nearest["distance"] == pytest.approx(0, abs=1e-6)
    with Catalogue(collection) as store:
        record = store.record("anna sits")
        assert Path(record.path) == folder / "anna sits.off"
        assert "anna sits" not in {defect.shape_id for defect in find_defects(store)}
        assert store.thumbnail("anna sits") is not None


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


def test_a_server_that_only_reads_cannot_keep(eggs: Path, tmp_path: Path) -> None:
    words = ["serve", "-c", str(eggs), "--read-only", "--keep", str(tmp_path)]
    done = CliRunner().invoke(cli, words)
    assert (done.exit_code, "choose one of --read-only and --keep" in done.stderr) == (2, True)


def test_what_a_killed_server_leaves_is_removed_by_the_next(collection: Path, tmp_path: Path) -> None:
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    with running(collection, "--keep", str(tmp_path), temporary=temporary) as server:
        server.outcome("egg.off", egg(tmp_path))
        assert "scan.off" in files_in(temporary)
        os.kill(server.process.pid, signal.SIGKILL)
        server.process.wait(60)
        assert "scan.off" in files_in(temporary)
    with running(collection, temporary=temporary) as server:
        assert server.ask("/shapes").status == 200
        assert "scan.off" not in files_in(temporary)
