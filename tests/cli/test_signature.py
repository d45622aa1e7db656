"""`pcretrieve signature`: descriptors by name, of other packages too, and from a catalogue alone."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import shapes

from pcretrieve import Catalogue, PipelineOptions, ingest
from pcretrieve.cli.main import main
from pcretrieve.formats import write_mesh

PLUGIN = {
    "pyproject.toml": """
[build-system]
requires = ["setuptools"]
build-backend = "setuptools.build_meta"
[project]
name = "pcretrieve-girth"
version = "1.0"
[project.entry-points."pcretrieve.descriptors"]
girth = "girth:girth"
clumsy = "girth:clumsy"
hollow = "girth:hollow"
lost = "girth_lost:girth"
""",
    "girth.py": '''
"""Descriptors for tests."""

import numpy as np

from pcretrieve.values import Signature


def girth(shape, options):
    reach = np.linalg.norm(shape.mesh.vertices - shape.mesh.vertices.mean(axis=0), axis=1)
    levels = np.linspace(0.1, 0.9, options.n_values)
    return Signature(np.quantile(reach, levels) / np.sqrt(shape.area), kind="girth")


def clumsy(shape, options):
    return [][options.n_values]


def hollow(shape, options):
    return Signature(np.zeros(options.n_values), kind="hollow")
''',
}


class Answer(NamedTuple):
    """What a command left behind."""

    code: int
    stdout: str
    stderr: str


Run = Callable[..., Answer]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    """The command line, in this process: a new one takes seconds to import what it needs."""

    def command(*arguments: object) -> Answer:
        monkeypatch.setattr(sys, "argv", ["pcretrieve", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        out, err = capfd.readouterr()
        return Answer(int(ended.value.code or 0), out, err)

    return command


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that somebody has installed a package of descriptors into."""
    source, target = tmp_path_factory.mktemp("plugin"), tmp_path_factory.mktemp("site")
    for name, text in PLUGIN.items():
        (source / name).write_text(text)
    pip = [sys.executable, "-m", "pip", "install", "--no-deps", "--no-build-isolation", "--no-index"]
    made = subprocess.run(
        [*pip, "--disable-pip-version-check", "--target", str(target), str(source)],
        capture_output=True,
        text=True,
    )
    if "No module named pip" in made.stderr:
        pytest.skip("this environment has no pip to install a package with")
    assert made.returncode == 0, made.stderr
    return target


@pytest.fixture
def installed(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(site))


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scans") / "body.off"
    write_mesh(shapes.body(3), path)
    return path


@pytest.fixture(scope="module")
def catalogue(scan: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A catalogue of two shapes and a failure, whose files are gone."""
    folder = tmp_path_factory.mktemp("gone")
    for name, mesh in {"egg": shapes.ellipsoid(subdivisions=3), "body": shapes.body(3)}.items():
        write_mesh(mesh, folder / f"{name}.off")
    (folder / "nothing.off").write_text("OFF\n")
    path = folder / "c.sqlite"
    with Catalogue(path, PipelineOptions(), create=True) as store:
        ingest(sorted(folder.glob("*.off")), store)
    for file in folder.glob("*.off"):
        file.unlink()
    return path


def values(answer: Answer) -> dict[str, np.ndarray]:
    """The lines of an answer, by their first word."""
    assert answer.code == 0, answer.stderr
    rows = [line.split("\t") for line in answer.stdout.splitlines()]
    return {row[0]: np.array(row[1:], dtype=float) for row in rows}


# --- other packages -------------------------------------------------------------------------------------


@pytest.mark.usefixtures("installed")
def test_a_descriptor_of_another_package_is_used_like_any_other(
    run: Run, scan: Path, catalogue: Path
) -> None:
    (found,) = values(run("signature", scan, "--method", "girth", "--n-values", 5)).values()
    assert len(found) == 5
    assert (np.diff(found) > 0).all()
    stored = values(run("signature", "--from-catalogue", catalogue, "--method", "girth", "body"))
    assert len(stored["body"]) == 59
    np.testing.assert_allclose(stored["body"][[0, -1]], found[[0, -1]], rtol=1e-6)
    asked = run("query", "-c", catalogue, scan, "--method", "girth", "--json")
    assert [row["id"] for row in json.loads(asked.stdout)["result"][0]["results"]] == ["body", "egg"], (
        asked.stderr
    )


@pytest.mark.usefixtures("installed")
def test_a_package_that_cannot_be_loaded_is_named(run: Run, scan: Path) -> None:
    answer = run("signature", scan, "--method", "lost")
    assert answer.code == 2
    assert answer.stderr == (
        "Error: the descriptor 'lost' of the package pcretrieve-girth cannot be loaded, ModuleNotFoundError: "
        "No module named 'girth_lost'; upgrade or uninstall that package\n"
    )


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize(
    ("method", "message"),
    [
        ("clumsy", "failed, IndexError: list index out of range"),
        ("hollow", "failed, InputError: signature values must be positive, got 0.0"),
    ],
)
def test_a_descriptor_that_fails_fails_its_shape_only(
    method: str, message: str, run: Run, scan: Path
) -> None:
    answer = run("signature", scan, "--method", method)
    assert answer.code == 3
    where = f"failed: [body / signature] the descriptor '{method}' of the package pcretrieve-girth {message}"
    assert answer.stderr.startswith(where)


# --- from a catalogue -----------------------------------------------------------------------------------


def test_shapes_of_a_catalogue_that_have_no_signature(run: Run, catalogue: Path) -> None:
    failed = run("signature", "--from-catalogue", catalogue, "nothing", "egg", "--json")
    assert failed.code == 3
    assert failed.stderr.startswith("failed: [nothing / read] ")
    assert [row["id"] for row in json.loads(failed.stdout)["result"]] == ["nothing", "egg"]
    unknown = run("signature", "--from-catalogue", catalogue, "ogre")
    assert unknown.code == 1
    assert "holds no shape 'ogre'; `pcretrieve list` names them" in unknown.stderr
    usage = run("signature", "--from-catalogue", catalogue, "--surface", "keep")
    assert usage.code == 2
    assert "a catalogue has options of its own: leave out --config, --surface and --unit" in usage.stderr
    assert run("signature").code == 2
