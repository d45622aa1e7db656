"""Queries are files, ids and signatures; Python, commands and pages answer a question alike."""

from __future__ import annotations

import csv
import json
import pickle
import shutil
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes
from commands import result, run

import pcretrieve as pr
from pcretrieve.catalogue import Content, Record
from pcretrieve.descriptors import describe
from pcretrieve.errors import (
    CatalogueError,
    InputError,
    OptionError,
    ScanReadError,
    ShapeError,
)
from pcretrieve.values import Neighbors, TriangleMesh

N_KINDS, N_EACH = 3, 4
SCANS = Path(__file__).parent.parent / "scans"


def egg(kind: int, number: float) -> TriangleMesh:
    return shapes.ellipsoid((1 + 0.1 * number, 1, 1.2 + 0.15 * kind), subdivisions=3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eggs of three kinds and a failure in a catalogue, and two scans in a folder that it does not have."""
    folder = tmp_path_factory.mktemp("eggs")
    for name in ("stored", "new"):
        (folder / name).mkdir()
    labels = {
        f"{kind}{number}": f"kind{kind}"
        for kind in range(N_KINDS)
        for number in range(N_EACH)
    }
    for name in labels:
        pr.write_mesh(egg(int(name[0]), int(name[1])), folder / "stored" / f"{name}.off")
    (folder / "stored" / "broken.off").write_text("OFF\n1 1 0\n")
    pr.ingest(folder / "stored", folder / "c.sqlite", labels=labels, workers=1)
    for kind in range(2):
        pr.write_mesh(egg(kind, 0.5), folder / "new" / f"new{kind}.off")
    return folder


@pytest.fixture(scope="module")
def catalogue(folder: Path) -> Path:
    return folder / "c.sqlite"


def among(found: Neighbors, ids: Sequence[str], k: int) -> Neighbors:
    """The first results that are some shapes."""
    rows = [row for row, name in enumerate(found.ids) if name in ids][:k]
    return Neighbors(tuple(found.ids[row] for row in rows), found.distances[rows])


def nearest(*asked: Any, **how: Any) -> Neighbors:
    return pr.search(*asked, **how).neighbors


def test_a_file_an_id_and_a_signature_are_answered_alike(
    catalogue: Path, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file wins over an id of its name, a folder does not."""
    stored = folder / "stored" / "11.off"
    expected = nearest(catalogue, "11", k=4)
    assert (expected.ids[0], expected.distances[0]) == ("11", 0)
    for query in (stored, str(stored), pr.signature(stored)):
        assert nearest(catalogue, query, k=4) == expected
    monkeypatch.chdir(tmp_path)
    shutil.copy(stored, "20")
    assert nearest(catalogue, "20").ids[0] == "11"
    shutil.move("20", "20.off")
    Path("20").mkdir()
    assert [nearest(catalogue, name).ids[0] for name in ("20", "20.off")] == ["20", "11"]


def test_what_is_no_query(catalogue: Path, folder: Path) -> None:
    for query, message in (
        (
            "nobody",
            "'nobody' is no file and no shape of .*; `pcretrieve list` names the shapes",
        ),
        ("broken", "shape 'broken' failed in read: "),
    ):
        with pytest.raises(InputError, match=message):
            nearest(catalogue, query)
        with pytest.raises(InputError, match=message):  # before the work
            next(pr.search_many(catalogue, [folder / "new", query]))
    with pytest.raises(
        InputError, match=r"a distance matrix ranks shapes .* does not hold .*new0\.off"
    ):
        next(
            pr.search_many(catalogue, ["11", folder / "new"], matrix=pr.matrix(catalogue))
        )
    with pytest.raises(
        InputError,
        match="is of the class kind; `pcretrieve list` shows the classes; did you mean 'kind",
    ):
        nearest(catalogue, "11", labels=["kind1", "kind"])
    with pytest.raises(OptionError, match="labels must be a list, got 'kind1'"):
        nearest(catalogue, "11", labels="kind1")


def test_signatures_that_were_computed_are_kept(catalogue: Path, tmp_path: Path) -> None:
    """Asked again, by whomever, nothing of a shape is read; of one that is new, what is needed."""
    shutil.copy(catalogue, tmp_path / "c.sqlite")
    with (
        pr.Catalogue(tmp_path / "c.sqlite") as first,
        pr.Catalogue(tmp_path / "c.sqlite") as other,
    ):
        options = first.options.changed(signature={"method": "wks"})
        table = pr.signatures(first, options=options)
        statements: list[str] = []
        other.rows.database._connection.set_trace_callback(statements.append)
        assert pr.signatures(other, options=options) == table
        assert not [text for text in statements if "arrays" in text]
        new = pr.process(egg(3, 0))
        content = Content(new, describe(new, other.options.signature).values)
        other.put(Record("new", "/new.off", "h"), content)
        other.put(replace(other.record("00"), content_hash="other content"), content)
        statements.clear()
        again = pr.signatures(other, options=options)
        read = [
            text
            for text in statements
            if text.startswith('SELECT shape, "spectra", "moments"')
        ]
        assert len(read) == 2
    expected = describe(new, options.signature).values.tolist()
    assert again.values.tolist() == [expected, *table.values[1:].tolist(), expected]


@pytest.mark.parametrize("distance", ["log", "d1", "d2"])
def test_ranks_in_some_classes_are_those_among_all_shapes(
    distance: str, catalogue: Path
) -> None:
    options = {"retrieval": {"distance": distance}, "signature": {"method": "r-bihdm"}}
    new = shapes.ellipsoid((1.02, 1, 1.3), subdivisions=3)
    signature = pr.signature(new, {"signature": {"method": "r-bihdm"}})
    some = [f"{kind}{number}" for kind in (0, 2) for number in range(N_EACH)]
    for query in ("11", "01", signature):
        everything = nearest(catalogue, query, k=N_KINDS * N_EACH, options=options)
        found = nearest(catalogue, query, k=5, options=options, labels=["kind2", "kind0"])
        assert found == among(everything, some, 5)


@pytest.mark.parametrize("rerank", ["none", "k-reciprocal"])
def test_a_query_can_be_left_out_of_its_results(
    rerank: str, catalogue: Path, folder: Path
) -> None:
    options = {"retrieval": {"rerank": rerank}}
    with_itself = nearest(catalogue, "11", k=4, options=options)
    assert with_itself.ids[0] == "11"
    without = nearest(catalogue, "11", k=3, options=options, exclude_self=True)
    assert without.ids == with_itself.ids[1:]
    np.testing.assert_array_equal(without.distances, with_itself.distances[1:])
    stored = folder / "stored" / "11.off"
    assert nearest(catalogue, stored, k=3, options=options, exclude_self=True) == without
    other = folder / "new" / "new0.off"
    assert nearest(catalogue, other, exclude_self=True) == nearest(catalogue, other)


def test_many_queries_are_answered_like_each(catalogue: Path, folder: Path) -> None:
    queries: list[str | Path] = ["11", folder / "new", str(folder / "stored" / "20.off")]
    answers = dict(pr.search_many(catalogue, queries, k=3))
    scans = [str(folder / "new" / f"new{kind}.off") for kind in range(2)]
    assert list(answers) == ["11", *scans, queries[2]]
    for name, answer in answers.items():
        assert isinstance(answer, pr.Answer)
        assert answer.neighbors == nearest(catalogue, name, k=3)
        alone = pr.search(catalogue, name, k=3)
        assert replace(answer, query=None) == replace(alone, query=None)
        classes = [f"kind{shape_id[0]}" for shape_id in answer.neighbors.ids]
        assert [record.label for record in answer.records] == classes


def test_what_is_printed_of_many(catalogue: Path, folder: Path) -> None:
    """One table of what is said of each; their neighbours with -v, in JSON and in CSV."""
    names = ["11", *(str(folder / "new" / f"new{kind}.off") for kind in range(2))]
    answers = [pr.search(catalogue, name, k=2) for name in names]
    lines = run(
        "query", "11", folder / "new", "-c", catalogue, "-k", 2
    ).stdout.splitlines()
    assert lines[0].split() == ["SCAN", "VERDICT", "CLASS", "SCORE"]
    assert [line.split()[:3] for line in lines[1:]] == [
        [name, one.verdict, one.label] for name, one in zip(names, answers, strict=True)
    ]
    long = run(
        "query", "11", folder / "new", "-c", catalogue, "-k", 2, "-v"
    ).stdout.splitlines()
    assert long[::5] == names
    assert [line.split()[4] for line in long if line.startswith("   ")] == [
        name for one in answers for name in one.neighbors.ids
    ]
    assert long[4::5] == [f"{one}, because {one.because}" for one in answers]
    broken = folder / "stored" / "broken.off"
    some = run(
        "query", "11", broken, "-c", catalogue, "-k", 1, code=3
    ).stdout.splitlines()
    assert some[2].split() == [str(broken), "-", "-", "-"]


def test_a_scan_that_fails_does_not_stop_the_others(
    catalogue: Path, folder: Path
) -> None:
    broken = folder / "stored" / "broken.off"
    queries = (folder / "new" / "new0.off", broken, "11")
    done = run("query", *queries, "-c", catalogue, "-k", 1, "--json", code=3)
    documents = json.loads(done.stdout)["result"]
    assert ["neighbors" in document for document in documents] == [True, False, True]
    assert (documents[1]["error"], documents[1]["stage"]) == ("ScanReadError", "read")
    assert f"failed: [broken.off / read] {documents[1]['message']}" in done.stderr
    answers = dict(pr.search_many(catalogue, queries, k=1))
    assert isinstance(answers[str(broken)], ScanReadError)
    assert isinstance(
        run("query", broken, "-c", catalogue, code=None).exception, ScanReadError
    )


def test_scores_come_with_distances_and_least_ones_leave_no_match(
    catalogue: Path,
) -> None:
    found = nearest(catalogue, "11", k=12)
    with pr.Catalogue(catalogue) as store:
        scores = pr.index(store).scores
        plain = nearest(store, "11", k=12, options={"retrieval": {"whitening": "none"}})
        made = {shape_id: pr.stored_signature(store, shape_id) for shape_id in store}
        assert repr(store) == f"Catalogue({catalogue}: {len(made)} shapes)"
    assert [
        made["11"].distance(made[one]) for one in plain.ids
    ] == plain.distances.tolist()
    assert scores is not None and found.scores is not None
    np.testing.assert_array_equal(found.scores, scores.of(found.distances))
    assert found.to_pandas().columns.tolist() == ["id", "distance", "score"]
    again = nearest(
        catalogue, "11", k=12, options={"retrieval": {"rerank": "k-reciprocal"}}
    )
    assert again.scores is not None
    score_of = dict(zip(found.ids, found.scores.tolist(), strict=True))
    assert again.scores.tolist() == [score_of[shape_id] for shape_id in again.ids]
    least = float(found.scores[5])
    kept = nearest(catalogue, "11", k=12, min_score=least)
    assert (
        kept.ids
        == tuple(name for name in found.ids if score_of[name] >= least)
        != found.ids
    )
    done = run("query", "11", "-c", catalogue, "--min-score", 1, "--verbose")
    assert done.stdout == "stranger, because no shape has a score of 1 or more\n"
    assert f"score: {scores.reason}" in done.stderr
    stranger = pr.search(catalogue, "11", min_score=1)
    assert (len(stranger.neighbors), stranger.verdict) == (0, "stranger")
    html = pickle.loads(pickle.dumps(found))._repr_html_()
    assert html.count("<img") == 10
    with pytest.raises(OptionError, match="min_score must be between 0 and 1, got 2"):
        nearest(catalogue, "11", min_score=2)
    with pytest.raises(InputError, match="a least score needs calibrated scores"):
        nearest(catalogue, "11", min_score=0.5, matrix=pr.matrix(catalogue))


SAID = ("verdict", "label", "other", "certainty", "because")


@pytest.mark.parametrize("query", ["00", "new0.off", "another body"])
def test_one_question_has_one_answer(
    query: str, catalogue: Path, folder: Path, tmp_path: Path
) -> None:
    """By Python, alone and among others, by the command, its JSON and CSV, and on its page."""
    scan = folder / "new" / query if query.endswith(".off") else tmp_path / "sphere.off"
    if query == "another body":
        pr.write_mesh(shapes.ellipsoid((1, 1, 4), subdivisions=3), scan)
    asked = query if query == "00" else str(scan)
    answer = pr.search(catalogue, asked, k=3)
    assert (
        answer.verdict in ("sure", "between", "stranger") and answer.certainty is not None
    )
    assert (answer.verdict == "stranger") == (query == "another body")
    assert answer.scan is not None and answer.scan.name in ("good", "poor", "incomplete")
    ((name, among),) = pr.search_many(catalogue, [asked], k=3)
    assert isinstance(among, pr.Answer) and name == asked
    assert replace(among, query=None) == replace(answer, query=None)
    page = tmp_path / "page.html"
    command = ("query", asked, "-c", catalogue, "-k", 3)
    (document,) = result(*command, "--html", page)
    assert {key: document[key] for key in SAID} == {
        key: getattr(answer, key) for key in SAID
    }
    assert document["scan"]["name"] == answer.scan.name
    assert [row["id"] for row in document["neighbors"]] == list(answer.neighbors.ids)
    assert [
        row["distance"] for row in document["neighbors"]
    ] == answer.neighbors.distances.tolist()
    rows = list(csv.DictReader(run(*command, "--csv").stdout.splitlines()))
    assert {row["query"] for row in rows} == {asked}
    for key in SAID:
        value = getattr(answer, key)
        assert {row[key] for row in rows} == {"" if value is None else str(value)}
    assert [row["neighbor"] for row in rows] == list(answer.neighbors.ids)
    assert {row["scan"] for row in rows} == {answer.scan.name}
    printed = run(*command).stdout.splitlines()
    assert printed[-1] == f"{answer}, because {answer.because}"
    text = page.read_text(encoding="utf-8")
    heads = {
        "sure": f"This is {answer.label}, <small>sure</small>",
        "between": f'<span class="between">{answer.named}?</span>',
        "stranger": "A stranger",
    }
    assert heads[answer.verdict] in text and f"Because {answer.because}." in text
    is_good = answer.scan.name == "good"
    assert (f"The scan is <b>{answer.scan.name}</b>" not in text) == is_good


def test_a_question_has_one_answer(catalogue: Path, folder: Path, tmp_path: Path) -> None:
    """By Python, by the command, on the page that each of them writes, and by a distance matrix."""
    scan = folder / "stored" / "00.off"
    for whitening in ("none", "pca", "within-class"):
        options = {"retrieval": {"whitening": whitening}}
        neighbors = nearest(catalogue, scan, k=3, options=options)
        assert neighbors.ids[0] == "00"
        asked = (scan, "-c", catalogue, "-k", 3, "--whitening", whitening)
        (answer,) = result("query", *asked, "--html", tmp_path / "command.html")
        assert [row["id"] for row in answer["neighbors"]] == list(neighbors.ids)
        assert [
            row["distance"] for row in answer["neighbors"]
        ] == neighbors.distances.tolist()
        page = pr.query_page(
            catalogue, scan, tmp_path / "python.html", k=3, options=options
        )
        text = page.read_text(encoding="utf-8")
        assert text == (tmp_path / "command.html").read_text(encoding="utf-8")
        assert all(shape_id in text for shape_id in neighbors.ids)
        pr.write_matrix(pr.matrix(catalogue, options=options), tmp_path / "run.npy")
        (by_matrix,) = result(
            "query", scan, "-c", catalogue, "-k", 3, "--matrix", tmp_path / "run.npy"
        )
        assert [row["id"] for row in by_matrix["neighbors"]] == list(neighbors.ids)


def test_measures_are_the_same_numbers(catalogue: Path, tmp_path: Path) -> None:
    for whitening in ("none", "pca"):
        printed = result(
            "evaluate", "-c", catalogue, "--whitening", whitening, "--per-class"
        )
        found = pr.evaluate(catalogue, options={"retrieval": {"whitening": whitening}})
        # A command counts all failures, and measures those of the classes.
        names = {part.name for part in fields(pr.RetrievalMeasures)} - {"n_failed"}
        assert {name: printed[name] for name in names} == {
            name: getattr(found, name) for name in names
        }
        assert printed["macro"]["map"] == found.macro.map
        assert [one["label"] for one in printed["classes"]] == [
            one.label for one in found.classes
        ]
        assert list(printed["interval"]["low"].values()) == found.interval[0].tolist()
    with pr.Catalogue(catalogue) as store:
        assert pr.evaluate(pr.signatures(store), options=store.options) == pr.evaluate(
            store
        )
    page = pr.report(catalogue, tmp_path / "bodies.html", k=2)
    run("report", "-c", catalogue, "-o", tmp_path / "same.html", "-k", 2)
    assert page.read_text(encoding="utf-8") == (tmp_path / "same.html").read_text(
        encoding="utf-8"
    )


def test_a_metric_of_labelled_scans_is_used_in_another_catalogue(
    catalogue: Path, folder: Path, tmp_path: Path
) -> None:
    """Eggs of one kind differ in one direction: in another catalogue, that direction counts less."""
    metric, other = tmp_path / "metric.npz", tmp_path / "other.sqlite"
    pr.ingest(folder / "new", other, workers=1)
    reason = result("lab", "calibrate", "-c", catalogue, "-o", metric)["reason"]
    learnt = pr.calibrate(catalogue, tmp_path / "again.npz")
    assert isinstance(learnt, pr.Whitening)
    assert (learnt.reason, reason) == ("within-class: 3 classes of 12 shapes",) * 2
    assert (tmp_path / "again.npz").read_bytes() == metric.read_bytes()
    chosen = {"retrieval": {"calibration": str(metric)}}
    with pr.Catalogue(other) as store:
        used = pr.index(store, options=store.options.changed(**chosen)).whitening
    np.testing.assert_array_equal(used.matrix, learnt.matrix)
    assert (used.kind, used.reason) == ("calibrated", f"{reason}, from {metric}")
    (found,) = result("query", "new0", "-c", other, "--whitening", metric)
    neighbors = nearest(other, "new0", options=chosen)
    assert [row["distance"] for row in found["neighbors"]] == neighbors.distances.tolist()
    plain = result("query", "new0", "-c", other, "--whitening", "none")
    assert found["neighbors"] != plain[0]["neighbors"]
    evaluated = result("evaluate", "-c", catalogue, "--whitening", metric)
    assert evaluated["whitening_used"] == f"{reason}, from {metric}"
    pr.calibrate(catalogue, metric, options={"signature": {"n_values": 9}})
    with pytest.raises(
        InputError, match="must be fitted on signatures made by the same options"
    ):
        nearest(catalogue, "00", options=chosen)
    for content in (b"", b"PK no archive", b"words"):
        metric.write_bytes(content)
        with pytest.raises(
            InputError, match="a whitening must be a name such as auto, or a file"
        ):
            nearest(catalogue, "00", options=chosen)


@pytest.mark.slow
def test_atoms_of_labelled_scans_are_used_in_another_catalogue(
    catalogue: Path, folder: Path, tmp_path: Path
) -> None:
    """They travel within the settings: to worker processes, and in the catalogue, without the file."""
    file, other, egg = (
        tmp_path / "atoms.toml",
        tmp_path / "other.sqlite",
        folder / "stored" / "11.off",
    )
    shipped = {"signature": {"method": "dl-supervised"}}
    assert result(
        "lab", "calibrate", "-c", catalogue, "--method", "dl-supervised", "-o", file
    )["config"]
    learnt = pr.calibrate(catalogue, tmp_path / "again.toml", options=shipped)
    assert (tmp_path / "again.toml").read_bytes() == file.read_bytes()
    assert pr.PipelineOptions.of(file) == learnt
    pr.ingest(folder / "new", other, options=file, workers=2)
    with pr.Catalogue(catalogue) as store:
        stored = pr.stored_signature(
            store, "11", options=pr.PipelineOptions.of(file, store.options)
        ).values
        plain = pr.stored_signature(
            store, "11", options=pr.PipelineOptions.of(shipped, store.options)
        ).values
    assert result("lab", "signature", "--config", file, egg)[0][
        "values"
    ] == pytest.approx(stored, abs=1e-9)
    assert np.abs(stored - plain).max() > 1e-3
    content = file.read_text()
    file.unlink()
    with pytest.raises(OptionError, match=r"cannot read the options file .*atoms.toml"):
        pr.signature(egg, file)
    assert len(result("query", egg, "-c", other)[0]["neighbors"]) == 2
    # Signatures of two dictionaries are not compared.
    with pytest.raises(
        CatalogueError,
        match=r"built with other options: .*signature.atoms: \(\(.* there, None",
    ):
        pr.ingest(folder / "stored", other, options=shipped)
    with pytest.raises(
        InputError, match="must be made by the same method and options as the table"
    ):
        nearest(other, pr.signature(egg, shipped))
    for bad, message in (
        (
            content.replace("atoms = [[", "atoms = [[nan, "),
            r"atoms.0.0: input should be a finite number",
        ),
        (
            content.replace("atoms = [[", "atoms = [[0.1, "),
            r"atoms.0: tuple should have at most 19 items",
        ),
        (
            content.replace("atoms = [[", "atoms = 1 #"),
            r"atoms: input should be a valid tuple, got 1",
        ),
    ):
        file.write_text(bad)
        with pytest.raises(
            OptionError, match=rf"atoms.toml: in \[signature\], {message}"
        ):
            nearest(catalogue, "11", options=file)


@pytest.mark.slow
def test_what_atoms_cannot_be_learned_from(folder: Path, tmp_path: Path) -> None:
    shipped, eggs = {"signature": {"method": "dl-supervised"}}, ["00", "01", "10", "11"]
    bare, labels = tmp_path / "bare.sqlite", {name: f"kind{name[0]}" for name in eggs}
    files = [folder / "stored" / f"{name}.off" for name in eggs]
    pr.ingest(files, bare, options={"catalogue": {"keep": []}}, labels=labels)
    with pytest.raises(
        ShapeError, match=r"^\[00 / signature\] gone: the shape must hold its mesh"
    ):
        pr.calibrate(bare, tmp_path / "atoms.toml", options=shipped)
    with pr.Catalogue(bare) as store:
        store.remove("00")
        with pytest.raises(InputError, match="two classes of two shapes or more, got 1"):
            pr.calibrate(store, tmp_path / "atoms.toml", options=shipped)


def test_signatures_are_exported(catalogue: Path, tmp_path: Path) -> None:
    with pr.Catalogue(catalogue) as store:
        wanted = pr.signatures(store).select(["11", "00"])
    for suffix in (".npz", ".parquet", ".csv"):
        path = tmp_path / f"bodies{suffix}"
        run(
            "catalogue", "export", "--signatures", "-c", catalogue, "-o", path, "11", "00"
        )
        if suffix == ".npz":
            with np.load(path, allow_pickle=False) as file:
                ids, labels, values = (
                    file["ids"].tolist(),
                    file["labels"].tolist(),
                    file["values"],
                )
                assert str(file["kind"]) == "hapt+r-bihdm"
        elif suffix == ".parquet":
            pandas = pytest.importorskip("pandas")
            frame = pandas.read_parquet(path)
            ids, labels, values = (
                frame["id"].tolist(),
                frame["label"].tolist(),
                frame.iloc[:, 2:].to_numpy(),
            )
        else:
            with path.open(newline="", encoding="utf-8") as text:
                header, *rows = csv.reader(text)
            assert header[:3] == ["id", "label", "v1"]
            ids, labels = [row[0] for row in rows], [row[1] for row in rows]
            values = np.array([row[2:] for row in rows], dtype=float)
        assert (ids, labels) == (["11", "00"], ["kind1", "kind0"])
        np.testing.assert_array_equal(values, wanted.values)
    with pytest.raises(
        InputError, match=r"must end in one of \.npz \.parquet \.csv, got bodies\.txt"
    ):
        pr.write_signatures(wanted, tmp_path / "bodies.txt")
    with pytest.raises(InputError, match="there is no signature of the shape 'cat'"):
        wanted.select(["cat"])


def test_a_collection_of_one_scan_each_names_people_and_strangers(tmp_path: Path) -> None:
    """As every studio starts: no two scans are of one person, so that simulated people say what is near."""
    stored = {"person-1": "person-1_stand", "person-2": "person-2_wave"}
    paths = [SCANS / label / f"{scan}.ply" for label, scan in stored.items()]
    labels = {scan: label for label, scan in stored.items()}
    pr.ingest(paths, tmp_path / "one.sqlite", labels=labels, workers=1)
    known = pr.search(tmp_path / "one.sqlite", SCANS / "person-1" / "person-1_walk.ply")
    assert (known.verdict, known.label) == ("sure", "person-1")
    stranger = pr.search(
        tmp_path / "one.sqlite", SCANS / "person-3" / "person-3_kick.ply"
    )
    assert stranger.verdict == "stranger"
    assert known.neighbors.scores is not None and stranger.neighbors.scores is not None
    assert known.neighbors.scores[0] > 0.8 > stranger.neighbors.scores[0]
    itself = pr.search(tmp_path / "one.sqlite", "person-1_stand")
    assert (itself.verdict, itself.because) == (
        "unknown",
        "it is the only scan of person-1",
    )
