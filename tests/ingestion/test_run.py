"""Ingests of new, removed, changed and damaged files: the catalogue has each present content once."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import shapes
from processes import all_workers_ended, wait_for

from pcretrieve import Catalogue, __version__, ingest
from pcretrieve.catalogue import Record
from pcretrieve.formats import write_mesh
from pcretrieve.ingestion import plan
from pcretrieve.ingestion.discover import content_hash, discover
from pcretrieve.ingestion.run import Summary
from pcretrieve.simulation import write_ply

PATIENCE = 60  # seconds
MARK = "PCRETRIEVE_TEST_MARK"


def egg(path: Path, length: float) -> bytes:
    """A closed mesh, kept as it is, so quickly done; its bytes."""
    write_mesh(shapes.ellipsoid((1, 1, length), subdivisions=3), path)
    return path.read_bytes()


def ids(records: list[object]) -> list[str]:
    return sorted(record.id for record in records)  # type: ignore[attr-defined]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two eggs; the first one twice."""
    (tmp_path / "eggs").mkdir()
    egg(tmp_path / "eggs" / "a.off", 1.5)
    egg(tmp_path / "eggs" / "b.off", 2)
    (tmp_path / "eggs" / "copy.off").write_bytes((tmp_path / "eggs" / "a.off").read_bytes())
    return tmp_path / "eggs"


@pytest.fixture
def catalogue(tmp_path: Path) -> Iterator[Catalogue]:
    with Catalogue(tmp_path / "c.sqlite", create=True) as store:
        yield store


@pytest.fixture
def filled(folder: Path, catalogue: Catalogue) -> Catalogue:
    ingest(folder, catalogue, labels={"a": "short", "b": "long"})
    return catalogue


def test_rows_state_the_version_of_the_package_that_made_them(filled: Catalogue) -> None:
    """Not that of its metadata, which a source folder on the path lacks, or has of another version."""
    assert {record.versions["pcretrieve"] for record in filled.records()} == {__version__}


def again(folder: Path, catalogue: Catalogue, **options: object) -> Summary:
    return ingest(folder, catalogue, **options)  # type: ignore[arg-type]


# --- files that stay, change, move ----------------------------------------------------------------------


def test_one_content_is_processed_once(folder: Path, catalogue: Catalogue) -> None:
    seen: list[str] = []
    first = ingest(folder, catalogue, on_shape=lambda record: seen.append(record.id))
    assert ids([*first.done]) == ["a", "b"]
    assert [(path.name, original.id) for path, original in first.duplicates] == [("copy.off", "a")]
    second = again(folder, catalogue)
    assert (ids([*second.held]), second.done, len(second.duplicates)) == (["a", "b"], [], 1)
    assert sorted(seen) == ["a", "a", "b"]  # once for each file


def test_under_another_suffix_the_same_bytes_are_another_scan(tmp_path: Path, catalogue: Catalogue) -> None:
    """Or a broken file could keep a good one out."""
    content = egg(tmp_path / "z.off", 2)
    (tmp_path / "a.ply").write_bytes(content)
    summary = ingest(discover([tmp_path / "a.ply", tmp_path / "z.off"]), catalogue)
    assert (ids([*summary.failed]), ids([*summary.done])) == (["a"], ["z"])


def test_a_file_that_changed_is_processed_again(folder: Path, filled: Catalogue) -> None:
    """A duplicate of the old content of the file is then processed."""
    before = filled.signatures()
    egg(folder / "a.off", 3)
    summary = again(folder, filled)
    assert (ids([*summary.done]), ids([*summary.held]), summary.duplicates) == (["a", "copy"], ["b"], [])
    after = filled.signatures()
    assert after.ids == ("a", "b", "copy")
    np.testing.assert_array_equal(after.values[2], before.values[0])
    assert not np.allclose(after.values[0], before.values[0])
    assert filled.record("a").label == "short"


def test_files_that_swap_their_names_swap_their_signatures(folder: Path, filled: Catalogue) -> None:
    before = filled.signatures().values
    (folder / "a.off").rename(folder / "x")
    (folder / "b.off").rename(folder / "a.off")
    (folder / "x").rename(folder / "b.off")
    (folder / "copy.off").unlink()
    again(folder, filled)
    np.testing.assert_array_equal(filled.signatures().values, before[::-1])


def test_a_file_that_becomes_a_copy_leaves_the_catalogue(folder: Path, filled: Catalogue) -> None:
    (folder / "b.off").write_bytes((folder / "a.off").read_bytes())
    summary = again(folder, filled)
    assert (summary.done, ids([*summary.held]), len(summary.duplicates)) == ([], ["a"], 2)
    assert filled.signatures().ids == ("a",)


def test_a_folder_that_moves_takes_its_shapes_along(folder: Path, filled: Catalogue) -> None:
    before = filled.record("b")
    moved = folder.rename(folder.parent / "nest")
    summary = again(moved, filled)
    assert (summary.done, ids([*summary.held])) == ([], ["a", "b"])
    after = filled.record("b")
    assert after.path == str(moved / "b.off")
    assert (after.added, after.label) == (before.added, "long")


def test_labels_reach_shapes_that_are_held_already(folder: Path, filled: Catalogue) -> None:
    summary = again(folder, filled, labels={"a.off": "small", "nobody": "small"})
    assert [record.label for record in filled.records()] == ["small", "long"]
    assert summary.unknown_labels == ["nobody"]
    # An id stands for its shape still where the file has another name by now.
    (folder / "b.off").rename(folder / "c.off")
    summary = again(folder, filled, labels={"b": "large", "nobody": "small"})
    assert filled.record("b").label == "large"
    assert summary.unknown_labels == ["nobody"]


def test_a_failure_is_stored_until_it_is_retried(folder: Path, filled: Catalogue) -> None:
    (folder / "flat.xyz").write_text("1 2 3\n" * 200)
    assert ids([*again(folder, filled).failed]) == ["flat"]
    remembered = again(folder, filled)
    assert (remembered.failed, "flat" in ids([*remembered.held])) == ([], True)
    assert ids([*again(folder, filled, retry_failed=True).failed]) == ["flat"]
    (folder / "flat.xyz").unlink()
    assert ids([*again(folder, filled).held]) == ["a", "b"]


def test_a_file_out_of_reach_keeps_what_was_made_of_it(folder: Path, filled: Catalogue) -> None:
    """Its copy stays a copy, and the next run that reaches the file finds all as it was."""
    before, signatures = filled.records(), filled.signatures().values
    content = (folder / "a.off").read_bytes()
    (folder / "a.off").unlink()
    (folder / "a.off").symlink_to("away")
    (folder / "b.off").write_bytes((folder / "b.off").read_bytes()[:1000])  # half copied
    summary = again(folder, filled)
    assert ids([*summary.failed]) == ["a", "b"]
    for record in summary.failed:
        assert "; the catalogue keeps what was made of this file on" in str(record.message)
    assert [path.name for path, _ in summary.duplicates] == ["copy.off"]
    assert filled.records() == before
    np.testing.assert_array_equal(filled.signatures().values, signatures)
    (folder / "a.off").unlink()
    (folder / "a.off").write_bytes(content)
    assert ids([*again(folder, filled).held]) == ["a"]


def test_files_cut_off_to_the_same_content_keep_what_was_made_of_them(
    folder: Path, filled: Catalogue
) -> None:
    """The second of them is a copy of the first, but the first one's content is no scan."""
    before = filled.records()
    for name in ("a", "b"):
        (folder / f"{name}.off").write_text("OFF\n")
    summary = again(folder, filled)
    assert (ids([*summary.failed]), [path.name for path, _ in summary.duplicates]) == (["a"], ["b.off"])
    assert [record for record in filled.records() if record.id != "copy"] == before


def test_files_are_read_as_their_turn_comes(
    tmp_path: Path, catalogue: Catalogue, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Work begins before the last file is hashed: a file that changes until then is taken as it is then."""
    monkeypatch.setattr(plan, "FILES_AT_ONCE", 2)
    paths = [tmp_path / f"{number}.off" for number in range(8)]
    for number, path in enumerate(paths):
        egg(path, 1.5 + number / 8)
    seen: list[str] = []

    def change_the_last(record: Record) -> None:
        if not seen:
            egg(paths[-1], 3)
        seen.append(record.id)

    summary = ingest(paths, catalogue, on_shape=change_the_last)
    assert len(summary.done) == len(seen) == len(paths)
    assert catalogue.record("7").content_hash == content_hash(paths[-1])


def test_a_copy_of_a_file_that_comes_later_is_known_by_what_that_file_holds_now(
    folder: Path, filled: Catalogue, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The copy is planned before the turn of the file whose content it was."""
    monkeypatch.setattr(plan, "FILES_AT_ONCE", 1)
    (folder / "0.off").write_bytes((folder / "a.off").read_bytes())
    (folder / "1.off").write_bytes((folder / "b.off").read_bytes())
    (folder / "copy.off").unlink()
    egg(folder / "a.off", 3)
    summary = again(folder, filled)
    assert ids([*summary.done]) == ["0", "a"]
    assert [(path.name, original.id) for path, original in summary.duplicates] == [("1.off", "b")]


# --- several ingests at once ----------------------------------------------------------------------------


def test_an_ingest_within_another_takes_none_of_its_ids(folder: Path, catalogue: Catalogue) -> None:
    """Another folder is stored between the plan and the first shape of this one."""
    other = folder.parent / "other"
    other.mkdir()
    for number, name in enumerate(("a", "b")):
        egg(other / f"{name}.off", 3 + number)
    plan_made = False

    def interfere(record: object) -> None:
        nonlocal plan_made
        if not plan_made:
            plan_made = True
            assert len(again(other, catalogue).done) == 2

    summary = again(folder, catalogue, on_shape=interfere)
    assert len(summary.done) == 2
    records = catalogue.records()
    assert [record.id for record in records] == ["a", "a-2", "b", "b-2"]
    assert {record.path for record in records} == {
        *(str(other / f"{name}.off") for name in "ab"),
        *(str(folder / f"{name}.off") for name in "ab"),
    }


@pytest.mark.parametrize("same", [False, True], ids=["other files of the same names", "the same files"])
def test_two_processes_that_ingest_at_once_store_every_shape_once(
    same: bool, new_location: str, tmp_path: Path
) -> None:
    folders = [tmp_path / name for name in ("one", "two")]
    for start, folder in enumerate(folders):
        folder.mkdir()
        for number in range(4):
            egg(folder / f"{number}.off", 1 + (start + 2 * number) / 8)
    command = [sys.executable, "-m", "pcretrieve", "ingest", "-c", new_location, "--workers", "1", "--json"]
    running = [
        subprocess.Popen(
            [*command, str(folders[0] if same else folder)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        for folder in folders
    ]
    for process in running:
        said, errors = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, errors.decode()
        answer = json.loads(said)["result"]
        assert len(answer["done"]) + len(answer["held"]) == 4
    with Catalogue(new_location) as catalogue:
        records = catalogue.records()
        assert len(catalogue.signatures().ids) == len(records)
    expected = folders[:1] if same else folders
    assert sorted(record.path for record in records) == sorted(
        str(folder / f"{number}.off") for folder in expected for number in range(4)
    )


# --- shapes that hang, die, fill the memory -----------------------------------------------------------

VICIOUS = """
import ctypes, os, signal, sys, time
import numpy as np
from pcretrieve.errors import InputError, ScanReadError

def read(path):
    return DEEDS[path.stem]()

def hang():
    time.sleep(1000)

def die():
    os.kill(os.getpid(), signal.SIGKILL)

def leave():
    os._exit(7)

def fill_the_memory():
    return np.ones(1 << 29)

def divide():
    return 1 / 0

def leave_in_peace():
    sys.exit(0)

def interrupt():
    raise KeyboardInterrupt

def refuse():
    raise InputError("no such thing")

class Odd(ScanReadError):  # fit for pickling, but not for unpickling
    def __init__(self):
        super().__init__("odd")

def be_odd():
    raise Odd

def crash():
    os.write(2, b"double \\033[31mfree\\n\\n")
    ctypes.string_at(0)

def flood():
    while True:
        os.write(1, b"water " * 10_000)

def shout():
    print("from Python")
    os.write(1, b"from elsewhere")
    raise ScanReadError("hoarse")

DEEDS = {name: deed for name, deed in globals().items() if callable(deed)}
"""

CAUSES = {
    "hang": ("StageTimeout", "worker", "not finished within 5 s: raise --timeout"),
    "die": ("WorkerDied", "worker", "ended with SIGKILL"),
    "leave": ("WorkerDied", "worker", "ended with exit code 7"),
    "crash": ("WorkerDied", "worker", "ended with SIGSEGV"),
    "flood": ("StageTimeout", "worker", "before this it printed: "),
    "fill_the_memory": ("MemoryExceeded", "read", "raise that, or thin the scan"),
    "leave_in_peace": ("ScanReadError", "read", "SystemExit: 0"),
    "interrupt": ("UnexpectedError", "read", "KeyboardInterrupt: "),
    "refuse": ("ScanReadError", "read", "no such thing"),
    "be_odd": ("ScanReadError", "read", "odd"),
    "shout": ("ScanReadError", "read", "hoarse"),
    "divide": (
        "ScanReadError",
        "read",
        "of the package vicious failed, ZeroDivisionError: division by zero",
    ),
}


@pytest.fixture
def vicious(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An installed reader of .vicious files, which does to its process what the file's name says."""
    site = tmp_path / "site"
    (site / "vicious-1.0.dist-info").mkdir(parents=True)
    (site / "vicious-1.0.dist-info" / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: vicious\nVersion: 1\n"
    )
    (site / "vicious-1.0.dist-info" / "entry_points.txt").write_text(
        "[pcretrieve.readers]\n.vicious = vicious:read\n"
    )
    (site / "vicious.py").write_text(VICIOUS)
    monkeypatch.syspath_prepend(site)


@pytest.mark.usefixtures("vicious")
def test_one_shape_takes_no_other_with_it(folder: Path, catalogue: Catalogue) -> None:
    for deed in CAUSES:
        (folder / f"{deed}.vicious").write_text(deed)
    summary = again(folder, catalogue, workers=2, timeout=5, memory=1)
    assert ids([*summary.done]) == ["a", "b"]
    failed = {record.id: record for record in summary.failed}
    assert failed.keys() == CAUSES.keys()
    for deed, (error, stage, words) in CAUSES.items():
        assert (failed[deed].error, failed[deed].stage) == (error, stage)
        assert words in str(failed[deed].message)
    assert str(failed["crash"].message).endswith("; before this it printed: double [31mfree")
    assert "water water" in str(failed["flood"].message)
    assert len(str(failed["flood"].message)) < 1500
    assert all_workers_ended()


@pytest.mark.usefixtures("vicious")
def test_json_is_all_that_standard_output_gets(folder: Path, tmp_path: Path) -> None:
    """Also if readers print, and if names of duplicates are not UTF-8."""
    (folder / "shout.vicious").write_text("shout")
    odd = Path(os.fsdecode(os.fsencode(folder) + b"/latin-\xe9.off"))
    odd.write_bytes((folder / "b.off").read_bytes())
    command = [sys.executable, "-m", "pcretrieve", "ingest", folder, "-c", tmp_path / "c.sqlite", "--json"]
    path = os.pathsep.join([str(tmp_path / "site"), *filter(None, [os.environ.get("PYTHONPATH")])])
    ended = subprocess.run(
        [*map(str, command), "--log-file", str(tmp_path / "log")],
        capture_output=True,
        check=False,
        env=os.environ | {"PYTHONPATH": path},
    )
    assert ended.returncode == 3
    answer = json.loads(ended.stdout)["result"]
    assert [failure["message"].split(": ")[-1] for failure in answer["failed"]] == ["hoarse"]
    assert {Path(copy["path"]).name for copy in answer["duplicates"]} == {"copy.off", "latin-\\xe9.off"}
    # What the reader of a scan prints is in the log, with the name of the scan.
    (line,) = [line for line in (tmp_path / "log").read_text().splitlines() if "printed" in line]
    assert "shout.vicious: its libraries printed: " in line
    for words in ("from Python", "from elsewhere"):
        assert words in line
        assert words.encode() not in ended.stderr


def test_an_interrupt_keeps_what_is_stored_and_ends_the_workers(folder: Path, catalogue: Catalogue) -> None:
    def interrupt(record: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        again(folder, catalogue, on_shape=interrupt)
    assert all_workers_ended()
    assert len(again(folder, catalogue).held) <= 1  # the copy was told of first, perhaps
    assert catalogue.signatures().ids == ("a", "b")


# --- processes ------------------------------------------------------------------------------------------


def marked(value: str) -> list[int]:
    """Processes that were started with this mark in their environment."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            environment = (process / "environ").read_bytes()
            is_over = (process / "stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
        except OSError:
            continue  # it has ended
        if f"{MARK}={value}".encode() in environment and not is_over:
            found.append(int(process.name))
    return found


def runs_tetwild(pid: int) -> bool:
    try:
        return b"tetwild" in Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="needs /proc to see other processes")
@pytest.mark.parametrize(
    ("send", "code"),
    [
        (lambda pid: os.killpg(pid, signal.SIGINT), 130),  # Ctrl-C reaches every process of the terminal
        (lambda pid: os.kill(pid, signal.SIGTERM), 143),
        (lambda pid: os.kill(pid, signal.SIGKILL), -signal.SIGKILL),
    ],
    ids=["Ctrl-C", "SIGTERM", "SIGKILL"],
)
def test_no_process_outlives_an_ingest(send: Callable[[int], None], code: int, tmp_path: Path) -> None:
    for number in range(4):
        write_ply(tmp_path / f"{number}.ply", shapes.points_on(shapes.body(3), 3000, seed=number))
    (tmp_path / "options.toml").write_text("[remesh]\nmethod = 'tetwild'\n")
    command = [sys.executable, "-m", "pcretrieve", "ingest", tmp_path, "-c", tmp_path / "c.sqlite"]
    with subprocess.Popen(
        [*map(str, command), "--workers", "2", "--config", str(tmp_path / "options.toml")],
        env=os.environ | {MARK: str(tmp_path)},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as running:
        assert wait_for(lambda: any(runs_tetwild(pid) for pid in marked(str(tmp_path))))
        send(running.pid)
        _, said = running.communicate(timeout=PATIENCE)
    assert running.returncode == code
    # A worker that is still starting may find the pool gone, and say so from within multiprocessing.
    assert "pcretrieve/" not in said.replace(str(tmp_path), "")
    if code > 0:
        assert "the same command goes on from there" in said
    assert wait_for(lambda: not marked(str(tmp_path)))
