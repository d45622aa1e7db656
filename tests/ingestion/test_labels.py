"""Label files, and which shape each of their names stands for."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcretrieve.errors import BenchmarkError
from pcretrieve.ingestion.labels import match_labels, read_labels

CLA = "PSB 1\n2 3\n\ncat 0 2\n5\n12\n\ndog 0 1\n7\n"


@pytest.mark.parametrize(
    ("name", "text", "labels"),
    [
        ("a.csv", "file,class\na.ply,cat\nb.ply,dog\n", {"a.ply": "cat", "b.ply": "dog"}),
        ("a.csv", "\ufeffClass;x,Path \r\n", None),
        ("a.csv", "\ufeffLabel, Name ,x\r\ncat,a.ply,1\r\n", {"a.ply": "cat"}),
        ("a.csv", 'id,category\n" a ","Katze, groß"\nb,\n,c\n\nd\n', {"a": "Katze, groß"}),
        ("a.csv", "file,class\na,cat\na,cat\n", {"a": "cat"}),
        ("a.csv", "file;class;kg\r\na.ply;cat, grey;3,5\r\n", {"a.ply": "cat, grey"}),
        ("a.cla", CLA, {"5": "cat", "12": "cat", "7": "dog"}),
        ("a.cla", "PSB 1\n3 1\n\nanimal 0 0\n\ncat animal 1\n5\n\nempty 0 0\n", {"5": "cat"}),
    ],
)
def test_reading(name: str, text: str, labels: dict[str, str] | None, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8", newline="")
    if labels is None:
        with pytest.raises(BenchmarkError, match="must have a header with one of file, path"):
            read_labels(tmp_path / name)
    else:
        assert read_labels(tmp_path / name) == labels


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "got nothing"),
        (b"cat,dog\n1,2\n", "got cat, dog"),
        (b"file,class\na,cat\na,dog\n", r"'a' has 'cat' and 'dog' \(line 3\)"),
        (b"\x89PNG\xff", "it is not UTF-8 text"),
        (CLA.replace("cat 0 2", "cat 0 3").encode(), "not a complete .cla file"),
        (CLA.removesuffix("7\n").encode(), "class dog declares 1 models, 0 follow"),
        (CLA.replace("2 3", "2 4").encode(), "its header declares 4 models, 3 follow"),
        (CLA.replace("cat 0 2", "cat 0 x").encode(), "invalid literal"),
        (b'file,class\n"a.ply,cat\nb.ply,dog\n', r"is not a CSV file \(unexpected end of data\): close each"),
        (b"file,class\n" + b"x" * 200_000, "is not a CSV file .field larger than field limit"),
        (b"PSB", "not a complete .cla file"),
    ],
)
def test_what_cannot_be_read(content: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / "labels").write_bytes(content)
    with pytest.raises(BenchmarkError, match=words) as raised:
        read_labels(tmp_path / "labels")
    assert str(tmp_path / "labels") in raised.value.message


PATHS = {
    "stand": "/data/ann/stand.ply",
    "stand-2": "/data/bob/stand.ply",
    "T5": "/data/T5.obj",
    "T15": "/data/T15.obj",
    "Körper": "/data/über/Körper.ply",
}


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("stand", "stand"),  # an id comes before all paths that end so
        ("stand-2", "stand-2"),
        ("bob/stand.ply", "stand-2"),
        ("./bob/stand", "stand-2"),
        ("/data/ann/stand.ply", "stand"),
        ("T5.obj", "T5"),
        ("5", "T5"),  # and not T15
        ("Körper.ply", "Körper"),
    ],
)
def test_a_name_stands_for_one_shape(name: str, shape: str) -> None:
    assert match_labels({name: "x"}, PATHS) == ({shape: "x"}, [])
