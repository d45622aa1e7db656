"""An exported site: files that lead to each other, and need no server."""

from __future__ import annotations

import re
from html import unescape
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit

import browsers
import pytest
from commands import refusal, run
from search_server import NASTY, SECRETS

from pcretrieve import Catalogue, serve

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@pytest.fixture(scope="module")
def site(eggs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("export") / "site"
    done = run("serve", "-c", eggs, "--export", folder)
    assert done.stdout.strip() == str(folder / "index.html")
    return folder


def links(page: Path) -> set[Path]:
    """The files to which a page leads, and those that it shows or runs."""
    found = re.findall(
        r'(?:href|src|data-picture|data-scene|action)="(?!data:|#)([^"]*)"',
        page.read_text("utf-8"),
    )
    for each in found:
        parts = urlsplit(unescape(each))
        assert not parts.scheme and not parts.netloc and parts.path[:1] not in ("/", "")
    return {
        (page.parent / unquote(urlsplit(unescape(each)).path)).resolve() for each in found
    }


def test_every_link_leads_to_a_file_and_all_files_are_reached(
    site: Path, eggs: Path
) -> None:
    waiting, seen = [site / "index.html"], set[Path]()
    while waiting:
        page = waiting.pop()
        if page in seen:
            continue
        seen.add(page)
        assert page.is_file() and page.is_relative_to(site), page
        if page.suffix == ".html":
            waiting += links(page)
    assert seen == {file for file in site.rglob("*") if file.is_file()}
    with Catalogue(eggs) as store:
        assert len(list((site / "shapes").iterdir())) == len(store.labels())


def test_pages_take_no_scan_and_name_no_folder(site: Path) -> None:
    for page in site.rglob("*.html"):
        text = page.read_text("utf-8")
        assert "<form" not in text and 'type="file"' not in text
        assert not [secret for secret in SECRETS if secret in text]
        words = unescape(re.sub(r"<[^>]*>", " ", text))
        assert "None" not in words.split()
    first = unescape((site / "index.html").read_text("utf-8"))
    assert NASTY in first and "failed: read" in first


def test_a_folder_with_files_is_left_alone(eggs: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("kept")
    assert "a new or an empty folder" in refusal(
        "serve", "-c", eggs, "--export", tmp_path
    )
    assert "not read-only" in refusal(
        "serve", "-c", eggs, "--export", tmp_path / "new", "--keep", tmp_path
    )
    assert [file.name for file in tmp_path.iterdir()] == ["mine.txt"]
    serve(eggs, export=tmp_path / "new")
    assert (tmp_path / "new" / "index.html").exists()


@pytest.mark.slow
def test_a_browser_opens_it_without_a_server(browser: Browser, site: Path) -> None:
    for size, dark in ((browsers.DESKTOP, False), (browsers.PHONE, True)):
        with browsers.opened(
            browser, (site / "index.html").as_uri(), size, dark=dark
        ) as page:
            shown = page.locator("#results .shapes li:visible")
            sizes = page.locator(".classes button").all_inner_texts()
            assert sizes == ["<kind 0>\n4", "<kind 1>\n4", "<kind 2>\n4"]
            page.locator(".classes button").nth(2).click()
            assert shown.count() == 4
            page.locator(".classes button").nth(2).click()
            assert shown.count() == 13
            page.get_by_label("Search by name or class").fill("egg1 kind")
            assert page.locator("#results .shapes li:visible").count() == 4
            page.locator("#results .shapes li:visible a").first.click()
            page.get_by_role("heading", name="Egg10").wait_for()
            assert browsers.overflow(page) <= 0
            page.get_by_role("link", name="Map").click()
            page.locator(".map image[href]").nth(11).wait_for()
            assert browsers.overflow(page) <= 0
