"""The search page in a real browser: by mouse, by keys alone, on a phone, in the dark, and by axe-core."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from browsers import (
    DESKTOP,
    PHONE,
    jump,
    opened,
    origin,
    overflow,
    too_small,
    violations,
)
from processes import wait_for
from search_server import Server, egg, running, write_many

from pcretrieve import Catalogue, search
from pcretrieve.ingestion.recomputing import find_defects

if TYPE_CHECKING:
    from playwright.sync_api import Browser, FileChooser, Page

pytestmark = pytest.mark.slow

# Every kind of page: a collection, one in which nothing was found, shapes, no match, a comparison, a map.
PAGES = (
    *(
        "/",
        "/?q=none",
        "/shape/Egg00",
        "/shape/Egg23",
        "/shape/broken",
        "/map",
        "/compare?a=Egg00&b=Egg23",
        "/compare",
    ),
    "/shape/Egg00?min_score=1&label=%3Ckind+2%3E",
)


# Largest score of layout shifts; .1 is called good, and pictures that have no size come to .3.
STILL = 0.02


@pytest.fixture
def page(browser: Browser, server: Server) -> Iterator[Page]:
    with opened(browser, server.address) as page:
        yield page


def names(page: Page) -> list[str]:
    """The names on the cards, without the ranks."""
    return [
        re.sub(r"^\d+ ", "", text)
        for text in page.locator("#results .shapes li a b").all_inner_texts()
    ]


def test_from_a_shape_to_its_nearest_and_on(page: Page, eggs: Path) -> None:
    page.locator("#results").get_by_text("Egg11", exact=True).click()
    page.get_by_role("heading", name="Egg11").wait_for()
    expected = [
        name for name in search(eggs, "Egg11", k=12).neighbors.ids if name != "Egg11"
    ]
    assert names(page) == expected
    page.locator("canvas[data-drawn]").wait_for()
    page.get_by_text("Change the search").click()
    page.get_by_label("Results").fill("3")
    page.get_by_label("Results").press("Enter")
    page.wait_for_url("**k=3**")
    page.locator("#results .shapes li").nth(3).wait_for(state="detached")
    first = names(page)[0]
    page.locator("#results .shapes li a").first.click()
    page.get_by_role("heading", name=first).wait_for()
    assert len(names(page)) == 3, "the settings go with the next query"
    page.go_back()
    page.locator("select[name=label]").select_option("<kind 2>")
    page.get_by_label("Least score").fill("1")
    page.get_by_label("Least score").press("Enter")
    page.get_by_text(re.compile("no shape has a score")).wait_for()
    assert names(page) == []


def test_two_shapes_turn_together(page: Page) -> None:
    page.locator("#results").get_by_text("Egg11", exact=True).click()
    page.get_by_role("link", name="Compare with Egg13").click()
    page.get_by_role("heading", name="Egg11 and Egg13").wait_for()
    page.locator("canvas[data-drawn]").nth(1).wait_for()
    before = [canvas.screenshot() for canvas in page.locator("canvas").all()]
    page.locator("canvas").first.focus()
    page.keyboard.press("ArrowUp")
    page.keyboard.press("ArrowLeft")
    after = [canvas.screenshot() for canvas in page.locator("canvas").all()]
    assert all(one != other for one, other in zip(before, after, strict=True))
    assert page.get_by_role("row", name="volume").count() == 1
    with page.expect_download() as mesh:
        page.get_by_role("link", name="GLB of Egg13").click()
    assert mesh.value.path().read_bytes().startswith(b"glTF")


def test_a_chosen_scan_is_answered_and_kept_when_it_is_asked_for(
    browser: Browser, eggs: Path, tmp_path: Path
) -> None:
    collection, scan, folder = (
        tmp_path / "collection.sqlite",
        egg(tmp_path),
        tmp_path / "kept",
    )
    folder.mkdir()
    shutil.copy(eggs, collection)
    with running(collection, "--keep", str(folder)) as keeper:
        with opened(browser, keeper.address) as page:
            page.locator("input[type=file]").set_input_files(tmp_path / "egg.off")
            page.wait_for_url("**/scan/*")
            page.get_by_role("heading", name="Nearest shapes").wait_for()
            page.get_by_text(re.compile("Processed in")).click()
            assert page.locator("#stages").get_by_text("spectrum").is_visible()
            assert names(page) == list(
                search(eggs, tmp_path / "egg.off", k=12).neighbors.ids
            )
            page.get_by_role("link", name="Inspection of the scan").wait_for()
            assert [*folder.iterdir()] == []
            page.keyboard.press("Tab")
            page.get_by_text("Keep this scan in the collection").press("Enter")
            page.get_by_label("Name", exact=True).fill("anna sits")
            page.locator("input[name=label]").fill("anna")
            assert not violations(page)
            page.locator("input[name=label]").press("Enter")
            page.wait_for_url("**/shape/anna%20sits")
            page.get_by_role("heading", name="anna sits").wait_for()
            page.get_by_role("button", name="Inspect this scan").click()
            page.wait_for_url("**/inspection")
            page.get_by_role("link", name="Back to the shape").click()
            page.get_by_role("heading", name="anna sits").wait_for()
        assert (folder / "anna sits.off").read_bytes() == scan
        found = keeper.outcome("again.off", scan)
        nearest = keeper.ask(f"/scans/{found['job']}/similar?k=1").json["neighbors"][0]
        said = keeper.ask(f"/scan/{found['job']}").body.decode()
        assert "This is anna" in said and "This is the stored scan" in said
    assert (nearest["id"], nearest["label"]) == ("anna sits", "anna")
    assert nearest["distance"] == pytest.approx(0, abs=1e-6)
    with Catalogue(collection) as store:
        assert Path(store.record("anna sits").path) == folder / "anna sits.off"
        assert "anna sits" not in {defect.shape_id for defect in find_defects(store)}
        assert store.thumbnail("anna sits") is not None


def test_a_dropped_scan_is_processed_and_fails_in_words(page: Page) -> None:
    page.evaluate(
        """() => {
          const given = new DataTransfer();
          given.items.add(new File(["OFF\\n1 1 1\\nnothing"], "bad.off"));
          const options = {dataTransfer: given, bubbles: true, cancelable: true};
          document.body.dispatchEvent(new DragEvent("drop", options));
        }"""
    )
    page.wait_for_url("**/scan/*")
    page.get_by_text("failed in the stage read").wait_for()
    assert not page.get_by_role("heading", name="Nearest shapes").is_visible()


def test_lying_shapes_are_turned_by_a_click(
    browser: Browser, eggs: Path, tmp_path: Path
) -> None:
    lying = tmp_path / "lying.sqlite"
    shutil.copy(eggs, lying)
    with running(lying) as server, opened(browser, server.address) as page:
        seen = {
            "If-None-Match": server.ask("/shapes/Egg20/thumbnail.png").headers["etag"]
        }
        assert server.ask("/shapes/Egg20/thumbnail.png", headers=seen).status == 304
        page.get_by_text("Turn upright").click()
        page.get_by_role("button", name="-x").click()
        page.get_by_text("The axis -x is up").wait_for()
        assert server.ask("/shapes/Egg20/thumbnail.png", headers=seen).status == 200


def test_a_line_round_shapes_of_the_map_chooses_them(page: Page, server: Server) -> None:
    assert wait_for(lambda: b'id="waiting"' not in server.ask("/map").body)
    page.get_by_role("link", name="Map").click()
    page.locator(".map image[href]").nth(11).wait_for()
    box: dict[str, float] = dict(page.locator(".map > svg").bounding_box() or {})  # type: ignore[arg-type]
    x, y, width, height = (box[name] for name in ("x", "y", "width", "height"))
    page.mouse.move(x + 1, y + 1)
    page.mouse.down()
    for across, down in ((width - 1, 1), (width - 1, height - 1), (1, height - 1)):
        page.mouse.move(x + across, y + down, steps=5)
    page.mouse.up()
    page.get_by_text("12 shapes are chosen.").wait_for()
    page.get_by_role("button", name="Nearer").click()
    page.get_by_role("button", name="<kind 1> 4").click()
    assert page.locator(".chosen a").all_inner_texts() == [
        "Egg10",
        "Egg11",
        "Egg12",
        "Egg13",
    ]
    page.locator(".chosen a").first.click()
    page.get_by_role("heading", name="Egg10").wait_for()


def test_keys_suffice(page: Page) -> None:
    # From the beginning, because the browser is told without an answer that its dialogs are to be caught.
    choosers: list[FileChooser] = []
    page.on("filechooser", lambda chooser: choosers.append(chooser))
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.innerText") == "Skip to the shapes"
    page.keyboard.press("Enter")
    reached(page, "input[type=file]")
    page.keyboard.press("Space")
    for _ in range(600):
        if not choosers:
            page.wait_for_timeout(50)  # in which events arrive, unlike in time.sleep
    assert choosers[0].element.get_attribute("name") == "scan"
    reached(page, "input[type=search]")
    page.keyboard.type("egg2")
    page.get_by_text("3 shapes").wait_for()
    reached(page, "#results .shapes a")
    page.keyboard.press("Enter")
    page.get_by_role("heading", name="Nearest shapes").wait_for()


def reached(page: Page, selector: str) -> None:
    """Press Tab until an element has the focus, and see that the focus is drawn."""
    for _ in range(40):
        page.keyboard.press("Tab")
        # At once, because a list that has just been searched is replaced, and its focus is lost.
        style = page.evaluate(
            "selector => document.activeElement.matches(selector) "
            "&& getComputedStyle(document.activeElement).outlineStyle",
            selector,
        )
        if style:
            assert style != "none", f"{selector} does not show that it has the focus"
            return
    raise AssertionError(f"{selector} is not reached by the key Tab")


def test_what_is_pressed_is_as_large_as_a_finger(
    browser: Browser, server: Server, tmp_path: Path
) -> None:
    """On each page of the server; and nothing moves for those who ask for that."""
    job, found = server.outcome("egg.off", egg(tmp_path))["job"], set[str]()
    assert wait_for(lambda: b'id="waiting"' not in server.ask("/map").body)
    with opened(browser, server.address, (390, 844)) as page:
        for address in (*PAGES, f"/scan/{job}"):
            page.goto(f"{origin(server.address)}{address}")
            found |= {f"{address}: {each}" for each in too_small(page)}
            assert overflow(page) <= 0, address
            assert jump(page) < STILL, address
        assert not found, "\n".join(found)
        page.goto(origin(server.address))
        moving = """() => [...document.querySelectorAll("*")].map(it => getComputedStyle(it))
          .filter(it => it.animationName !== "none" || it.transitionDuration !== "0s").length"""
        assert page.evaluate(moving) > 0
        page.emulate_media(reduced_motion="reduce")
        assert page.evaluate(moving) == 0


def test_a_shape_of_many_classes_lights_up_its_class(
    browser: Browser, tmp_path: Path
) -> None:
    many = tmp_path / "many.sqlite"
    with Catalogue(write_many(many)) as store:
        assert len(set(store.labels().values())) > 12
    with running(many, "--read-only") as server:
        assert wait_for(lambda: b'id="waiting"' not in server.ask("/map").body)
        with opened(browser, server.address) as page:
            assert page.get_by_role("heading", name="many").is_visible()
            page.get_by_text("14 classes").click()
            page.get_by_label("Search classes").fill("13")
            assert page.locator(".classes li:visible").all_inner_texts() == ["kind 13\n2"]
            page.get_by_role("link", name="Map").click()
            page.locator(".map svg a").first.wait_for()
            assert page.locator(".key").count() == 0
            page.get_by_label("Find a class or a shape").fill("kind 7")
            lit = page.locator(".map a.lit").evaluate_all(
                "all => all.map(it => it.dataset.id)"
            )
            assert sorted(lit) == ["Egg7-0", "Egg7-1"]


def test_pages_are_accessible_and_fit(
    browser: Browser, server: Server, tmp_path: Path
) -> None:
    job, found = server.outcome("egg.off", egg(tmp_path))["job"], set[str]()
    assert wait_for(lambda: b'id="waiting"' not in server.ask("/map").body)
    for size, dark in product((DESKTOP, PHONE), (False, True)):
        with opened(browser, server.address, size, dark=dark) as page:
            for address in (*PAGES, f"/scan/{job}", f"/scan/{job}/inspection"):
                page.goto(f"{origin(server.address)}{address}")
                found |= {f"{address}: {violation}" for violation in violations(page)}
                found |= {
                    f"{address} is {wide} pixels too wide"
                    for wide in [overflow(page)]
                    if wide > 0
                }
            # Of the inspection:
            assert page.locator("canvas").is_visible(), "the viewer runs"
            fills = page.locator(".key rect").evaluate_all(
                "all => all.map(it => getComputedStyle(it).fill)"
            )
            assert fills and "rgb(0, 0, 0)" not in fills
    assert not found, "\n".join(found)
