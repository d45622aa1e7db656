"""What is named on the command line, and which scans that means."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from pcretrieve.errors import InputError, ScanReadError
from pcretrieve.formats import ScanPath
from pcretrieve.formats.identity import content_hash
from pcretrieve.ingestion.discover import discover

# The user without rights, on Linux.
NOBODY = 65534

FILES = (
    *("a.ply", "b.OBJ", "deep/c.xyz", "deep/er/d.off"),
    *("notes.md", "labels.csv", ".hidden.ply", "deep/._a.ply"),
)
SCANS = ["a.ply", "b.OBJ", "deep/c.xyz", "deep/er/d.off"]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in FILES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(f"1 2 3 # {name}\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def names(*arguments: str | Path) -> list[str]:
    return [os.path.relpath(str(scan)) for scan in discover(arguments)]


def test_files_folders_and_globs(folder: Path) -> None:
    assert names("a.ply", "deep/c.xyz") == ["a.ply", "deep/c.xyz"]
    assert names(".") == names("*") == SCANS
    assert names("**/*.[oO]*") == ["b.OBJ", "deep/er/d.off"]
    # Each once, by one name.
    assert names("deep", "a.ply", "deep/c.xyz", "a.ply") == [
        "deep/c.xyz",
        "deep/er/d.off",
        "a.ply",
    ]
    assert names("deep/../deep/./c.xyz", "deep/c.xyz") == ["deep/c.xyz"]
    assert names("notes.md") == [
        "notes.md"
    ]  # named outright: reading it will say that it is no scan


def test_numbers_in_names_are_in_the_order_of_numbers(tmp_path: Path) -> None:
    """As frames of a camera that counts without leading zeros; folders come before what is beside them."""
    expected = [
        "a/frame_1.ply",
        "a/frame_2.ply",
        "a/frame_10.ply",
        "a2/1.ply",
        "a10/1.ply",
    ]
    for name in expected:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("1 2 3\n")
    for argument in (tmp_path, tmp_path / "a*" / "*.ply"):
        found = [
            scan.file.relative_to(tmp_path).as_posix() for scan in discover([argument])
        ]
        assert found == expected


def test_a_name_with_a_mistake_is_answered_by_the_right_one(folder: Path) -> None:
    with pytest.raises(
        InputError, match=r"no file or folder deep/c\.xzy; did you mean 'c\.xyz'"
    ):
        discover(["deep/c.xzy"])
    with pytest.raises(InputError, match="no file or folder depe; did you mean 'deep'"):
        discover(["depe"])


def test_paths_in_a_manifest_are_relative_to_its_folder(folder: Path) -> None:
    """Also one that is missing: that is this shape's failure, not the batch's."""
    for manifest, text in (
        ("list.txt", "# mine\n../a.ply\n\nc.xyz\ngone.ply\n"),
        ("list.csv", "class,File\ncat,../a.ply\ncat, c.xyz\ndog,\ndog,gone.ply\n"),
        (
            "list.csv",
            "\ufeffpath\r\n../a.ply\r\nc.xyz\r\ngone.ply\r\n",
        ),  # from a spreadsheet
    ):
        (folder / "deep" / manifest).write_text(text, encoding="utf-8", newline="")
        assert names(f"deep/{manifest}") == ["a.ply", "deep/c.xyz", "deep/gone.ply"]


def test_a_manifest_may_name_what_no_file_can_be_named(folder: Path) -> None:
    (folder / "list.txt").write_text("a\0.ply\na\0.csv\na\0.ptx\na\0.gltf\na.ply")
    assert names("list.txt") == ["a\0.ply", "a\0.csv", "a\0.ptx", "a\0.gltf", "a.ply"]


def test_a_folder_says_what_it_leaves_unread(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for name in (
        "1.fbx",
        "deep/2.FBX",
        "deep/er/3.step",
        "a.jpg",
        "b.jpg",
        "c.jpg",
        "LICENSE",
    ):
        (folder / name).write_text("1 2 3\n")
    (folder / "scan.ply.gz").write_bytes(b"\x1f\x8b")
    assert names(".") == SCANS
    assert caplog.messages == [
        "left unread in .: 2 .fbx (export it as .glb), 1 .gz (unpack it first), 1 .step (export it as .stl), "
        "3 .jpg, 1 .csv, 1 .md, 1 without a suffix"
    ]


def test_views_belong_to_their_conf(folder: Path) -> None:
    (folder / "both.conf").write_text(
        "bmesh a.ply 0 0 0 0 0 0 1\nbmesh deep/../deep/c.xyz 0 0 0 0 0 0 1\n"
    )
    (folder / "broken.conf").write_text("bmesh b.OBJ\n")
    assert names(".") == ["b.OBJ", "both.conf", "broken.conf", "deep/er/d.off"]


def test_what_means_no_scans(folder: Path) -> None:
    (folder / "hollow").mkdir()
    for name, content in (
        ("column.csv", b"cat,dog\n1,2\n"),
        ("hollow.txt", b"# nothing\n\n"),
        ("hollow.csv", b""),
        ("bytes.txt", b"\xff\xfe\x00"),
        ("long.csv", b"file\n" + b"x" * 200_000),
    ):
        (folder / name).write_bytes(content)
    os.mkfifo(folder / "pipe.txt")
    (folder / "endless.csv").symlink_to("/dev/zero")
    for argument, words in {
        "": "a path must not be empty",
        "nowhere": "there is no file or folder nowhere",
        "none*.ply": r"none\*\.ply names no scans; known are \.3mf",
        "hollow": r"hollow names no scans",
        "x" * 300: "File name too long",
        "column.csv": r"column\.csv must have a header with one of path, file, .* got cat, dog",
        "hollow.txt": r"hollow\.txt names no scans",
        "hollow.csv": r"hollow\.csv must have a header .* got nothing",
        "bytes.txt": r"cannot read the manifest bytes\.txt",
        "long.csv": r"long\.csv is not a CSV file \(field larger than field limit",
        "pipe.txt": "pipe.txt must be a regular file",
        "endless.csv": "endless.csv must be a regular file",
    }.items():
        with pytest.raises(InputError, match=words):
            discover([argument])


@pytest.fixture
def locked(folder: Path) -> Iterator[Path]:
    """A subfolder that may not be read, also where root runs the tests."""
    user = os.geteuid()
    folder.chmod(0o755)
    (folder / "deep" / "er").chmod(0)
    if user == 0:
        os.seteuid(NOBODY)
    yield folder / "deep" / "er"
    os.seteuid(user)
    (folder / "deep" / "er").chmod(0o755)


def test_a_folder_that_may_not_be_read_is_named(
    locked: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert names(".") == ["a.ply", "b.OBJ", "deep/c.xyz"]
    with pytest.raises(InputError, match=r"cannot look into deep/er: Permission denied"):
        discover(["deep/er"])
    assert caplog.messages == [
        "skipped the folder deep/er and all scans in it: Permission denied",
        "left unread in .: 1 .csv, 1 .md",
    ]


# --- identity -------------------------------------------------------------------------------------------


def test_content_that_cannot_be_had(folder: Path) -> None:
    (folder / "empty.ply").touch()
    os.mkfifo(folder / "pipe.conf")
    (folder / "link.conf").symlink_to("nowhere")
    (folder / "endless.ply").symlink_to("/dev/zero")
    (folder / "alias.ply").symlink_to("a.ply")
    for conf, views in (
        ("lost", ["gone.ply"]),
        ("device", ["a.ply", "endless.ply"]),
        ("again", ["a.ply", "b.OBJ", "deep/../a.ply"]),
        ("linked", ["a.ply", "alias.ply"]),
        ("many", [f"{k}.ply" for k in range(1001)]),
    ):
        (folder / f"{conf}.conf").write_text(
            "".join(f"bmesh {view} 0 0 0 0 0 0 1\n" for view in views)
        )
    (folder / "long.conf").write_bytes(b"#" * 4_096_001)
    for name, words in (
        ("gone.ply", r"cannot read .*gone\.ply: No such file"),
        ("empty.ply", r"empty\.ply: the file is empty"),
        ("deep", r"deep is a folder, not a scan"),
        ("zero\0.ply", "embedded null byte"),
        ("lost.conf", r"cannot read .*gone\.ply"),
        ("link.conf", r"cannot read .*link\.conf"),
        ("pipe.conf", r"pipe\.conf must be a regular file"),
        ("device.conf", r"endless\.ply must be a regular file"),
        (
            "again.conf",
            r"again\.conf: each view must be named once, lines 1 and 3 name deep/\.\./a\.ply",
        ),
        (
            "linked.conf",
            r"linked\.conf: each view must be named once, lines 1 and 2 name alias\.ply",
        ),
        (
            "many.conf",
            r"many\.conf: a file must hold at most 1000 scans, views or arrays, this one has 1001",
        ),
        ("long.conf", r"long\.conf: a \.conf file must have at most 4096000 bytes"),
    ):
        with pytest.raises(ScanReadError, match=words):
            content_hash(ScanPath.parse(folder / name))
