"""`--json` of each command: one document with what was asked, and the result or the error."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import shapes
from click.testing import CliRunner
from commands import NAMES, program, run

from pcretrieve import __version__
from pcretrieve.cli.batches import _say_summary
from pcretrieve.cli.options import command
from pcretrieve.cli.output import Result, write_words
from pcretrieve.errors import CatalogueError
from pcretrieve.formats import write_mesh
from pcretrieve.ingestion.run import Summary
from pcretrieve.options import PipelineOptions

HEAD = ["command", "version", "arguments", "options"]
ERROR = ["error", "stage", "message", "exit_code"]

# Commands that run until they are stopped, or run other commands.
WITHOUT = {"demo", "serve", "watch"}

N_EGGS = 4


def document(*words: object, code: int | None = 0) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(run(*words, "--json", code=code).stdout)
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A catalogue of eggs of two classes, and of a file that is no scan, which failed."""
    place = tmp_path_factory.mktemp("documents")
    (place / "scans").mkdir()
    for number in range(N_EGGS):
        egg = shapes.ellipsoid((1, 1, 1.2 + 0.1 * number), subdivisions=3)
        write_mesh(egg, place / "scans" / f"e{number}.off")
    (place / "scans" / "flat.xyz").write_text("1 2 3\n" * 200)
    rows = [
        f"e{number}.off,{'small' if number < 2 else 'large'}" for number in range(N_EGGS)
    ]
    (place / "labels.csv").write_text("\n".join(["file,class", *rows]))
    words = (
        "ingest",
        place / "scans",
        "--labels",
        place / "labels.csv",
        "-c",
        place / "c.sqlite",
    )
    run(*words, "--workers", 1, "--quiet", code=3)
    return place


# The words of each command in the folder, its exit code, what its result has, and whether it has options.
ASKED: dict[str, tuple[str, int, set[str], bool]] = {
    "reconstruct": ("scans/e0.off -o body.off", 0, {"mesh", "faces", "steps"}, True),
    "lab signature": ("scans/e0.off", 0, {"path", "kind", "values"}, True),
    "inspect": (
        "scans/e0.off -o page.html --rescans 0",
        0,
        {"page", "outcome", "checks"},
        True,
    ),
    "lab report-problem": ("scans/flat.xyz -o problem.zip", 0, {"file", "failure"}, True),
    "ingest": (
        "scans -c new.sqlite --workers 1 --quiet",
        3,
        {"done", "failed", "held"},
        True,
    ),
    "status": ("-c c.sqlite", 0, {"state", "n_shapes"}, False),
    "query": (
        "e0 -c c.sqlite -k 2",
        0,
        {"query", "verdict", "label", "because", "neighbors"},
        True,
    ),
    "evaluate": ("-c c.sqlite", 0, {"map", "n_queries"}, True),
    "duplicates": ("-c c.sqlite", 0, set(), True),
    "lab map": ("-c c.sqlite -o map.html", 0, {"page"}, True),
    "lab calibrate": ("-c c.sqlite -o metric.npz", 0, {"whitening", "reason"}, True),
    "report": ("-c c.sqlite -o report.html", 0, {"page"}, True),
    "list": ("-c c.sqlite --limit 2", 0, {"id", "path", "status", "grade"}, False),
    "show": ("e1 -c c.sqlite", 0, {"id", "steps", "stored_bytes"}, False),
    "mark": ("e1 accept -c c.sqlite", 0, {"ids", "mark", "note"}, False),
    "remove": ("e3 -c fewer.sqlite", 0, {"removed"}, False),
    "catalogue merge": ("c.sqlite -o all.sqlite", 0, {"n_added", "n_held"}, False),
    "catalogue check": ("-c c.sqlite --sample 1", 0, {"is_whole", "defects"}, True),
    "catalogue backup": ("c.sqlite copy.sqlite", 0, {"file", "bytes"}, False),
    "catalogue export": ("e0 -c c.sqlite -o mesh.off", 0, {"files"}, False),
    "lab options": ("--config handheld", 0, set(), True),
}
# This needs views, and has tests of its own.
ELSEWHERE = {"merge"}


def test_all_commands_are_asked() -> None:
    assert {*ASKED} | ELSEWHERE | WITHOUT == {*NAMES}
    assert "--json" not in "".join(run(name, "--help").output for name in WITHOUT)


@pytest.mark.parametrize("name", ASKED)
def test_every_document_has_one_head(
    name: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words, code, keys, has_options = ASKED[name]
    monkeypatch.chdir(folder)
    if name == "remove":
        run("catalogue", "backup", "c.sqlite", "fewer.sqlite")
    found = document(*name.split(), *words.split(), code=code)
    assert [*found] == [*HEAD, "result"]
    assert (found["command"], found["version"]) == (name, __version__)
    if has_options:
        PipelineOptions.model_validate(found["options"])
    else:
        assert found["options"] is None
    result = found["result"]
    first = result[0] if isinstance(result, list) and result else result
    assert keys <= set(first or ())
    assert "json" not in found["arguments"]


def test_passwords_are_not_repeated(capsys: pytest.CaptureFixture[str]) -> None:
    """Neither in documents, nor in messages of an ingest, nor in results; other texts stay as they are."""
    found = document("status", "-c", "postgresql://ann:secret@localhost:1/none", code=1)
    assert found["arguments"] == {"catalogue": "postgresql://ann@localhost:1/none"}
    assert "secret" not in json.dumps(found)
    _say_summary(Summary(), "postgresql://ann:secret@localhost:1/none", None)
    write_words(
        "postgresql://ann:secret@localhost:1/none: 3 shapes; scans are at https://host:80/a@b:c"
    )
    shown = capsys.readouterr()
    assert "secret" not in shown.err + shown.out
    assert "postgresql://ann@localhost:1/none" in shown.err
    assert (
        shown.out
        == "postgresql://ann@localhost:1/none: 3 shapes; scans are at https://host:80/a@b:c\n"
    )


def test_errors_are_documents_too(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    for words, code, error, part in (
        ("list -c none.sqlite", 1, "CatalogueError", "none.sqlite"),
        ("query none -c c.sqlite", 1, "InputError", "none"),
        ("query scans/flat.xyz -c c.sqlite", 1, "ReconstructionError", "points"),
        ("query e0 -c c.sqlite --csv", 2, "UsageError", "choose one of --json and --csv"),
        ("query e0 -c c.sqlite --method nothing", 2, "OptionError", "nothing"),
        ("query", 2, "MissingParameter", ""),
        ("list -c c.sqlite --limit 0", 2, "BadParameter", "0"),
        ("lisst", 2, "UsageError", "list"),
    ):
        found = document(*words.split(), code=None)
        assert [*found] == [*HEAD, *ERROR]
        assert (found["error"], found["exit_code"]) == (error, code)
        assert part in found["message"]
        if "--csv" not in words:
            assert run(*words.split(), code=None).stdout == ""
    # The exit code is that of the document, and the message for people is where it always is.
    command = "query e0 -c c.sqlite --method nothing --json"
    done = program(*command.split(), code=2)
    assert json.loads(done.stdout)["error"] == "OptionError"
    assert done.stderr.startswith("Error: ")


@command("numbers")
def numbers_command() -> Result:
    """A command that fails after its first result."""
    return Result(one_number())


def one_number() -> Iterator[int]:
    yield 1
    raise CatalogueError("the second is damaged")


def test_an_error_after_some_results_ends_the_list() -> None:
    done = CliRunner().invoke(numbers_command, ["--json"], prog_name="pcretrieve numbers")
    found = json.loads(done.stdout)
    assert [*found] == [*HEAD, "result", *ERROR]
    assert (found["result"], found["error"]) == ([1], "CatalogueError")
    assert found["message"] == "the second is damaged"
    assert isinstance(done.exception, CatalogueError)
    done = CliRunner().invoke(
        numbers_command, ["--jsonl"], prog_name="pcretrieve numbers"
    )
    first, error = map(json.loads, done.stdout.splitlines())
    assert (first, [*error]) == (1, ERROR)


def test_json_lines_have_an_element_each(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    rows = run("list", "-c", "c.sqlite", "--jsonl").stdout.splitlines()
    assert list(map(json.loads, rows)) == document("list", "-c", "c.sqlite")["result"]
    (row,) = run("show", "e1", "-c", "c.sqlite", "--jsonl").stdout.splitlines()
    assert json.loads(row) == document("show", "e1", "-c", "c.sqlite")["result"]
    (row,) = run("list", "-c", "nowhere.sqlite", "--jsonl", code=1).stdout.splitlines()
    assert json.loads(row)["exit_code"] == 1
