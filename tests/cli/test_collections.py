"""`pcretrieve duplicates`, `cluster` and `map`."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
import shapes
from click.testing import CliRunner, Result
from PIL import Image

import pcretrieve as pr
from pcretrieve.catalogue import Content, Record
from pcretrieve.cli.main import cli
from pcretrieve.descriptors import describe
from pcretrieve.errors import InputError
from pcretrieve.pipeline.process import process
from pcretrieve.values import Verdict

OPTIONS = pr.PipelineOptions()


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve eggs of three kinds; the fourth of each is almost the third, and not sound of the last kind."""
    location = tmp_path_factory.mktemp("collections") / "eggs.sqlite"
    with pr.Catalogue(location, create=True) as store:
        for kind in range(3):
            for number, width in enumerate((1, 1.04, 1.08, 1.0801)):
                shape = process(shapes.ellipsoid((width, 1, 1.3 + 0.5 * kind), 3))
                sound = (kind, number) != (2, 3)
                verdict = Verdict("sound" if sound else "doubtful", 0.01 if sound else 0.5)
                content = Content(replace(shape, verdict=verdict), describe(shape, OPTIONS.signature).values)
                label = None if kind == 2 else f"<kind {kind}>"
                name = f"{kind}{number}"
                store.put(Record(name, f"/{name}.off", name, label), content)
    return location


def run(*arguments: object, code: int = 0) -> Result:
    result = CliRunner().invoke(cli, [str(word) for word in arguments])
    assert result.exit_code == code, result.output
    return result


def test_duplicates_are_nearer_than_the_noise(catalogue: Path) -> None:
    pairs = pr.duplicates(catalogue)
    assert {(pair.first, pair.second) for pair in pairs} == {("02", "03"), ("12", "13")}
    assert all(pair.limit == pytest.approx(0.01 * 2**0.5) for pair in pairs)
    done = run("duplicates", "-c", catalogue)
    assert [line.split()[2:] for line in done.stdout.splitlines()[1:]] == [
        [pair.first, pair.second] for pair in pairs
    ]
    assert done.stderr == "2 pairs\n"
    printed = json.loads(run("duplicates", "-c", catalogue, "--json").stdout)["result"]
    assert printed == [pair._asdict() for pair in pairs]


def test_a_map_is_a_picture_or_a_page(catalogue: Path, tmp_path: Path) -> None:
    page, picture = tmp_path / "map.html", tmp_path / "map.png"
    assert run("map", "-c", catalogue, "-o", page).stdout == f"{page}\n"
    assert pr.draw_map(catalogue, picture) == picture
    with Image.open(picture) as opened:
        assert opened.size[0] > 600
    text = page.read_text("utf-8")
    assert len(re.findall(r'<path role="img" tabindex', text)) == 12
    assert "&lt;kind 0&gt;" in text and "<kind 0>" not in text
    assert text.count("class unknown") == 1
    embedded = re.search(r'id="pictures">(.*?)</script>', text, re.DOTALL)
    assert embedded is not None
    pictures = json.loads(embedded[1])
    assert len(pictures) == 12 and all(data.startswith("iVBOR") for data in pictures)
    assert not re.search(r"(src|href)=\"(?!data:)", text), "it makes no requests"
    for name in ("again.html", "once_more.html"):  # with the thumbnails that the first one kept
        pr.draw_map(catalogue, tmp_path / name)
    assert (tmp_path / "again.html").read_bytes() == (tmp_path / "once_more.html").read_bytes()
    with pytest.raises(InputError, match=r"a picture \.png or a page \.html, got map\.gif"):
        pr.draw_map(catalogue, tmp_path / "map.gif")
