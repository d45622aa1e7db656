"""Commands that compare shapes: by signatures, matrices and matchers; their measures, groups and maps."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any
from unittest.mock import ANY

import numpy as np
import pytest
import shapes
from commands import refusal, result, run
from PIL import Image

import pcretrieve as pr
from pcretrieve.catalogue import Content, Record
from pcretrieve.formats import write_mesh
from pcretrieve.gallery.answers import Described, Question, answer_to
from pcretrieve.shrec.matcher import MATCHERS, match_all

N_KINDS, N_EACH = 4, 4
PCA = ("--whitening", "pca", "--distance", "d1", "--n-values", 9)
PLAIN = ("--whitening", "none")
METHOD = ("--method", "r-bihdm")


@pytest.fixture(scope="module")
def eggs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A catalogue of eggs of four kinds, four of each."""
    place = tmp_path_factory.mktemp("eggs")
    labels = {}
    for kind in range(N_KINDS):
        for number in range(N_EACH):
            axes = (1 + 0.1 * number, 1, 1.2 + 0.08 * kind)
            write_mesh(
                shapes.ellipsoid(axes, subdivisions=3), place / f"{kind}{number}.off"
            )
            labels[f"{kind}{number}.off"] = f"kind{kind}"
    (place / "labels.csv").write_text(
        "\n".join(["file,class", *(f"{name},{label}" for name, label in labels.items())])
    )
    pr.ingest(place, place / "eggs.sqlite", labels=labels, workers=1)
    return place


# --- options --------------------------------------------------------------------------------------------


def test_a_file_gives_commands_their_options_and_flags_override_it(
    eggs: Path, tmp_path: Path
) -> None:
    """Of R-BiHDM, whose values have a scale."""
    mine, asked = (
        tmp_path / "mine.toml",
        ("evaluate", "-c", eggs / "eggs.sqlite", *METHOD),
    )
    mine.write_text(
        "[signature]\nn_values = 9\n[retrieval]\nwhitening = 'pca'\ndistance = 'd1'\n"
    )
    by_file = result(*asked, "--config", mine)
    assert (by_file["n_values"], by_file["whitening"], by_file["distance"]) == (
        9,
        "pca",
        "d1",
    )
    assert by_file == result(*asked, *PCA)
    back = ("--whitening", "auto", "--distance", "log", "--n-values", 23)
    assert result(*asked, "--config", mine, *back) == result(*asked)
    query = ("query", eggs / "10.off", *asked[1:])
    assert result(*query, "--config", mine) == result(*query, *PCA) != result(*query)
    run(
        "report",
        *asked[1:],
        "-o",
        tmp_path / "page.html",
        "--queries",
        1,
        "--config",
        mine,
    )
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    for name, value in {"distance": "d1", "whitening": "pca: the cov"}.items():
        assert re.search(rf"<dt>{name}</dt>\s*<dd>{value}", page), name


def test_sizes_are_compared_in_one_unit_or_not_at_all(tmp_path: Path) -> None:
    """Bodies of one form whose areas differ by 1.44; in metres as files say, and in a file without a unit."""
    catalogue, query, sized = (
        tmp_path / "c.sqlite",
        tmp_path / "query.off",
        ("--size-weight", 6),
    )
    body = shapes.ellipsoid((1, 1, 1.7), subdivisions=3)
    for name, height in (("small.glb", 1.0), ("large.glb", 1.2), ("query.off", 120.0)):
        write_mesh(pr.TriangleMesh(body.vertices * height, body.faces), tmp_path / name)
    run("ingest", *sorted(tmp_path.glob("*.glb")), "-c", catalogue, "--workers", 1)
    first, second = result("query", query, "-c", catalogue, *sized, "--unit", "cm")[0][
        "neighbors"
    ]
    assert (first["id"], second["id"]) == ("large", "small")
    assert first["distance"] < 0.05
    assert second["distance"] == pytest.approx(6 * np.log(1.2**2), rel=0.01)
    options = {"signature": {"size_weight": 6}}
    known = pr.search(
        catalogue, pr.read_scan(query), options=options, unit="cm"
    ).neighbors
    assert known.distances.tolist() == [first["distance"], second["distance"]]
    signed = pr.signature(query, {**options, "scan": {"unit": "cm"}})
    assert pr.search(catalogue, signed, options=options).neighbors == known
    said = refusal("query", query, "-c", catalogue, "--scale", "absolute")
    assert (
        "the shapes are in metres, the unit of the query is unknown; say the unit" in said
    )
    for unknown in (query, pr.signature(query, options), pr.read_scan(query)):
        with pytest.raises(
            pr.InputError,
            match=r"say the unit of the query by --unit \(scan.unit\), or comp",
        ):
            pr.search(catalogue, unknown, options=options)
    run("ingest", query, "-c", catalogue, "--workers", 1)
    labels = tmp_path / "labels.csv"
    labels.write_text("file,class\nlarge,a\nsmall,a\nquery,a\n")
    for command in (
        ("query", "large"),
        ("evaluate", "--labels", labels),
        ("report", "-o", tmp_path / "page.html"),
    ):
        said = refusal(*command, "-c", catalogue, *sized)
        assert (
            "some shapes are in metres, the unit of others is unknown; ingest all" in said
        )
        run(*command, "-c", catalogue)


def test_incomplete_scans_are_counted_and_a_query_says_so(tmp_path: Path) -> None:
    ball, body, catalogue = shapes.icosphere(3), shapes.body(3), tmp_path / "c.sqlite"
    for name, mesh, first in (
        ("open", ball, 12),
        ("whole", body, 0),
        ("other", body, 12),
    ):
        write_mesh(
            pr.TriangleMesh(mesh.vertices, mesh.faces[first:]), tmp_path / f"{name}.off"
        )
    scans = tmp_path / "open.off", tmp_path / "whole.off"
    done = run(
        "ingest", *scans, "-c", catalogue, "--surface", "keep", "--workers", 1, "--json"
    )
    assert "1 incomplete, which may answer wrongly: " in done.stderr
    assert "the same is wrong with 1 of them: the mesh has holes" in done.stderr
    advice = done.stderr.split("`")[1].split()
    assert advice == ["pcretrieve", "list", "--incomplete", "-c", str(catalogue)]
    assert "the mesh has holes" in run(*advice[1:]).stdout
    worst = done.stderr.splitlines()[-1].split()
    assert worst[:2] == ["open", "incomplete"] and worst[3:6] == ["the", "mesh", "has"]
    # Nobody needs to see again what somebody has accepted.
    run("mark", "open", "accept", "-c", catalogue)
    again = run("ingest", *scans, "-c", catalogue, "--surface", "keep", "--workers", 1)
    assert "1 incomplete" in again.stderr and "WORST" not in again.stderr
    assert json.loads(done.stdout)["result"]["incomplete"] == ["open"]
    asked = run("query", "-c", catalogue, tmp_path / "other.off")
    assert (
        "other.off is incomplete, may answer wrongly: the mesh has holes" in asked.stderr
    )
    assert [
        line.split()[4]
        for line in asked.stdout.splitlines()
        if line.endswith("  incomplete")
    ] == ["open"]


def test_good_only_asks_for_good_scans_in_the_whole_gallery(tmp_path: Path) -> None:
    catalogue, options = tmp_path / "c.sqlite", pr.PipelineOptions()
    with pr.Catalogue(catalogue, create=True) as store:
        for number, (kind, width) in enumerate(product("ab", (1, 1.1))):
            shape = pr.process(
                shapes.ellipsoid((width, 1, 1.8 if kind == "a" else 2.3), 3)
            )
            grade = pr.Grade("poor" if number == 3 else "good", 0.5)
            values = pr.describe(shape, options.signature).values
            content = Content(replace(shape, grade=grade), values)
            store.put(
                Record(f"{number}", f"/{number}.off", f"hash {number}", kind), content
            )
    assert run("evaluate", "-c", catalogue).stderr.startswith("4 queries in 4 shapes")
    good = run("evaluate", "-c", catalogue, "--good-only")
    assert good.stderr.startswith("3 of 4 queries in 4 shapes")


def test_a_query_of_another_resolution_is_told(eggs: Path, tmp_path: Path) -> None:
    fine = tmp_path / "fine.off"
    write_mesh(shapes.ellipsoid((1, 1.2, 1.5), subdivisions=4), fine)
    said = run("query", "-c", eggs / "eggs.sqlite", fine).stderr
    assert "fine.off has 4 times" not in said
    write_mesh(shapes.ellipsoid((1, 1.2, 1.5), subdivisions=5), fine)
    assert (
        "fine.off: it has 16 times the faces of the results"
        in run("query", "-c", eggs / "eggs.sqlite", fine).stderr
    )


def test_a_size_that_a_wrong_unit_explains_is_told(eggs: Path, tmp_path: Path) -> None:
    """With the option that mends it; by `query`, in JSON, and by `ingest`."""
    catalogue = tmp_path / "c.sqlite"
    for name, scale, words in (
        (
            "mm",
            1000,
            "about 1,000 times as large as the others; if its unit is mm, give --unit mm",
        ),
        (
            "cm",
            100,
            "about 100 times as large as the others; if its unit is cm, give --unit cm",
        ),
        (
            "km",
            0.001,
            "about 1,000 times as small as the others; give each file its unit by --unit",
        ),
        ("m", 3, ""),
    ):
        scaled = tmp_path / f"{name}.off"
        write_mesh(shapes.ellipsoid((scale, scale, 1.2 * scale), subdivisions=3), scaled)
        done = run("query", "-c", eggs / "eggs.sqlite", scaled, "--json")
        (answer,) = json.loads(done.stdout)["result"]
        assert answer["notes"] == ([f"its size is {words}"] if words else [])
        assert words in done.stderr and (words or not done.stderr)
    run("catalogue", "backup", eggs / "eggs.sqlite", catalogue)
    said = run(
        "ingest", tmp_path / "mm.off", eggs / "00.off", "-c", catalogue, "--workers", 1
    ).stderr
    assert (
        f"the size of 1 scans, such as {tmp_path / 'mm.off'}, is about 1,000 times as large"
        in said
    )


def test_a_query_of_fewer_faces_is_told_too(eggs: Path) -> None:
    signature = pr.signature(eggs / "00.off")
    with pr.Catalogue(eggs / "eggs.sqlite") as store:
        question = Question(store.options, 3)
        for n_faces, said in ((80, ("it has 0.062 times the faces",)), (640, ())):
            notes = answer_to(
                store, Described(signature, n_faces=n_faces), question
            ).notes
            assert tuple(note.partition(" of the")[0] for note in notes) == said


def test_a_false_match_rate_needs_as_many_pairs(eggs: Path) -> None:
    asked = ("query", "-c", eggs / "eggs.sqlite", "00", "--far")
    assert run(*asked, 0.1).stderr == ""
    said = run(*asked, 1e-6).stderr
    assert (
        "00: the 96 pairs of two classes are too few for a false-match rate of 1e-06"
        in said
    )


def test_a_catalogue_of_failures_has_pages(tmp_path: Path) -> None:
    """With the reasons; one without any shapes has none."""
    catalogue, page = tmp_path / "c.sqlite", tmp_path / "page.html"
    with pr.Catalogue(catalogue, create=True) as store:
        assert "an index needs at least 1 shape" in refusal(
            "report", "-c", catalogue, "-o", page
        )
        assert "an index needs at least 1 shape" in refusal(
            "serve", "-c", catalogue, "--port", 0
        )
        failed = Record(
            "bad", "/bad.off", "", status="failed", stage="read", error="ScanReadError"
        )
        store.put(replace(failed, message="it is empty"))
    run("report", "-c", catalogue, "-o", page)
    assert "it is empty" in page.read_text()


# --- matrices and comparisons ---------------------------------------------------------------------------


def test_a_matcher_makes_a_matrix_that_ranks(eggs: Path, tmp_path: Path) -> None:
    path, catalogue = tmp_path / "heat.npy", tmp_path / "c.sqlite"
    run("catalogue", "backup", eggs / "eggs.sqlite", catalogue)
    (tmp_path / "broken.off").write_text("OFF\n")
    (tmp_path / "labels.csv").write_text("file,class\nbroken,kind0\n")
    ingest = (
        "ingest",
        tmp_path / "broken.off",
        "--labels",
        tmp_path / "labels.csv",
        "--workers",
        1,
    )
    run(*ingest, "-c", catalogue, code=3)
    made = pr.matrix(catalogue, matcher="heat-hausdorff")
    pr.write_matrix(made, path)
    with pr.Catalogue(catalogue) as store:
        matched = match_all(MATCHERS["heat-hausdorff"], made.ids, store.shape)
        expected = pr.DistanceMatrix(*matched)
    assert pr.read_matrix(path) == replace(made, labels=()) == expected
    assert made.labels == tuple(f"kind{shape_id[0]}" for shape_id in made.ids)
    found = result("evaluate", "-c", catalogue, "--matrix", path)
    assert (found["n_queries"], found["n_failed"]) == (17, 1)
    assert (
        result("query", "-c", catalogue, eggs / "10.off", "--matrix", path)[0][
            "neighbors"
        ][0]["id"]
        == "10"
    )
    with pytest.raises(
        pr.OptionError, match="there is no matcher 'sift'; there are heat-hausdorff, "
    ):
        pr.matrix(catalogue, matcher="sift")


def test_re_ranking_is_a_row_more_and_works_by_a_matrix(
    eggs: Path, tmp_path: Path
) -> None:
    catalogue, labels = eggs / "eggs.sqlite", eggs / "labels.csv"
    chosen = ("-c", catalogue, *PLAIN)
    plain = {"retrieval": {"whitening": "none"}}
    pr.write_matrix(pr.matrix(catalogue, options=plain), tmp_path / "eggs.npy")
    own = run("evaluate", *chosen, "--rerank", "k-reciprocal").stdout.splitlines()
    assert own[1].endswith("  micro-average, plain")
    assert own[2].endswith("  micro-average, k-reciprocal")
    by_matrix = (
        "evaluate",
        "--matrix",
        tmp_path / "eggs.npy",
        "--rerank",
        "k-reciprocal",
    )
    assert run(*by_matrix, "--labels", labels).stdout.splitlines() == own
    assert run(*by_matrix, "-c", catalogue).stdout.splitlines() == own
    np.save(tmp_path / "far.npy", np.where(np.eye(16) > 0, 0, np.inf))
    (tmp_path / "far.ids").write_text((tmp_path / "eggs.ids").read_text())
    far = ("evaluate", "--matrix", tmp_path / "far.npy", "--labels", labels)
    assert run(*far, "--rerank", "none").stdout
    said = refusal(*far, "--rerank", "k-reciprocal")
    assert "re-ranking needs finite distances, got 240 that are infinite" in said


def test_two_settings_matrices_and_files_give_one_comparison(
    eggs: Path, tmp_path: Path
) -> None:
    catalogue = eggs / "eggs.sqlite"
    plain = {"retrieval": {"whitening": "none"}, "signature": {"method": "r-bihdm"}}
    short = {
        "retrieval": {"whitening": "none", "distance": "d1"},
        "signature": {"method": "r-bihdm", "n_values": 5},
    }
    settings: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
        "one": (plain, ("--distance", "log")),
        "two": (short, ("--distance", "d1", "--n-values", "5")),
    }
    for name, (options, flags) in settings.items():
        pr.write_matrix(pr.matrix(catalogue, options=options), tmp_path / f"{name}.txt")
        run(
            "evaluate", "-c", catalogue, *PLAIN, *METHOD, *flags, "--csv", tmp_path / name
        )
    expected = pr.compare(catalogue, catalogue, options=plain, second_options=short)
    assert (expected.difference != 0).any()
    matrices = (tmp_path / "one.txt", tmp_path / "two.txt")
    assert pr.compare(*matrices, labels=eggs / "labels.csv") == expected
    files = (tmp_path / "one" / "queries.csv", tmp_path / "two" / "queries.csv")
    assert pr.compare(*files) == expected


def test_the_curve_is_printed_and_drawn(eggs: Path, tmp_path: Path) -> None:
    chosen = ("evaluate", "-c", eggs / "eggs.sqlite", *METHOD, "--curve")
    printed = run(*chosen, "--csv", tmp_path / "new").stdout.splitlines()
    head = next(row for row, line in enumerate(printed) if line.startswith("CLASSES"))
    points = result(*chosen)["curve"]
    assert [int(line.split()[0]) for line in printed[head + 1 :]] == [
        point["n_classes"] for point in points
    ]
    for line, point in zip(printed[head + 1 :], points, strict=True):
        assert float(line.split()[1]) == pytest.approx(point["rank_1"], abs=1e-4)
    with (tmp_path / "new" / "curve.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["rank_1"]) for row in rows] == [one["rank_1"] for one in points]
    assert (tmp_path / "new" / "curve.png").read_bytes().startswith(b"\x89PNG")


def test_several_methods_give_one_table(eggs: Path, tmp_path: Path) -> None:
    """Each row is what `evaluate` gives of that method alone, with the other options that were given."""
    names = ("r-bihdm", "shape-dna", "moments")
    catalogue = eggs / "eggs.sqlite"
    asked = ("evaluate", "-c", catalogue, *PLAIN)
    several = [word for name in names for word in ("--method", name)]
    lines = run(*asked, *several, "--csv", tmp_path / "three").stdout.splitlines()
    assert lines[0].split()[:3] == ["METHOD", "NN", "FT"]
    documents = result(*asked, *several)
    with (tmp_path / "three" / "methods.csv").open(encoding="utf-8", newline="") as file:
        written = list(csv.DictReader(file))
    chosen = {"retrieval": {"whitening": "none"}}
    found = pr.evaluate_methods(catalogue, names, options=chosen)
    table = found._repr_html_()
    for name, line, document, row in zip(
        names, lines[1:], documents, written, strict=True
    ):
        alone = result(*asked, "--method", name)
        assert line.split()[:3] == [name, f"{alone['nn']:.4f}", f"{alone['ft']:.4f}"]
        assert document["method"] == row["method"] == name
        assert document["map"] == float(row["map"]) == alone["map"] == found[name].map
        assert (tmp_path / "three" / name / "queries.csv").is_file()
        assert f"<th>{name}<td>{alone['nn']:.4g}" in table
    assert len({document["map"] for document in documents}) == 3
    said = refusal("query", "00", "-c", catalogue, "--method", "hapt", "--method", "wks")
    assert "hapt,wks" in said


# --- duplicates and maps --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def near(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six eggs of two kinds; the third of each is almost the second, the last one coarse and incomplete."""
    location, options = (
        tmp_path_factory.mktemp("near") / "eggs.sqlite",
        pr.PipelineOptions(),
    )
    with pr.Catalogue(location, create=True) as store:
        for number, (kind, width) in enumerate(product(("a", None), (1, 1.08, 1.0801))):
            shape = pr.process(
                shapes.ellipsoid(
                    (width, 1, 1.8 if kind else 2.3), 2 if number == 5 else 3
                )
            )
            grade = pr.Grade("incomplete", 0.5) if number == 5 else pr.Grade("good", 0.01)
            content = Content(
                replace(shape, grade=grade), pr.describe(shape, options.signature).values
            )
            store.put(
                Record(f"{number}", f"/{number}.off", f"hash {number}", kind), content
            )
    return location


def test_copies_of_other_resolution_are_duplicates(near: Path) -> None:
    pair, coarse = pr.duplicates(near)
    assert (
        pair[:2] == ("1", "2")
        and coarse[:2] == ("4", "5")
        and coarse.distance > 5 * pair.distance
    )
    page = near.with_name("pairs.html")
    done = run("duplicates", "-c", near, "--html", page)
    assert [line.split()[2:] for line in done.stdout.splitlines()[1:]] == [
        ["surface", "1", "2"],
        ["surface", "4", "5"],
    ]
    assert done.stderr == f"page: {page}\n2 pairs\n"
    assert re.findall('alt="(.*?)" src="data:', page.read_text("utf-8")) == [
        "1",
        "2",
        "4",
        "5",
    ]
    found = result("duplicates", "-c", near)
    assert found == [
        one._asdict() | {"classes": [*one.classes]} for one in (pair, coarse)
    ]


def test_copies_of_two_classes_are_in_a_table_of_their_own(tmp_path: Path) -> None:
    """And copies of a file are told from surfaces that are the same."""
    catalogue = tmp_path / "mixed.sqlite"
    with pr.Catalogue(catalogue, pr.PipelineOptions(), create=True) as store:
        for row, (width, label) in enumerate([(1.0, "a"), (1.0, "a"), (1.0001, "b")]):
            shape = pr.process(shapes.ellipsoid((width, 1, 1.8), 3))
            values = pr.describe(shape, store.options.signature).values
            record = Record(f"{row}", f"/{row}.off", f"hash {label}", label)
            store.put(record, Content(shape, values))
    found = pr.duplicates(catalogue)
    assert {(one.first, one.second): one.evidence for one in found} == {
        ("0", "1"): "file",
        ("0", "2"): "surface",
        ("1", "2"): "surface",
    }
    first, second = run("duplicates", "-c", catalogue).stdout.split(
        "Of two classes: a wrong label, or two bodies\n"
    )
    assert [line.split()[2:] for line in first.splitlines()[1:]] == [
        ["file", "0", "1"],
        [],
    ]
    assert [line.split()[2:] for line in second.splitlines()[1:]] == [
        ["surface", one, "2", "a,", "b"] for one in "01"
    ]
    printed = run("duplicates", "-c", catalogue, "--csv").stdout
    rows = [tuple(row.values()) for row in csv.DictReader(printed.splitlines())]
    assert [(row[0], row[1], *row[4:]) for row in rows] == [
        (one.first, one.second, one.evidence, *one.classes) for one in found
    ]


def test_scans_that_are_not_stored_are_compared_with_what_is(
    near: Path, tmp_path: Path
) -> None:
    """A coarse mirror image is a copy, another body is none, and a file that fails stops neither."""
    coarse, other = (shapes.ellipsoid((1, 1, height), 2) for height in (1.8, 1.5))
    write_mesh(
        pr.TriangleMesh(coarse.vertices * [-1, 1, 1], coarse.faces[:, ::-1]),
        tmp_path / "mirrored.off",
    )
    write_mesh(other, tmp_path / "other.off")
    (tmp_path / "broken.off").write_text("OFF\n")
    done = run("duplicates", tmp_path, "-c", near, code=3)
    assert [line.split()[2:] for line in done.stdout.splitlines()[1:]] == [
        ["surface", str(tmp_path / "mirrored.off"), "0"]
    ]
    assert "broken.off" in done.stderr
    found = {Path(name).stem: pairs for name, pairs in pr.copies(near, [tmp_path])}
    assert isinstance(found["broken"], pr.ShapeError) and found["other"] == []
    assert found["mirrored"] == [
        pr.NearPair(str(tmp_path / "mirrored.off"), "0", ANY, ANY, "surface", (None, "a"))
    ]
    ((_, every),) = pr.copies(near, [tmp_path / "other.off"], threshold=1e9)
    assert isinstance(every, list) and {one.second for one in every} == {*"012345"}
    assert every == sorted(every, key=lambda one: one.distance)
    assert "leave out --html" in refusal(
        "duplicates", tmp_path, "-c", near, "--html", tmp_path / "page.html"
    )


def test_a_map_is_a_picture_or_a_page(near: Path, tmp_path: Path) -> None:
    page, picture = tmp_path / "map.html", tmp_path / "map.png"
    assert run("lab", "map", "-c", near, "-o", page).stdout == f"{page}\n"
    assert pr.draw_map(near, picture) == picture
    with Image.open(picture) as opened:
        assert opened.size[0] > 600
    text = page.read_text("utf-8")
    assert (
        len(re.findall(r'role="img".*data-picture="data:image/png;base64,iVBOR', text))
        == 6
    )
    for name in (
        "again.html",
        "once_more.html",
    ):  # with the thumbnails that the first one kept
        pr.draw_map(near, tmp_path / name)
    assert (tmp_path / "again.html").read_bytes() == (
        tmp_path / "once_more.html"
    ).read_bytes()
    with pytest.raises(
        pr.InputError, match=r"a picture \.png or a page \.html, got map\.gif"
    ):
        pr.draw_map(near, tmp_path / "map.gif")
