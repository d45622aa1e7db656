"""Label files and layouts of published sets: the classes that they give, and to which shapes."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcretrieve.errors import BenchmarkError
from pcretrieve.ingestion.labels import labels_of, match_labels, read_labels

CLA = "PSB 1\n2 3\n\ncat 0 2\n5\n12\n\ndog 0 1\n7\n"


def test_reading(tmp_path: Path) -> None:
    for name, text, labels in (
        ("a.csv", "file,class\na.ply,cat\nb.ply,dog\n", {"a.ply": "cat", "b.ply": "dog"}),
        ("a.csv", "\ufeffLabel, Name ,x\r\ncat,a.ply,1\r\n", {"a.ply": "cat"}),
        (
            "a.csv",
            'id,category\n" a ","Katze, groß"\nb,\n,c\n\nd\n',
            {"a": "Katze, groß"},
        ),
        ("a.csv", "file,class\na,cat\na,cat\n", {"a": "cat"}),
        ("a.csv", "file;class;kg\r\na.ply;cat, grey;3,5\r\n", {"a.ply": "cat, grey"}),
        ("a.cla", CLA, {"5": "cat", "12": "cat", "7": "dog"}),
        (
            "a.cla",
            "PSB 1\n3 1\n\nanimal 0 0\n\ncat animal 1\n5\n\nempty 0 0\n",
            {"5": "cat"},
        ),
    ):
        (tmp_path / name).write_text(text, encoding="utf-8", newline="")
        assert read_labels(tmp_path / name) == labels


def test_label_files_as_spreadsheets_and_windows_write_them(tmp_path: Path) -> None:
    """Tabs, a first line that names the separator, UTF-16, a mark, and line ends of any system."""
    labels = {"ann/a.ply": "M\u00fcller", "b.ply": "dog"}
    rows = "file{0}class\r\nann/a.ply{0}M\u00fcller\r\nb.ply{0}dog\r\n"
    for text, code in (
        (rows.format("\t"), "utf-8"),
        (rows.format("\t"), "utf-16"),
        ("\ufeff" + rows.format(";"), "utf-16-be"),
        ("sep=;\r\n" + rows.format(";"), "utf-8-sig"),
        ("sep=\t\r" + rows.format("\t").replace("\r\n", "\r"), "utf-8"),
    ):
        (tmp_path / "a.csv").write_bytes(text.encode(code))
        assert read_labels(tmp_path / "a.csv") == labels, (text, code)


def test_paths_of_windows_name_scans_of_any_system() -> None:
    """The letter of a drive, and the folders of another computer, are no part of the name."""
    paths = {
        "a": "/data/ann/a.ply",
        "a-2": "/data/bob/a.ply",
        "odd\\name": "/data/odd\\name.ply",
    }
    for name, shape in (
        ("bob\\a.ply", "a-2"),
        (".\\bob\\a.ply", "a-2"),
        ("D:\\data\\bob\\a.ply", "a-2"),
        ("c:/Users/me/scans/ann/a.ply", "a"),
        ("odd\\name.ply", "odd\\name"),
    ):
        assert match_labels({name: "x"}, paths) == ({shape: "x"}, []), name
    assert match_labels({"D:\\eve\\e.ply": "x"}, paths) == ({}, ["D:\\eve\\e.ply"])


def test_what_cannot_be_read(tmp_path: Path) -> None:
    for content, words in (
        (b"cat,dog\n1,2\n", "must have a header with one of file, path, .* got cat, dog"),
        (b"file,class\na,cat\na,dog\n", r"'a' has 'cat' and 'dog'"),
        (b"file,clas\na,cat\n", "got file, clas; did you mean 'class'"),
        (b"\x89PNG\xff", "it is not UTF-8 text"),
        ("file;class\na.ply;M\u00fcller\n".encode("cp1252"), "save it as CSV UTF-8"),
        (CLA.replace("cat 0 2", "cat 0 3").encode(), "not a complete .cla file"),
        (CLA.removesuffix("7\n").encode(), "class dog declares 1 models, 0 follow"),
        (CLA.replace("2 3", "2 4").encode(), "its header declares 4 models, 3 follow"),
        (CLA.replace("cat 0 2", "cat 0 x").encode(), "invalid literal"),
        (
            b'file,class\n"a.ply,cat\nb.ply,dog\n',
            r"is not a CSV file \(unexpected end of data\): close each",
        ),
        (b"PSB", "not a complete .cla file"),
    ):
        (tmp_path / "labels").write_bytes(content)
        with pytest.raises(BenchmarkError, match=words) as raised:
            read_labels(tmp_path / "labels")
        assert str(tmp_path / "labels") in raised.value.message


def test_a_name_stands_for_one_shape() -> None:
    paths = {
        "stand": "/data/ann/stand.ply",
        "stand-2": "/data/bob/stand.ply",
        "T5": "/data/T5.obj",
        "T15": "/data/T15.obj",
        "Körper": "/data/über/Körper.ply",
    }
    for name, shape in (
        ("stand", "stand"),  # an id comes before all paths that end so
        ("stand-2", "stand-2"),
        ("bob/stand.ply", "stand-2"),
        ("./bob/stand", "stand-2"),
        ("/data/ann/stand.ply", "stand"),
        ("T5.obj", "T5"),
        ("5", "T5"),  # and not T15
        ("Körper.ply", "Körper"),
    ):
        assert match_labels({name: "x"}, paths) == ({shape: "x"}, []), name


def test_one_label_file_for_two_sets_is_refused() -> None:
    """The numbers are ids in the set that was ingested first; the other one got the next free ids."""
    paths = {
        "0": "/Real/0.obj",
        "1": "/Real/1.obj",
        "0-2": "/Synthetic/0.obj",
        "1-2": "/Synthetic/1.obj",
    }
    numbers = {"0": "ann", "1": "bob"}
    with pytest.raises(
        BenchmarkError,
        match=r"'0' stands for 2, such as /Real/0\.obj, /Synthetic/0\.obj: write",
    ):
        match_labels(numbers, paths)
    both = numbers | {"0-2": "cyd", "1-2": "dan"}
    assert match_labels(both, paths) == (both, [])


# --- layouts --------------------------------------------------------------------------------------------


def test_classes_in_names() -> None:
    for layout, path, label in (
        ("tosca", "/sets/tosca/cat10.off", "cat"),
        ("tosca", "/sets/tosca/victoria0.mat", "victoria"),
        ("faust", "/MPI-FAUST/training/scans/tr_scan_009.ply", "00"),
        ("faust", "/MPI-FAUST/training/registrations/tr_reg_090.ply", "09"),
        ("folders", "/bodies/ann/stand.ply", "ann"),
        ("folders", "/bodies/ann/parts.glb#left", "ann"),
    ):
        assert labels_of(layout, [path]) == {path: label}
    assert labels_of("tosca", ["/sets/tosca/readme.off", "/x/dog1.off"]) == {
        "/x/dog1.off": "dog"
    }
    with pytest.raises(
        BenchmarkError, match=r"no path is one of the layout faust \(published at https"
    ):
        labels_of("faust", ["/MPI-FAUST/test/scans/test_scan_000.ply"])


def write(path: Path, text: str = "") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def test_a_label_file_beside_the_scans_or_above(tmp_path: Path) -> None:
    """Two sets have one each, so that the same numbers are told apart."""
    scans: list[str] = []
    for track in ("Real", "Synthetic"):
        write(
            tmp_path / track / "test.cla",
            f"PSB 1\n2 3\n\n{track}-a 0 2\n0\n1\n\n{track}-b 0 1\n2\n",
        )
        scans += [
            str(write(tmp_path / track / "Data" / f"{number}.obj")) for number in range(3)
        ]
    found = labels_of("psb", scans)
    assert [found[path] for path in scans] == [
        *("Real-a", "Real-a", "Real-b"),
        *("Synthetic-a", "Synthetic-a", "Synthetic-b"),
    ]
    write(tmp_path / "Real" / "train.cla", "PSB 1\n0 0\n")
    with pytest.raises(
        BenchmarkError, match=r"needs one label file in .*Real, got test\.cla, train\.cla"
    ):
        labels_of("psb", scans)
