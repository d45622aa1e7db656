"""Chromium, as users have it, and pages in it that may not fail without a word."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

NAMES = ("chromium", "chromium-browser", "google-chrome")

# Without these, the browser asks for updates of its own, and waits for what a computer without network does
# not answer.
QUIET = (
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)

DESKTOP = (1280, 900)
PHONE = (360, 740)


@contextmanager
def chromium() -> Iterator[Browser]:
    """A browser without a window; tests are skipped where there is none.

    While it is open, no event loop of asyncio can be started in this thread, because playwright runs one.
    """
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed (the extra dev)"
    )
    found = next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        pytest.skip(f"none of {', '.join(NAMES)} is installed")
    arguments = [*QUIET, *(["--no-sandbox"] if os.geteuid() == 0 else [])]
    with playwright.sync_playwright() as started:
        browser: Browser = started.chromium.launch(executable_path=found, args=arguments)
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def opened(
    browser: Browser,
    address: str,
    size: tuple[int, int] = DESKTOP,
    *,
    dark: bool = False,
    refused: bool = False,
) -> Iterator[Page]:
    """A page, which must make no error in the console and no request to another origin while it is open.

    Answers with an error status are errors too, unless the test makes requests that are refused.
    """
    width, height = size
    context = browser.new_context(
        viewport={"width": width, "height": height},
        color_scheme="dark" if dark else "light",
        accept_downloads=True,
    )
    errors: list[str] = []
    requests: list[str] = []
    try:
        page = context.new_page()
        page.set_default_timeout(60_000)
        page.on(
            "console",
            lambda message: (
                errors.append(message.text) if message.type == "error" else None
            ),
        )
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("request", lambda request: requests.append(request.url))
        page.goto(address)
        yield page
    finally:
        context.close()
    if refused:  # a browser logs the status of an answer, sooner or later
        errors = [
            error
            for error in errors
            if "the server responded with a status of 4" not in error
        ]
    assert not errors, errors
    own = ("data:", "blob:", "file:", origin(address))
    assert all(url.startswith(own) for url in requests), requests


def origin(address: str) -> str:
    """Scheme, host and port of an address."""
    return "/".join(address.split("/")[:3])


def violations(page: Page) -> list[str]:
    """What axe-core finds against the accessibility of a page: rule, element, and what to do."""
    axe = pytest.importorskip(
        "axe_playwright_python.sync_playwright",
        reason="axe is not installed (the extra dev)",
    )
    found = axe.Axe().run(page).response["violations"]
    return [
        f"{rule['id']}: {node['html'][:200]}: {node['failureSummary']}"
        for rule in found
        for node in rule["nodes"]
    ]


def overflow(page: Page) -> int:
    """By how many pixels a page is wider than its window."""
    pixels: int = page.evaluate(
        "document.scrollingElement.scrollWidth - window.innerWidth"
    )
    return pixels


def too_small(page: Page) -> list[str]:
    """What is pressed, and is lower than a finger; but links within a sentence, as WCAG 2.2 has it."""
    found: list[str] = page.locator("a, button, input, select, summary").evaluate_all(
        """all => all.filter(it => it.checkVisibility() && !it.closest("p, svg, .skip")
          && !it.matches("[type=hidden], .unseen, .skip, [type=checkbox]"))
          .filter(it => it.offsetHeight < 44).map(it => it.outerHTML.slice(0, 120))"""
    )
    return found


def jump(page: Page) -> float:
    """By how much a page has moved without being touched: the score of layout shifts of Chromium."""
    moved: float = page.evaluate(
        """() => new Promise(done => {
          let sum = 0;
          new PerformanceObserver(list => { for (const one of list.getEntries()) sum += one.value; })
            .observe({type: "layout-shift", buffered: true});
          setTimeout(() => done(sum), 1000);
        })"""
    )
    return moved
