"""The page of a search: what was found for each query, what was not, and why, in one file."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from html import unescape
from pathlib import Path

import browsers
import numpy as np
import pytest
import shapes
from click.testing import CliRunner

from pcretrieve import Catalogue, DistanceMatrix, PipelineOptions, query_page, search_many
from pcretrieve.cli.main import cli
from pcretrieve.errors import InputError
from pcretrieve.formats import write_mesh
from pcretrieve.ingestion.run import ingest_files
from pcretrieve.pages.query_page import write_query_page
from pcretrieve.query import Answer

OPTIONS = PipelineOptions().changed(signature={"method": "r-bihdm", "n_values": 10}, spectral={"n_pairs": 61})


def egg(width: float, height: float, path: Path) -> Path:
    write_mesh(shapes.ellipsoid((width, 1.0, height), subdivisions=3), path)
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four kinds of three eggs, a new egg of the second kind, and scans that fail."""
    place = tmp_path_factory.mktemp("query")
    for kind, height in enumerate((1.2, 1.5, 2.0, 2.7)):
        for number in range(3):
            egg(1 + 0.02 * number, height, place / f"{kind}{number}.off")
    egg(1.03, 1.5, place / "new.off")
    (place / "bad").mkdir()
    (place / "bad" / "garbage.ply").write_bytes(b"\x00\xff" * 500)
    (place / "bad" / "<b>&.ply").write_bytes(b"ply\n")
    return place


@pytest.fixture(scope="module")
def catalogue(folder: Path) -> Iterator[Catalogue]:
    labels = {f"{kind}{number}.off": f"kind{kind}" for kind in range(4) for number in range(3)}
    with Catalogue(folder / "eggs.sqlite", OPTIONS, create=True) as store:
        ingest_files(sorted(folder.glob("[0-9]*.off")), store, labels=labels)
        yield store


def words_of(page: Path) -> str:
    """What the page says, without tags and with single spaces."""
    text = re.sub(r"<style>.*?</style>", "", page.read_text("utf-8"), flags=re.DOTALL)
    return " ".join(unescape(re.sub(r"<[^>]*>", " ", text)).split())


def answer_of(catalogue: Catalogue, query: Path, k: int) -> Answer:
    ((_, answer),) = search_many(catalogue, [query], k=k)
    assert isinstance(answer, Answer)
    return answer


def test_the_page_of_one_scan_says_what_the_search_found(catalogue: Catalogue, folder: Path) -> None:
    page = query_page(catalogue, folder / "new.off", folder / "one.html", k=5)
    answer, words = answer_of(catalogue, folder / "new.off", 5), words_of(page)
    assert answer.vote is not None and answer.vote.label == "kind1"
    assert f"kind1 , by {100 * answer.vote.share:.0f} % of the votes of 5 results" in words
    assert "The signature is sound , ± 0" in words
    shown = re.findall(r'<b class="name">(.*?)</b>', page.read_text("utf-8"))
    assert shown == list(answer.neighbors.ids)
    scores = answer.neighbors.scores
    assert scores is not None
    for gap, score in zip(answer.neighbors.distances, scores, strict=True):
        assert f"distance {f'{gap:#.3g}'.rstrip('.')} score {score:.2f}" in words
    assert "10 values, of the form alone" in words
    assert "12 shapes" in words
    assert catalogue.whitening(OPTIONS).reason in words
    assert "Overview" not in words and "failed" not in words


def test_the_page_has_its_pictures_in_it_and_needs_nothing_else(catalogue: Catalogue, folder: Path) -> None:
    page = query_page(catalogue, [folder / "new.off", "00"], folder / "pictures.html", k=3)
    text = page.read_text("utf-8")
    assert text.count("data:image/png;base64,") == 8, "two queries and three results of each"
    assert "default-src 'none'" in text and "<script" not in text
    assert not re.findall(r"""(?:src|href)=["'](?!data:|#)|https?:|url\(""", text)
    assert page.stat().st_size < 200_000


def test_several_queries_are_on_one_page_and_failures_have_reasons(
    catalogue: Catalogue, folder: Path
) -> None:
    queries: list[str | Path] = ["21", folder / "bad", folder / "new.off"]
    page = query_page(catalogue, queries, folder / "many.html", k=2, exclude_self=True)
    words, text = words_of(page), page.read_text("utf-8")
    assert words.startswith("4 queries")
    assert "2 scans failed" in words and "not a complete PLY file" in words
    assert "In the catalogue as 21, class kind2" in words
    assert re.findall(r'<a href="#([\w-]+)">', text) == ["query-1", "query-2", "failed", "failed"]
    assert "<b>&.ply" not in text and "&lt;b&gt;&amp;.ply" in text
    assert words.count("Failed in the stage read") == 2


def test_no_match_is_said_as_such(catalogue: Catalogue, folder: Path) -> None:
    egg(3.0, 0.4, folder / "flat.off")
    page = query_page(catalogue, folder / "flat.off", folder / "none.html", min_score=0.99)
    words = words_of(page)
    assert "No match : no shape has a score of 0.99 or more" in words
    assert "least score 0.99" in words
    assert '<ol class="results">' not in page.read_text("utf-8")


def test_an_improbable_match_is_said_as_such(catalogue: Catalogue, folder: Path) -> None:
    answer = answer_of(catalogue, folder / "new.off", 3)
    far = replace(answer, neighbors=replace(answer.neighbors, scores=np.full(3, 0.25)))
    page = write_query_page(folder / "far.html", catalogue, [("new.off", far)])
    assert "Probably no match : the best score is 0.25. Nearest is kind1 , by " in words_of(page)


def test_ranges_of_ranks_are_shown_where_ranks_could_swap(catalogue: Catalogue, folder: Path) -> None:
    answer = answer_of(catalogue, folder / "new.off", 4)
    assert answer.rank_ranges is not None and (answer.rank_ranges[:, 0] == answer.rank_ranges[:, 1]).all()
    swapped = replace(answer, rank_ranges=np.array([[1, 1], [2, 3], [2, 4], [3, 4]]))
    for given, words in (
        (answer, "No ranks could swap within the error bar of the query."),
        (swapped, "Within the error bar of the query, these ranks could swap: 2 to 4."),
    ):
        page = write_query_page(folder / "ranges.html", catalogue, [("new.off", given)])
        assert words in words_of(page)
    assert re.findall(r" rank (\d+) to (\d+)", words_of(page)) == [("2", "3"), ("2", "4"), ("3", "4")]


def test_other_classes_and_a_matrix_are_in_the_settings(catalogue: Catalogue, folder: Path) -> None:
    page = query_page(catalogue, "00", folder / "filtered.html", labels=["kind2", "kind0"])
    assert "searched the class kind0 or kind2 of 12 shapes" in words_of(page)
    ids = catalogue.signatures().ids
    away = np.abs(np.subtract.outer(np.arange(12.0), np.arange(12.0)))
    matrix = DistanceMatrix(ids, away)
    words = words_of(query_page(catalogue, "00", folder / "matrix.html", matrix=matrix, k=3))
    assert "distance that of a matrix" in words and "whitening" not in words
    assert "score –" in words


def test_a_page_that_cannot_be_written(catalogue: Catalogue, folder: Path) -> None:
    with pytest.raises(InputError, match="a folder that exists"):
        query_page(catalogue, "00", folder / "nowhere" / "page.html")


# --- the command line ---------------------------------------------------------------------------------


def test_the_command_prints_what_it_prints_and_writes_the_page(catalogue: Catalogue, folder: Path) -> None:
    del catalogue
    asked = ["query", "-c", str(folder / "eggs.sqlite"), str(folder / "new.off"), "-k", "2"]
    plain = CliRunner().invoke(cli, asked)
    page = folder / "command.html"
    both = CliRunner().invoke(cli, [*asked, "--html", str(page)])
    assert both.exit_code == plain.exit_code == 0
    assert both.stdout == plain.stdout
    assert f"page: {page}" in both.stderr
    assert words_of(page) == words_of(query_page(folder / "eggs.sqlite", folder / "new.off", page, k=2))


def test_a_scan_that_fails_has_its_page_too(catalogue: Catalogue, folder: Path) -> None:
    del catalogue
    page, scan = folder / "failed.html", folder / "bad" / "garbage.ply"
    done = CliRunner().invoke(
        cli, ["query", "-c", str(folder / "eggs.sqlite"), str(scan), "--html", str(page)]
    )
    assert done.exit_code != 0
    assert "1 scan failed" in words_of(page) and "not a complete PLY file" in words_of(page)


def test_a_page_replaces_no_scan_and_no_catalogue(catalogue: Catalogue, folder: Path) -> None:
    del catalogue
    store, scan = folder / "eggs.sqlite", folder / "new.off"
    for target in (store, scan):
        before = target.read_bytes()
        done = CliRunner().invoke(cli, ["query", "-c", str(store), str(scan), "--html", str(target)])
        assert done.exit_code != 0
        assert target.read_bytes() == before


# --- in a browser -------------------------------------------------------------------------------------


def test_in_a_browser_it_is_accessible_and_fits_a_phone(catalogue: Catalogue, folder: Path) -> None:
    queries: list[str | Path] = ["21", folder / "bad", folder / "new.off"]
    page = query_page(catalogue, queries, folder / "browser.html", k=4)
    with browsers.chromium() as browser:
        for size, dark in ((browsers.DESKTOP, False), (browsers.PHONE, True)):
            with browsers.opened(browser, page.as_uri(), size, dark=dark) as shown:
                assert browsers.overflow(shown) <= 0
                assert browsers.violations(shown) == []
                shown.get_by_role("link", name="new.off").click()
                assert shown.url.endswith("#query-2")
                drawn = "[...document.images].every(image => image.complete && image.naturalWidth > 100)"
                assert shown.evaluate(drawn)
