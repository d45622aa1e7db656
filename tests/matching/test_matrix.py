"""Distance matrices: what they refuse, how they rank, and their files."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcretrieve.errors import BenchmarkError, InputError
from pcretrieve.evaluation import evaluate, rank_gallery
from pcretrieve.matching import DistanceMatrix, read_matrix, write_matrix
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval import DISTANCES, DistanceBlock, SignatureIndex
from pcretrieve.values import SignatureTable

# Not symmetric: from d all others are equally far.
VALUES = np.array([[0, 1, 2, 9], [1.5, 0, 1, 9], [2, 1, 0, 9], [4, 4, 4, 0]])
MATRIX = DistanceMatrix(("a", "c", "b", "d"), VALUES)


def a_table(n: int = 40) -> SignatureTable:
    rng = np.random.default_rng(0)
    values = rng.lognormal(size=(n, 6))
    values[-5:] = values[:5]  # equally far
    ids = tuple(f"T{number}" for number in rng.permutation(n))
    return SignatureTable(ids, values, "r-bihdm", "3f2a", tuple("ABCD"[number % 4] for number in range(n)))


def test_what_is_no_distance_matrix() -> None:
    arguments: Any
    for arguments, message in (
        ((("a", "b"), np.zeros((2, 3))), "a distance matrix must have shape (2, 2), got (2, 3)"),
        ((("a", "b"), [[0, np.nan], [0, 0]]), "must be numbers, got 1 values that are NaN"),
        ((("a", "b"), [[0, -1.0], [-2, 0]]), "distances must be 0 or more, got 2 that are negative"),
        ((("a", "b", "a"), np.zeros((3, 3))), "ids of a distance matrix must be distinct, 'a' comes twice"),
        ((("a", "b"), np.zeros((2, 2)), ("A",)), "labels must be as many as ids (2), got 1"),
    ):
        with pytest.raises(InputError, match=re.escape(message)):
            DistanceMatrix(*arguments)


def test_the_matrix_of_an_index_ranks_as_the_index_does() -> None:
    table = a_table()
    label_of = dict(zip(table.ids, table.labels, strict=True))
    for distance in DISTANCES:
        index = SignatureIndex(table, RetrievalOptions(distance=distance, whitening="pca"))
        matrix = DistanceMatrix(tuple(index.ids), index.between(index.ids))
        for shape_id in table.ids:
            assert matrix.nearest(shape_id, 7) == index.nearest(shape_id, 7)
        labels = tuple(label_of[shape_id] for shape_id in index.ids)
        block = DistanceBlock(np.arange(len(matrix)), matrix.values)
        ranked = rank_gallery(index.blocks(), matrix.ids, labels)
        assert rank_gallery([block], matrix.ids, labels) == ranked


def test_a_file_restores_every_bit(tmp_path: Path) -> None:
    index = SignatureIndex(a_table())
    matrix = DistanceMatrix(tuple(index.ids), index.between(index.ids))
    for number, name in enumerate(("run.txt", "run.npy", "run")):
        folder = tmp_path / str(number)
        folder.mkdir()
        write_matrix(matrix, folder / name)
        assert read_matrix(folder / name) == matrix
        assert (folder / "run.ids").read_text().split() == list(matrix.ids)
        assert {path.name for path in folder.iterdir()} == {name, "run.ids"}


def test_a_matrix_of_a_track_is_plain_rows_of_numbers(tmp_path: Path) -> None:
    (tmp_path / "run.txt").write_text("0 1 2 9\n1.5 0 1 9\n  2\t1 0 9e0 \n4 4 4 0")
    (tmp_path / "run.ids").write_text("a\r\nc\r\nb\r\nd")
    assert read_matrix(tmp_path / "run.txt") == MATRIX


def huge(path: Path) -> None:
    """A header that declares eight terabytes."""
    np.save(path, np.zeros((2, 2)))
    path.write_bytes(path.read_bytes().replace(b"(2, 2)", b"(1000000, 1000000)"))


TEXTS = (
    ("0 1\n1 0\n", None, r"cannot read .*run.ids, which must name the rows of run.txt, one id a line"),
    ("0 1\n1 0\n", "a\nb\nc\n", r"run.ids must name the 2 rows of run.txt, got 3 ids"),
    ("0 1\n1 0\n", "a\na\n", r"run.txt: ids of a distance matrix must be distinct, 'a' comes twice"),
    ("0 1 2\n1 0 2\n", "a\nb\n", r"run.txt must hold a square matrix, rows by columns, got 2 by 3"),
    ("0 1\n1 0 2\n", "a\nb\n", r"run.txt is not a distance matrix: .*columns"),
    ("0 x\n1 0\n", "a\nb\n", r"run.txt is not a distance matrix: could not convert string 'x'"),
    ("0 nan\n1 0\n", "a\nb\n", r"run.txt: a distance matrix must be numbers, got 1 values that are NaN"),
    ("0 -1\n1 0\n", "a\nb\n", r"run.txt: distances must be 0 or more, got 1 that are negative"),
    ("", "", r"run.txt must hold a square matrix"),
)
ARRAYS: tuple[tuple[Callable[[Path], object], str], ...] = (
    (lambda path: None, r"cannot read the distance matrix .*: No such file"),
    (lambda path: path.touch(), r"is not a distance matrix"),
    (lambda path: path.write_bytes(b"ply\n" * 99), r"is not a distance matrix"),
    (huge, r"is not a distance matrix"),
    (lambda path: np.save(path, np.array([[{}]]), allow_pickle=True), r"is not a distance matrix"),
    (lambda path: np.save(path, np.zeros(4)), r"must hold a square matrix, rows by columns, got 4"),
    (lambda path: np.save(path, np.zeros((2, 2)) * 1j), r"must be an array of numbers, got .*complex"),
)


def test_files_that_are_no_matrix(tmp_path: Path) -> None:
    ids = tmp_path / "run.ids"
    for text, names, message in TEXTS:
        (tmp_path / "run.txt").write_text(text)
        ids.unlink(missing_ok=True) if names is None else ids.write_text(names)
        with pytest.raises(InputError, match=message):
            read_matrix(tmp_path / "run.txt")
    ids.write_text("a\nb\n")
    for make, message in ARRAYS:
        make(tmp_path / "run.npy")
        with pytest.raises(InputError, match=message):
            read_matrix(tmp_path / "run.npy")


def test_where_a_matrix_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot write .*nowhere/run.txt: No such file"):
        write_matrix(MATRIX, tmp_path / "nowhere" / "run.txt")
    with pytest.raises(InputError, match=r"must not end in \.ids"):
        write_matrix(MATRIX, tmp_path / "run.ids")
    with pytest.raises(InputError, match=r"ids must have one line each, got 'a\\nb'"):
        write_matrix(DistanceMatrix(("a\nb",), [[0.0]]), tmp_path / "run.txt")  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


def test_labels_name_ids_or_files(tmp_path: Path) -> None:
    (tmp_path / "labels.csv").write_text("file,class\nscans/a.ply,X\nc,X\nb.off,Y\nd,Y\n")
    ranked = evaluate(MATRIX, labels=tmp_path / "labels.csv").ranked.rankings
    assert dict(zip(ranked.ids, ranked.labels, strict=True)) == {"a": "X", "c": "X", "b": "Y", "d": "Y"}
    (tmp_path / "labels.csv").write_text("file,class\na.ply,X\na.off,Y\n")
    with pytest.raises(BenchmarkError, match="a shape must have one class, 'a' has 'X' and 'Y' in "):
        evaluate(MATRIX, labels=tmp_path / "labels.csv")
