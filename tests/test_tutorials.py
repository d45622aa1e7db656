"""The documents and the notebooks work: commands and Python run in order, on a few of the sample scans."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import shapes
from commands import run
from packages import install

import pcretrieve as pr

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
SAMPLES = [
    f"person-{name}.ply"
    for name in ("1/person-1_stand", "1/person-1_walk", "2/person-2_run")
]

#: Makes the catalogue with which other documents begin.
INGEST = "pcretrieve ingest scans/ --labels scans/labels.csv --catalogue bodies.sqlite"


def blocks(document: Path) -> list[tuple[str, str]]:
    """The language and the text of each block of code, but for those that test_job_arrays.py runs."""
    text = document.read_text(encoding="utf-8")
    found = re.findall(r"^```(\w+)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return [(language, block) for language, block in found if language != "slurm"]


PAGES = [
    *ROOT.glob("*.md"),
    *(ROOT / "docs").glob("*.md"),
    *(ROOT / "docs" / "tutorials").glob("*.md"),
]
DOCUMENTS = sorted(page for page in PAGES if blocks(page))

# Documents whose commands take longer than those of all others together.
LONG = ("kinect", "calibrate", "other_packages", "cluster", "plugin")


def copy_samples(folder: Path) -> None:
    for sample in SAMPLES:
        (folder / sample).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / "scans" / sample, folder / sample)
    shutil.copy(ROOT / "scans" / "labels.csv", folder)


@pytest.fixture(scope="module")
def bodies(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The catalogue of the first tutorial, by its command."""
    folder = tmp_path_factory.mktemp("bodies")
    copy_samples(folder / "scans")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        run(*shlex.split(INGEST)[1:])
    return folder / "bodies.sqlite"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The files that the documents speak of, and the folder in which their commands run."""
    for name in ("scans", "calibration"):
        copy_samples(tmp_path / name)
    shutil.copy(ROOT / "new_scan.ply", tmp_path)
    body = shapes.body(3)
    for name, depth in (("body", 1), ("thin", 0.4)):
        corners = (body.vertices * [1, 1, depth])[body.faces]
        np.savetxt(tmp_path / f"{name}.tri", corners.reshape(-1, 9))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write_files(document: Path) -> list[tuple[str, str]]:
    """Write the blocks whose first line is a comment with the name of a file; return the others."""
    others = []
    for language, block in blocks(document):
        if found := re.match(r"# ([\w/]+\.(?:py|toml))\n", block):
            path = Path(found[1])
            path.parent.mkdir(exist_ok=True)
            path.write_text(block, encoding="utf-8")
        else:
            others.append((language, block))
    return others


def install_files(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install the package that the files of the folder make up, as pip would."""
    lines = []
    project = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["project"]
    for group, points in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in points.items())]
    modules = {
        path.stem: path.read_text(encoding="utf-8") for path in Path().glob("*.py")
    }
    install(
        site, project["name"].replace("-", "_"), modules, "\n".join(lines), monkeypatch
    )


@pytest.mark.parametrize(
    "document",
    [
        pytest.param(page, marks=[pytest.mark.slow] * (page.stem in LONG))
        for page in DOCUMENTS
    ],
    ids=[page.stem for page in DOCUMENTS],
)
def test_the_blocks_run_in_order(
    document: Path,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    request: pytest.FixtureRequest,
) -> None:
    """And files of options have options of these names with such values."""
    if document.name != "CONTRIBUTING.md":  # which makes a catalogue of this name
        pr.backup(request.getfixturevalue("bodies"), folder / "bodies.sqlite")
    parts = write_files(document)
    if Path("pyproject.toml").exists():
        install_files(folder / "site", monkeypatch)
    for path in {*Path().glob("*.toml")} - {Path("pyproject.toml")}:
        options = pr.PipelineOptions.of(path)
        for table, values in tomllib.loads(path.read_text(encoding="utf-8")).items():
            kept = getattr(options, table).model_dump(mode="json")
            assert {name: kept[name] for name in values} == values
    names: dict[str, object] = {}
    for language, block in parts:
        if language == "python":
            exec(compile(block, document.name, "exec"), names)
            continue
        assert language == "bash"
        for line in block.splitlines():
            if line != INGEST:  # by which the fixture made the catalogue
                program, *words = shlex.split(line)
                assert program == "pcretrieve"
                run(*words, *(["--help"] if words[0] == "serve" else []))


def test_the_first_tutorial_makes_the_catalogue_of_the_others() -> None:
    text = (ROOT / "docs" / "tutorials" / "first_catalogue.md").read_text(
        encoding="utf-8"
    )
    assert f"\n{INGEST}\n" in text
    assert {"README", "CONTRIBUTING", "guide", "scanners", "plugin"} <= {
        page.stem for page in DOCUMENTS
    }


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_cells_of_notebooks_run_in_order(
    notebook: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.chdir(notebook.parent)
    document = json.loads(notebook.read_text(encoding="utf-8"))
    cells = [
        "".join(cell["source"])
        for cell in document["cells"]
        if cell["cell_type"] == "code"
    ]
    assert cells
    names: dict[str, object] = {}
    for cell in cells:
        exec(compile(cell, notebook.name, "exec"), names)
