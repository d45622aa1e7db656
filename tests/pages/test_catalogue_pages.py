"""Pages of a catalogue: they say what was computed, need no other file, and no name can break them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from html import unescape
from pathlib import Path
from typing import TYPE_CHECKING

import browsers
import numpy as np
import pytest
import shapes
from commands import refusal, run
from search_server import NASTY, write_many

from pcretrieve import (
    Answer,
    PipelineOptions,
    Record,
    draw_map,
    duplicates_page,
    ingest,
    matrix,
    query_page,
    report,
    search_many,
    write_mesh,
)
from pcretrieve.errors import InputError
from pcretrieve.evaluation import evaluate
from pcretrieve.pages.retrieval_page import _Card, _judged

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

OPTIONS = PipelineOptions().changed(
    signature={"method": "r-bihdm", "n_values": 10},
    spectral={"n_pairs": 61},
    retrieval={"whitening": "none"},
)

# Heights of eggs by kind. Kinds 0 to 2 are apart; "mixed" has an egg among those of kind 0, "lone" is alone.
HEIGHTS = {"kind0": (1.20, 1.21, 1.22), "kind1": (1.8, 1.82), "kind2": (2.7, 2.72, 2.74)}
MIXED = {"mixed": (1.215, 2.2), "lone": (3.6,)}


def egg(height: float, path: Path, width: float = 1.05) -> Path:
    write_mesh(shapes.ellipsoid((width, 1.0, height), subdivisions=3), path)
    return path


def filled(
    folder: Path, kinds: Mapping[str, tuple[float, ...]], *, fails: bool = False
) -> Path:
    folder.mkdir(exist_ok=True)
    scans = [
        egg(height, folder / f"{kind}-{number}.off")
        for kind, heights in kinds.items()
        for number, height in enumerate(heights)
    ]
    labels = {scan.name: scan.name.partition("-")[0] for scan in scans}
    if fails:
        (folder / "broken.off").write_bytes(b"OFF\n1 1")
        scans.append(folder / "broken.off")
    ingest(scans, folder / "eggs.sqlite", labels=labels, options=OPTIONS, workers=1)
    return folder / "eggs.sqlite"


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return filled(tmp_path_factory.mktemp("eggs"), HEIGHTS | MIXED, fails=True)


@pytest.fixture(scope="module")
def written(catalogue: Path) -> Path:
    return report(catalogue, catalogue.parent / "eggs.html", k=4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A new egg of kind 1, and scans that fail."""
    place = tmp_path_factory.mktemp("scans")
    (place / "bad").mkdir()
    (place / "bad" / "garbage.ply").write_bytes(b"\x00\xff" * 500)
    (place / "bad" / "<b>&.ply").write_bytes(b"ply\n")
    egg(1.8, place / "new.off", width=1.06)
    return place


def words_of(page: Path) -> str:
    """What the page says, without tags and with single spaces."""
    text = re.sub(
        r"<(style|script)>.*?</\1>", "", page.read_text("utf-8"), flags=re.DOTALL
    )
    words = unescape(re.sub(r"<[^>]*>", " ", text)).split()
    assert "None" not in words
    return " ".join(words)


def queries_of(page: Path) -> list[str]:
    return re.findall(r'<article [^>]*data-name="([^"]*)"', page.read_text("utf-8"))


def answer_of(catalogue: Path, query: Path, k: int) -> Answer:
    ((_, answer),) = search_many(catalogue, [query], k=k)
    assert isinstance(answer, Answer)
    return answer


def test_no_page_needs_another_file_or_runs_what_a_name_says(
    eggs: Path, tmp_path: Path
) -> None:
    """Names and classes of the eggs of the server are markup."""
    pages = [
        report(eggs, tmp_path / "report.html"),
        query_page(eggs, [NASTY, "Egg00"], tmp_path / "query.html"),
        draw_map(eggs, tmp_path / "map.html"),
    ]
    for page in pages:
        text = page.read_text("utf-8")
        assert "default-src 'none'; img-src data:; font-src data:" in text
        assert not re.findall(
            r"""(?:src|href)=["'](?!data:|#)|https?:|@import|url\((?!data:)""", text
        )
        assert "<b> %2F" not in text and "&lt;b&gt; %2F" in text
        assert "<kind 2>" not in text and "'\".." not in text and NASTY in words_of(page)
        ids = re.findall(r'\bid="([^"]*)"', text)
        assert len(set(ids)) == len(ids)
        assert set(re.findall(r'(?:href="#|labelledby=")([^"]+)"', text)) <= set(ids)
    inlined = re.findall(
        r"\.(p\d+)\{background-image:url\(data:image/png;base64,", pages[0].read_text()
    )
    assert len(set(inlined)) == len(inlined) <= 12, "each picture is inlined once"


def test_a_report_is_the_same_again_and_has_its_folder(
    catalogue: Path, written: Path
) -> None:
    first = written.read_bytes()
    assert report(catalogue, written, k=4) == written
    assert first == written.read_bytes()
    for place in ("missing/report.html", "eggs.sqlite/report.html"):
        with pytest.raises(InputError, match=r"cannot write .*; name a file in a folder"):
            report(catalogue, catalogue.parent / place)
        with pytest.raises(InputError, match=r"there is no folder .*: make it first"):
            query_page(catalogue, "kind0-0", catalogue.parent / place)


# --- the report ---------------------------------------------------------------------------------------


def test_measures_and_curve_are_those_of_the_evaluation(
    catalogue: Path, written: Path
) -> None:
    found, text = evaluate(catalogue), written.read_text("utf-8")
    shown = re.findall(r'<td class="value">([\d.]+) <small>\[', text)
    means = (found.nn, found.ft, found.st, found.e, found.dcg, found.map)
    assert [float(value) for value in shown] == pytest.approx(means, rel=0.005)
    (drawn,) = re.findall(r'<polyline class="curve" points="([^"]*)"', text)
    recall, down = np.array([point.split(",") for point in drawn.split()], dtype=float).T
    np.testing.assert_allclose(recall, np.linspace(0, 1, len(recall)), atol=1e-4)
    assert (np.diff(1 - down) <= 0).all()


def test_two_results_are_compared(catalogue: Path, tmp_path: Path) -> None:
    run("evaluate", "-c", catalogue, "--distance", "d2", "--csv", tmp_path / "d2")
    other, page = tmp_path / "d2" / "queries.csv", tmp_path / "compared.html"
    run("report", "-c", catalogue, "--versus", other, "-o", page)
    words = words_of(page)
    assert "Compared with queries.csv" in words and str(tmp_path) not in words
    assert "Measure The other This Difference Interval This is NN" in words
    assert "+0.000 to +0.000 no difference shown" in words
    same = words_of(report(catalogue, tmp_path / "same.html", versus=catalogue))
    assert "The average precision of no query changed." in same
    by_matrix = words_of(
        report(catalogue, tmp_path / "matrix.html", matrix=matrix(catalogue))
    )
    assert (
        "searched 11 shapes distance that of a matrix" in by_matrix
        and "t-SNE" not in by_matrix
    )


def test_without_classes_there_is_nothing_to_compare(
    catalogue: Path, tmp_path: Path
) -> None:
    lonely = filled(tmp_path / "lone", {"a": (1.2,), "b": (1.9,)})
    page = report(lonely, tmp_path / "lone.html")
    assert queries_of(page) == ["a-0", "b-0"]
    assert "confidence" not in words_of(page)
    with pytest.raises(
        InputError,
        match=r"no class in .* has two shapes: there are no measures to compare",
    ):
        report(lonely, tmp_path / "lone.html", versus=catalogue)


# --- a search -----------------------------------------------------------------------------------------


def test_the_page_of_one_scan_says_what_the_search_found(
    eggs: Path, folder: Path
) -> None:
    page = query_page(eggs, folder / "new.off", folder / "one.html", k=4)
    answer, words = answer_of(eggs, folder / "new.off", 4), words_of(page)
    assert answer.label == "<kind 1>"
    assert f"{answer}" in words
    assert f"This is {answer.label}, sure" in words
    assert "The scan is" not in words, "a grade is said where it is not good"
    assert re.findall(r'<b class="name">(.*?)</b>', page.read_text("utf-8")) == list(
        answer.neighbors.ids
    )
    assert answer.neighbors.scores is not None
    for gap, score in zip(
        answer.neighbors.distances, answer.neighbors.scores, strict=True
    ):
        assert f"distance {f'{gap:#.3g}'.rstrip('.')}, score {score:.2f}" in words
    assert "12 shapes" in words and "20 values, of the form alone" in words
    assert "Overview" not in words and "failed" not in words


def test_doubt_about_an_answer_is_said(eggs: Path, folder: Path) -> None:
    egg(0.4, folder / "flat.off", width=3.0)
    page = query_page(eggs, folder / "flat.off", folder / "none.html", min_score=0.99)
    assert "Because no shape has a score of 0.99 or more" in words_of(page)
    assert "least score 0.99" in words_of(
        page
    ) and '<ol class="results">' not in page.read_text("utf-8")
    page = query_page(
        eggs, folder / "flat.off", folder / "doubt.html", false_match_rate=1e-4
    )
    assert "stranger Because the nearest class is " in words_of(page)
    assert 'class="stranger"' in page.read_text("utf-8")


def test_the_command_prints_what_it_prints_and_writes_the_page(
    eggs: Path, folder: Path
) -> None:
    asked = ("query", "-c", eggs, folder / "new.off", "-k", 2)
    page = folder / "command.html"
    both = run(*asked, "--html", page)
    assert both.stdout == run(*asked).stdout
    assert f"page: {page}" in both.stderr
    refusal("query", "-c", eggs, folder / "bad" / "garbage.ply", "--html", page)
    assert "1 scan failed" in words_of(page)
    for target in (eggs, folder / "new.off"):  # a page replaces no scan and no catalogue
        before = target.read_bytes()
        refusal(*asked, "--html", target)
        assert target.read_bytes() == before


def test_several_scans_are_counted_by_what_was_found(eggs: Path, folder: Path) -> None:
    egg(0.4, folder / "flat.off", width=3.0)
    scans = [folder / name for name in ("new.off", "flat.off", "bad/garbage.ply")]
    page = query_page(eggs, scans, folder / "three.html", false_match_rate=1e-4)
    assert "3 scans: 1 recognised, 1 stranger, 1 failed" in words_of(page)
    assert "None" not in words_of(page).split()


def test_that_there_are_no_duplicates_is_shown_by_the_nearest_pairs(
    eggs: Path, tmp_path: Path
) -> None:
    page = duplicates_page(eggs, [], tmp_path / "none.html")
    words = words_of(page)
    assert "No duplicates among 12 shapes The nearest pairs" in words
    shown = re.findall(r"distance ([\d.]+)", words)
    gaps = np.sort(matrix(eggs).values[np.triu_indices(12, 1)])[:3]
    assert [float(gap) for gap in shown] == pytest.approx(gaps.tolist(), rel=0.005)


def test_duplicates_are_side_by_side(eggs: Path, tmp_path: Path) -> None:
    run("duplicates", "-c", eggs, "--threshold", 1e9, "--html", tmp_path / "all.html")
    words = words_of(tmp_path / "all.html")
    assert "66 pairs of duplicates among 12 shapes" in words and NASTY in words
    assert str(tmp_path) not in words and "/secret" not in words


# --- in a browser -------------------------------------------------------------------------------------


@pytest.fixture
def page(browser: Browser, written: Path) -> Iterator[Page]:
    with browsers.opened(browser, written.as_uri()) as page:
        yield page


def shown(page: Page) -> list[str]:
    names: list[str] = page.locator("article:visible h3").all_text_contents()
    return names


@pytest.mark.slow
def test_queries_and_classes_are_searched_and_sorted_without_a_server(
    page: Page, written: Path
) -> None:
    everything = queries_of(written)
    assert shown(page) == everything
    page.get_by_label("Sort by").select_option("name")
    assert shown(page) == sorted(everything)
    page.get_by_label("Search").fill("KIND2 off")
    assert shown(page) == ["kind2-0", "kind2-1", "kind2-2"]
    assert page.locator("#count").inner_text() == "3 of 11"
    page.get_by_label("Search").fill("")
    page.get_by_label("with a wrong result").check()
    wrong = shown(page)
    assert "mixed-0" in wrong and "kind2-0" not in wrong
    page.get_by_label("with a wrong result").uncheck()
    page.get_by_label("Sort by").select_option("best first")
    assert shown(page)[-2:] == [
        everything[0],
        "lone-0",
    ]  # the worst, and the one without a score
    table = page.locator("table.sortable").first
    for expected in (
        ["kind0", "kind1", "kind2", "mixed"],
        ["mixed", "kind2", "kind1", "kind0"],
    ):
        table.get_by_role("button", name="Class", exact=True).click()
        assert table.locator("tbody th").all_inner_texts() == expected


@pytest.mark.slow
def test_a_report_is_folded_after_the_worst(browser: Browser, tmp_path: Path) -> None:
    written = report(write_many(tmp_path / "many.sqlite"), tmp_path / "many.html")
    with browsers.opened(browser, written.as_uri()) as page:
        assert shown(page) == queries_of(written)[:20]
        assert page.locator("#count").inner_text() == "28 of 28"
        page.get_by_label("Search", exact=True).fill("kind 13")
        assert len(shown(page)) == 2
        page.get_by_label("Search", exact=True).fill("")
        page.get_by_role("button", name="Show all 28").click()
        assert len(shown(page)) == 28


@pytest.mark.slow
def test_pages_are_accessible_and_fit_a_phone(
    browser: Browser, eggs: Path, folder: Path, written: Path
) -> None:
    queries: list[str | Path] = ["Egg21", folder / "bad", folder / "new.off"]
    search = query_page(eggs, queries, folder / "browser.html", k=4)
    one = query_page(eggs, folder / "new.off", folder / "single.html", k=4)
    doubles = duplicates_page(eggs, [], folder / "doubles.html")
    for file in (written, search, one, doubles, draw_map(eggs, folder / "map.html")):
        for size, dark in ((browsers.DESKTOP, False), (browsers.PHONE, True)):
            with browsers.opened(browser, file.as_uri(), size, dark=dark) as page:
                assert browsers.overflow(page) <= 0
                assert browsers.too_small(page) == []
                assert browsers.violations(page) == []


def test_results_after_as_many_as_the_class_has_are_not_wrong() -> None:
    def record(label: str | None) -> Record:
        return Record("a", "/a.off", "", label)

    labels = ("kind0", "kind1", "kind1", None, "kind0", "kind1")
    found = [_Card(record(label), None, 0.1) for label in labels]
    judged = _judged("kind0", found, {"kind0": 3, "kind1": 3})
    assert [card.relevant for card in judged] == [True, False, None, None, True, None]
    assert {card.relevant for card in _judged(None, found, {"kind0": 3})} == {None}
