"""Distance matrices: what they refuse, and their files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcretrieve.errors import BenchmarkError, InputError
from pcretrieve.evaluation import evaluate
from pcretrieve.retrieval import DistanceMatrix, read_matrix, write_matrix

# Not symmetric: from d all others are equally far.
VALUES = np.array([[0, 1, 2, 9], [1.5, 0, 1, 9], [2, 1, 0, 9], [4, 4, 4, 0]])
MATRIX = DistanceMatrix(("a", "c", "b", "d"), VALUES)


def test_what_is_no_distance_matrix() -> None:
    with pytest.raises(
        InputError, match=r"a distance matrix must have shape \(2, 2\), got \(2, 3\)"
    ):
        DistanceMatrix(("a", "b"), np.zeros((2, 3)))
    with pytest.raises(InputError, match=r"labels must be as many as ids \(2\), got 1"):
        DistanceMatrix(("a", "b"), np.zeros((2, 2)), ("A",))


@pytest.mark.parametrize("name", ["run.txt", "run.npy", "run"])
def test_a_file_restores_every_bit(name: str, tmp_path: Path) -> None:
    matrix = DistanceMatrix(tuple("cab"), np.random.default_rng(0).lognormal(size=(3, 3)))
    write_matrix(matrix, tmp_path / name)
    assert read_matrix(tmp_path / name) == matrix
    assert (tmp_path / "run.ids").read_text().split() == list(matrix.ids)
    assert {path.name for path in tmp_path.iterdir()} == {name, "run.ids"}


def test_a_matrix_of_a_track_is_plain_rows_of_numbers(tmp_path: Path) -> None:
    (tmp_path / "run.txt").write_text("0 1 2 9\n1.5 0 1 9\n  2\t1 0 9e0 \n4 4 4 0")
    (tmp_path / "run.ids").write_text("a\r\nc\r\nb\r\nd")
    assert read_matrix(tmp_path / "run.txt") == MATRIX


TEXTS = (
    (
        "0 1\n1 0\n",
        None,
        r"cannot read .*run.ids, which must name the rows of run.txt, one id a line",
    ),
    ("0 1\n1 0\n", "a\nb\nc\n", r"run.ids must name the 2 rows of run.txt, got 3 ids"),
    (
        "0 1\n1 0\n",
        "a\na\n",
        r"run.txt: ids of a distance matrix must be distinct, 'a' comes twice",
    ),
    (
        "0 1 2\n1 0 2\n",
        "a\nb\n",
        r"run.txt must hold a square matrix, rows by columns, got 2 by 3",
    ),
    ("0 1\n1 0 2\n", "a\nb\n", r"run.txt is not a distance matrix: .*columns"),
    (
        "0 x\n1 0\n",
        "a\nb\n",
        r"run.txt is not a distance matrix: could not convert string 'x'",
    ),
    (
        "0 nan\n1 0\n",
        "a\nb\n",
        r"run.txt: a distance matrix must be numbers, got 1 values that are NaN",
    ),
    (
        "0 -1\n-2 0\n",
        "a\nb\n",
        r"run.txt: distances must be 0 or more, got 2 that are negative",
    ),
    ("", "", r"run.txt must hold a square matrix"),
)
ARRAYS = (
    (None, r"cannot read the distance matrix .*: No such file"),
    (b"", r"is not a distance matrix"),
    (b"ply\n" * 99, r"is not a distance matrix"),
    (np.array([[{}]]), r"is not a distance matrix"),
    (np.zeros(4), r"must hold a square matrix, rows by columns, got 4"),
    (np.zeros((2, 2)) * 1j, r"must be an array of numbers, got .*complex"),
)


def test_files_that_are_no_matrix(tmp_path: Path) -> None:
    ids, text_file, binary = (
        tmp_path / f"run.{suffix}" for suffix in ("ids", "txt", "npy")
    )
    for text, names, message in TEXTS:
        text_file.write_text(text)
        ids.unlink(missing_ok=True) if names is None else ids.write_text(names)
        with pytest.raises(InputError, match=message):
            read_matrix(text_file)
    ids.write_text("a\nb\n")
    for content, message in ARRAYS:
        if isinstance(content, bytes):
            binary.write_bytes(content)
        elif content is not None:
            np.save(binary, content, allow_pickle=True)
        with pytest.raises(InputError, match=message):
            read_matrix(binary)


def test_where_a_matrix_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot write .*nowhere/run.txt: No such file"):
        write_matrix(MATRIX, tmp_path / "nowhere" / "run.txt")
    with pytest.raises(InputError, match=r"must not end in \.ids"):
        write_matrix(MATRIX, tmp_path / "run.ids")
    for name in ("a\nb", "a\rb", "a\x0bb", "a\u2028b", ""):
        with pytest.raises(
            InputError, match="ids must have one line each, got "
        ) as raised:
            write_matrix(DistanceMatrix((name,), np.zeros((1, 1))), tmp_path / "run.txt")
        assert repr(name) in str(raised.value)
    assert not list(tmp_path.iterdir())


def test_labels_name_ids_or_files(tmp_path: Path) -> None:
    (tmp_path / "labels.csv").write_text("file,class\nscans/a.ply,X\nc,X\nb.off,Y\nd,Y\n")
    ranked = evaluate(MATRIX, labels=tmp_path / "labels.csv").ranked.rankings
    assert dict(zip(ranked.ids, ranked.labels, strict=True)) == {
        "a": "X",
        "c": "X",
        "b": "Y",
        "d": "Y",
    }
    (tmp_path / "labels.csv").write_text("file,class\na.ply,X\na.off,Y\n")
    with pytest.raises(
        BenchmarkError, match="a shape must have one class, 'a' has 'X' and 'Y' in "
    ):
        evaluate(MATRIX, labels=tmp_path / "labels.csv")
