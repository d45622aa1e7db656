"""The report of a catalogue: queries, classes and settings in words, and how it behaves in a browser."""

from __future__ import annotations

import re
from collections.abc import Iterator
from html import unescape
from pathlib import Path
from typing import TYPE_CHECKING

import browsers
import pytest
import shapes
from click.testing import CliRunner

from pcretrieve import Catalogue, PipelineOptions, report
from pcretrieve.cli.main import cli
from pcretrieve.errors import InputError
from pcretrieve.evaluation import query_scores, rank_catalogue
from pcretrieve.formats import write_mesh
from pcretrieve.ingestion.run import ingest_files

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

OPTIONS = PipelineOptions().changed(
    signature={"method": "r-bihdm", "n_values": 10},
    spectral={"n_pairs": 61},
    retrieval={"whitening": "none"},
)

# Heights of eggs by kind. Kinds 0 to 2 are apart; "mixed" has an egg among those of kind 0, "lone" is alone.
HEIGHTS = {
    "kind0": (1.20, 1.21, 1.22),
    "kind1": (1.8, 1.82),
    "kind2": (2.7, 2.72, 2.74),
}
MIXED = {"mixed": (1.215, 2.2), "lone": (3.6,)}


def filled(folder: Path, kinds: dict[str, tuple[float, ...]], *, fails: bool = False) -> Path:
    folder.mkdir(exist_ok=True)
    labels = {}
    for kind, heights in kinds.items():
        for number, height in enumerate(heights):
            name = f"{kind}-{number}.off"
            write_mesh(shapes.ellipsoid((1.05, 1.0, height), subdivisions=3), folder / name)
            labels[name] = kind
    if fails:
        (folder / "broken.off").write_bytes(b"OFF\n1 1")
    with Catalogue(folder / "eggs.sqlite", OPTIONS, create=True) as store:
        ingest_files(sorted(folder.glob("*.off")), store, labels=labels)
    return folder / "eggs.sqlite"


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return filled(tmp_path_factory.mktemp("eggs"), HEIGHTS | MIXED, fails=True)


@pytest.fixture(scope="module")
def written(catalogue: Path) -> Path:
    return report(catalogue, catalogue.parent / "eggs.html", k=4)


def words_of(page: Path) -> str:
    """What the page says, without tags and with single spaces."""
    text = re.sub(r"<(style|script)>.*?</\1>", "", page.read_text("utf-8"), flags=re.DOTALL)
    return " ".join(unescape(re.sub(r"<[^>]*>", " ", text)).split())


def queries_of(page: Path) -> list[str]:
    return re.findall(r'<article [^>]*data-name="([^"]*)"', page.read_text("utf-8"))


def test_a_perfect_answer_looks_perfect_although_more_is_shown(tmp_path: Path) -> None:
    page = report(filled(tmp_path / "eggs", HEIGHTS), tmp_path / "eggs.html", k=5)
    text = page.read_text("utf-8")
    assert text.count('class="wrong"><i') == 0
    # Each of 3, 2 and 3 eggs finds 2, 1 and 2; the other results have no mark.
    assert text.count('<li class="right">') == 3 * 2 + 2 * 1 + 3 * 2
    assert text.count("<li><i") == 8 * 5 - 14
    assert "1 of 1 right" in words_of(page)


def test_every_query_is_there_and_the_worst_is_the_first(catalogue: Path, written: Path) -> None:
    with Catalogue(catalogue) as store:
        scores = query_scores(rank_catalogue(store).rankings)
        ids = [record.id for record in store.records(status="done")]
    precision = dict(zip(scores.ids, scores.ap, strict=True))
    queries = queries_of(written)
    assert sorted(queries) == sorted(ids)
    assert queries == sorted(ids, key=lambda shape_id: precision.get(shape_id, 2))
    assert queries[0].startswith("mixed")
    assert queries[-1] == "lone-0"
    few = report(catalogue, written.parent / "few.html", n_queries=2)
    assert queries_of(few) == queries[:2]
    assert "the 2 with the lowest average precision of 11" in words_of(few)


def test_wrong_results_are_those_within_the_size_of_the_class(written: Path) -> None:
    article = written.read_text("utf-8").split('data-name="mixed-0"')[1].split("</article>")[0]
    results = re.findall(r"<li( class=\"(?:right|wrong)\")?>", article)
    assert results == [' class="wrong"', "", "", ""]


def test_settings_classes_intervals_and_failures_are_in_words(written: Path) -> None:
    words = words_of(written)
    for said in (
        "signature r-bihdm, 10 values, of the form alone",
        "distance log, the Euclidean distance of the logarithms of the values",
        "whitening none",
        "re-ranking none",
        "shapes 11 classes 5",
        "In brackets are 95 % confidence intervals",
        "4 classes, the worst first Class Queries mAP NN Nearest shapes of other classes mixed 2",
        "mixed: the nearest shape of 1 of 2 is kind0",
        "1 shape failed Shape Stage What went wrong broken read",
        "1 shape is alone in its class and not asked for",
        "Map Shapes with similar signatures",
    ):
        assert said in words
    assert "ScanReadError" in words
    assert "Compared with" not in words


def test_two_settings_are_compared(catalogue: Path, tmp_path: Path) -> None:
    run = CliRunner().invoke
    arguments = ["--catalogue", str(catalogue)]
    made = run(cli, ["evaluate", *arguments, "--distance", "d2", "--csv", str(tmp_path / "d2")])
    assert made.exit_code == 0, made.output
    other = tmp_path / "d2" / "queries.csv"
    page = tmp_path / "compared.html"
    made = run(cli, ["report", *arguments, "--versus", str(other), "-o", str(page)])
    assert made.exit_code == 0, made.output
    words = words_of(page)
    assert f"Compared with {other}" in words
    assert "Measure The other This Difference Interval This is NN" in words
    assert "+0.000 to +0.000 no difference shown" in words
    same = report(catalogue, tmp_path / "same.html", versus=catalogue)
    assert "The average precision of no query changed." in words_of(same)


def test_without_classes_there_is_nothing_to_compare(catalogue: Path, tmp_path: Path) -> None:
    lonely = filled(tmp_path / "lone", {"a": (1.2,), "b": (1.9,)})
    page = report(lonely, tmp_path / "lone.html")
    assert queries_of(page) == ["a-0", "b-0"]
    assert "confidence" not in words_of(page)
    with pytest.raises(InputError, match=r"no class in .* has two shapes: there are no measures to compare"):
        report(lonely, tmp_path / "lone.html", versus=catalogue)


# --- in a browser -------------------------------------------------------------------------------------


@pytest.fixture
def page(browser: Browser, written: Path) -> Iterator[Page]:
    with browsers.opened(browser, written.as_uri()) as page:
        yield page


def shown(page: Page) -> list[str]:
    names: list[str] = page.locator("article:visible h3").all_text_contents()
    return names


def test_queries_are_searched_and_sorted_without_a_server(page: Page, written: Path) -> None:
    everything = queries_of(written)
    assert shown(page) == everything
    page.get_by_label("Sort by").select_option("name")
    assert shown(page) == sorted(everything)
    page.get_by_label("Search").fill("KIND2 eggs")
    assert shown(page) == ["kind2-0", "kind2-1", "kind2-2"]
    assert page.locator("#count").inner_text() == "3 of 11"
    page.get_by_label("Search").fill("")
    page.get_by_label("with a wrong result").check()
    wrong = shown(page)
    assert "mixed-0" in wrong
    assert "kind2-0" not in wrong
    page.get_by_label("with a wrong result").uncheck()
    page.get_by_label("Sort by").select_option("best first")
    assert shown(page)[-2:] == [everything[0], "lone-0"]  # the worst, and the one without a score


def test_a_result_and_a_shape_of_the_map_lead_to_their_own_results(page: Page) -> None:
    page.get_by_label("Search").fill("mixed-0")
    page.locator("article:visible li a").first.click()
    # Not the inner text, which an article has only once it was scrolled into view and drawn.
    assert (page.locator("article:target h3").text_content() or "").startswith("kind0")
    assert page.locator("article:target").is_visible()
    assert page.get_by_label("Search").input_value() == ""
    page.locator('.map a:has([data-id="kind2-1"])').click()
    assert page.locator("article:target h3").text_content() == "kind2-1"


def test_classes_are_sorted_by_any_column(page: Page) -> None:
    table = page.locator("table.sortable").first
    rows = table.locator("tbody th")
    assert rows.first.inner_text() == "mixed"
    table.get_by_role("button", name="Class", exact=True).click()
    assert rows.all_inner_texts() == ["kind0", "kind1", "kind2", "mixed"]
    table.get_by_role("button", name="Class", exact=True).click()
    assert rows.all_inner_texts() == ["mixed", "kind2", "kind1", "kind0"]
    assert table.locator("th[aria-sort]").get_attribute("aria-sort") == "descending"


def test_it_is_accessible_and_fits_a_phone(browser: Browser, written: Path) -> None:
    for size, dark in ((browsers.DESKTOP, False), (browsers.PHONE, True)):
        with browsers.opened(browser, written.as_uri(), size, dark=dark) as page:
            assert browsers.overflow(page) <= 0
            assert browsers.violations(page) == []
