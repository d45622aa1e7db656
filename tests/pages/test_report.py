"""The report: all that it should show is there, nothing else is, and nothing in it can break it."""

import re
from base64 import b64decode
from dataclasses import dataclass, field
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pcretrieve.errors import InputError
from pcretrieve.evaluation import PrecisionRecall, RetrievalMeasures
from pcretrieve.pages.cards import Card, Panel
from pcretrieve.pages.report import write_report
from pcretrieve.values import Failure

VOID = {"meta", "link", "img", "br", "input", "rect"}
MEASURES = RetrievalMeasures(
    nn=1.0, ft=0.98765, st=0.5, e=0.0625, dcg=0.1234, map=0.7777, n_queries=7, n_failed=2, n_single=1
)
CURVE = PrecisionRecall(np.array([0.0, 0.5, 1.0]), np.array([1.0, 0.75, 0.25]))
FAILURES = (
    Failure("scan-8", "remesh", "RemeshError", "no closed surface"),
    Failure("scan-9", "read", "ScanReadError", "not a complete PLY file"),
)
NASTY = "<script>alert(\"1\")</script> & ' onload='x"


@dataclass
class Element:
    tag: str
    attributes: dict[str, str | None]
    parent: "Element | None" = None
    children: list["Element"] = field(default_factory=list)
    own_text: list[str] = field(default_factory=list)

    @property
    def classes(self) -> list[str]:
        return (self.attributes.get("class") or "").split()

    @property
    def text(self) -> str:
        return " ".join([*self.own_text, *(child.text for child in self.children)]).strip()

    def all(self, tag: str, of_class: str | None = None) -> list["Element"]:
        found = [self] if self.tag == tag and (of_class is None or of_class in self.classes) else []
        return found + [element for child in self.children for element in child.all(tag, of_class)]


class Page(HTMLParser):
    """The tree of a page; every end tag must close the element that was opened last."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.root = self._open = Element("page", {})
        self.feed(path.read_text(encoding="utf-8"))
        self.close()
        assert self._open is self.root

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        element = Element(tag, dict(attrs), self._open)
        self._open.children.append(element)
        if tag not in VOID:
            self._open = element

    def handle_endtag(self, tag: str) -> None:
        assert tag == self._open.tag
        assert self._open.parent is not None
        self._open = self._open.parent

    def handle_data(self, data: str) -> None:
        if data.strip():
            self._open.own_text.append(" ".join(data.split()))


def png(shade: int) -> bytes:
    file = BytesIO()
    Image.new("L", (2, 2), shade).save(file, "PNG")
    return file.getvalue()


def result(number: int, label: str | None, relevant: bool | None) -> Card:
    return Card(f"scan-{number}", label, f"in/{number}.ply", number / 8, png(number), relevant)


PANELS = (
    Panel(
        Card("scan-0", "cat", "in/0.ply", None, png(0)),
        (result(1, "cat", True), result(2, "dog", False), result(3, "cat", True)),
    ),
    Panel(Card("scan-1", "cat", "in/1.ply", None, png(1)), (result(4, None, None), result(5, "dog", False))),
)


def full_page(folder: Path) -> Path:
    return write_report(
        folder / "report.html",
        title="Cats & dogs",
        panels=PANELS,
        measures=MEASURES,
        failures=FAILURES,
        facts={"Shapes": "6", "Distance": "log"},
        precision_recall=CURVE,
    )


def test_each_query_comes_with_its_results_in_order(tmp_path: Path) -> None:
    page = Page(full_page(tmp_path)).root
    articles = page.all("article")
    assert [article.all("h3")[0].text for article in articles] == [panel.query.id for panel in PANELS]
    for article, panel in zip(articles, PANELS, strict=True):
        items = article.all("ol")[0].all("li")
        for item, card in zip(items, panel.results, strict=True):
            assert card.id in item.text
            assert card.label is None or card.label in item.text


def test_right_and_wrong_differ_in_colour_sign_and_word(tmp_path: Path) -> None:
    page = Page(full_page(tmp_path)).root
    cards = [card for panel in PANELS for card in panel.results]
    for item, card in zip(page.all("li"), cards, strict=True):
        marks = [mark.text for mark in item.all("span", "mark")]
        assert marks == {True: ["right"], False: ["wrong"], None: []}[card.relevant]
        assert ("right" in item.classes) == (card.relevant is True)
        assert ("wrong" in item.classes) == (card.relevant is False)
    assert "2 of 3 right" in page.all("article")[0].text
    assert "0 of 1 right" in page.all("article")[1].text


def inlined(path: Path) -> dict[str, bytes]:
    """The picture of each class of elements that shows one."""
    rule = r"\.(p\d+)\{background-image:url\(data:image/png;base64,([^)]*)\)\}"
    rules = re.findall(rule, path.read_text("utf-8"))
    assert len(dict(rules)) == len(rules)
    return {name: b64decode(data, validate=True) for name, data in rules}


def test_each_picture_is_inlined_once(tmp_path: Path) -> None:
    path = full_page(tmp_path)
    cards = [card for panel in PANELS for card in (panel.query, *panel.results)]
    pictures = inlined(path)
    assert sorted(pictures.values()) == sorted({card.picture for card in cards if card.picture})
    assert len(pictures) < len(cards)
    for shown, card in zip(Page(path).root.all("i", "picture"), cards, strict=True):
        assert pictures[shown.classes[1]] == card.picture


def test_nothing_is_fetched(tmp_path: Path) -> None:
    path = full_page(tmp_path)
    text = path.read_text(encoding="utf-8")
    for outside in ("http:", "https:", "//cdn", "@import"):
        assert outside not in text
    assert text.count("url(") == text.count("url(data:image/png;base64,") == len(inlined(path))
    page = Page(path).root
    assert all(not script.attributes for script in page.all("script"))
    loaded = [element.attributes for tag in ("img", "link", "iframe", "object") for element in page.all(tag)]
    assert all((a.get("src") or a.get("href") or "").startswith("data:") for a in loaded)
    policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
    assert policy in [meta.attributes["content"] for meta in page.all("meta") if "content" in meta.attributes]


def test_measures_stand_in_the_usual_order_with_three_digits(tmp_path: Path) -> None:
    page = Page(full_page(tmp_path)).root
    table = page.all("table")[0]
    rows = table.all("tr")[1:]
    assert [row.all("th")[0].own_text[0] for row in rows] == ["NN", "FT", "ST", "E", "DCG", "mAP"]
    values = [row.all("td", "value")[0].text for row in rows]
    assert values == ["1.00", "0.988", "0.500", "0.0625", "0.123", "0.778"]
    assert all(len(row.all("td", "meaning")[0].text) > 20 for row in rows)
    caption = table.all("caption")[0].text
    assert "7 queries" in caption
    assert "2 shapes failed and count as misses" in caption
    assert "1 shape is alone in its class" in caption


def test_the_curve_runs_through_its_points(tmp_path: Path) -> None:
    svg = Page(full_page(tmp_path)).root.all("svg")[0]
    drawn = svg.all("polyline")[0].attributes["points"] or ""
    recall, down = np.array([point.split(",") for point in drawn.split()], dtype=float).T
    np.testing.assert_allclose(recall, CURVE.recall)
    np.testing.assert_allclose(1 - down, CURVE.precision)
    assert svg.attributes["role"] == "img"
    assert svg.all("title")[0].attributes["id"] == svg.attributes["aria-labelledby"]
    assert "from 1.00 at recall 0 to 0.250 at recall 1" in svg.all("title")[0].text


def test_failures_are_listed_with_their_stage(tmp_path: Path) -> None:
    details = Page(full_page(tmp_path)).root.all("details")[0]
    assert "open" in details.attributes
    assert details.all("summary")[0].text == "2 shapes failed"
    for row, failure in zip(details.all("tbody")[0].all("tr"), FAILURES, strict=True):
        for part in (failure.shape_id, failure.stage, failure.message, failure.error):
            assert part in row.text


def test_title_and_facts_come_first(tmp_path: Path) -> None:
    header = Page(full_page(tmp_path)).root.all("header")[0]
    assert header.all("h1")[0].text == "Cats & dogs"
    assert [name.text for name in header.all("dt")] == ["Shapes", "Distance"]
    assert [value.text for value in header.all("dd")] == ["6", "log"]


def test_element_ids_are_distinct_and_all_references_resolve(tmp_path: Path) -> None:
    page = Page(full_page(tmp_path)).root
    tags = ("h2", "h3", "title", "section", "svg")
    attributes = [element.attributes for tag in tags for element in page.all(tag)]
    ids = [found["id"] for found in attributes if "id" in found]
    assert len(set(ids)) == len(ids)
    assert {found["aria-labelledby"] for found in attributes if "aria-labelledby" in found} == set(ids)
    articles = {article.attributes["id"]: article.all("h3")[0].text for article in page.all("article")}
    assert list(articles.values()) == [panel.query.id for panel in PANELS]
    links = {link.attributes["href"]: link.text for link in page.all("a")}
    assert links == {"#q1": "scan-1"}  # the only result that is a query too
    assert articles["q1"] == "scan-1"


def test_without_measures_labels_or_pictures(tmp_path: Path) -> None:
    panel = Panel(Card("query"), (Card("first", distance=0.5), Card("second")))
    page = Page(write_report(tmp_path / "bare.html", title="Query", panels=[panel])).root
    for tag in ("table", "svg", "details", "dl", "img"):
        assert page.all(tag) == []
    assert page.all("span", "mark") == []
    assert [item.own_text for item in page.all("li")] == [["first"], ["second"]]
    assert [empty.text for empty in page.all("i", "empty")] == ["no picture"] * 3
    assert len(page.all("ol")[0].all("b")) == 1


def test_without_panels(tmp_path: Path) -> None:
    page = Page(write_report(tmp_path / "page.html", title="Scores", panels=[], measures=MEASURES)).root
    assert (len(page.all("table")), len(page.all("h2")), page.all("article")) == (1, 1, [])


def test_markup_in_names_stays_text(tmp_path: Path) -> None:
    query = Card(NASTY, NASTY, NASTY, None, png(9))
    hit = Card(f"{NASTY} 2", NASTY, NASTY, 1.0, png(8), True)
    path = write_report(
        tmp_path / "nasty.html",
        title=NASTY,
        panels=[Panel(query, (hit,))],
        failures=[Failure(NASTY, NASTY, "RemeshError", NASTY)],
        facts={NASTY: NASTY},
    )
    page = Page(path).root
    assert not any("alert" in script.text or script.attributes for script in page.all("script"))
    for tag in ("title", "h1", "dt", "dd", "h3"):
        assert page.all(tag)[0].text == NASTY
    assert page.all("article")[0].attributes["data-name"] == NASTY
    (item,) = page.all("li")
    assert item.own_text == [f"{NASTY} 2"]
    assert [span.text for span in item.all("span")] == [NASTY, "right"]
    assert [set(image.attributes) for image in page.all("i", "picture")] == [{"class"}] * 2


@pytest.mark.parametrize(
    ("distance", "shown"),
    [(0, "0.00"), (0.98765, "0.988"), (12.3456, "12.3"), (432.1, "432"), (1234.5, "1230")],
)
def test_distances_have_three_digits(tmp_path: Path, distance: float, shown: str) -> None:
    panel = Panel(Card("query"), (Card("found", distance=distance),))
    page = Page(write_report(tmp_path / "page.html", title="Query", panels=[panel])).root
    assert page.all("ol")[0].all("b")[0].text == shown


def test_the_same_input_gives_the_same_page_in_place_of_the_old_one(tmp_path: Path) -> None:
    path = full_page(tmp_path)
    first = path.read_bytes()
    path.write_text("an older page", encoding="utf-8")
    with path.open("rb") as reader:  # of the old page, which is never cut short
        assert full_page(tmp_path) == path
        assert reader.read() == b"an older page"
    assert path.read_bytes() == first
    assert list(tmp_path.iterdir()) == [path]
    assert path.is_absolute()


def test_file_names_that_are_no_text(tmp_path: Path) -> None:
    panel = Panel(Card("query", path="in/caf\udce9.ply"), ())
    page = Page(write_report(tmp_path / "page.html", title="Ü", panels=[panel])).root
    assert page.all("h1")[0].text == "Ü"
    assert "in/caf?.ply" in page.all("article")[0].text


def test_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    for place in ("missing/report.html", "file/report.html", "folder"):
        with pytest.raises(InputError, match=f"cannot write .*{place}: .*; name a file in a folder"):
            write_report(tmp_path / place, title="Query", panels=[])
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "folder"]


def test_cards_must_be_sound() -> None:
    with pytest.raises(InputError, match=r"picture of s must be a PNG, got 5 bytes that start with b'GIF89'"):
        Card("s", picture=b"GIF89")
    for distance in (-0.1, np.nan, np.inf):
        with pytest.raises(InputError, match=f"distance of s must be at least 0 and finite, got {distance}"):
            Card("s", distance=distance)


def test_results_must_be_sorted() -> None:
    with pytest.raises(InputError, match=r"results of q must ascend in distance, got b at 1 after a at 2"):
        Panel(Card("q"), (Card("a", distance=2), Card("x"), Card("b", distance=1)))
