"""The tutorials and the notebooks work: commands and Python run in order, on a few of the sample scans."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import sys
from pathlib import Path

import pytest
import shapes
from click.testing import CliRunner
from packages import install

import pcretrieve as pr
from pcretrieve.cli.main import cli
from pcretrieve.formats import write_mesh

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
OTHERS = sorted((ROOT / "docs").glob("*.md"))
SAMPLES = [f"person-{name}.ply" for name in ("1/person-1_stand", "1/person-1_walk", "2/person-2_run")]


def blocks(document: Path) -> list[tuple[str, str]]:
    """The language and the text of each block of code."""
    return re.findall(
        r"^```(\w+)\n(.*?)^```$", document.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The files that the tutorials speak of, and the folder in which their commands run."""
    for name in ("scans", "calibration"):
        (tmp_path / name).mkdir()
        shutil.copy(ROOT / "scans" / "labels.csv", tmp_path / name)
        for sample in SAMPLES:
            (tmp_path / name / sample).parent.mkdir(exist_ok=True)
            shutil.copy(ROOT / "scans" / sample, tmp_path / name / sample)
    shutil.copy(ROOT / "scans" / "person-1" / "person-1_reach_up.ply", tmp_path / "new_scan.ply")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def named_file(text: str) -> Path | None:
    """The file that a block is, if its first line is a comment with its name."""
    found = re.match(r"# ([\w/]+\.(?:py|toml))\n", text)
    return Path(found[1]) if found else None


def install_plugin(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install the package that the files of the folder make up, as pip would."""
    lines = []
    project = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["project"]
    for group, points in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in points.items())]
    modules = {path.stem: path.read_text(encoding="utf-8") for path in Path().glob("*.py")}
    install(site, project["name"].replace("-", "_"), modules, "\n".join(lines), monkeypatch)


#: Makes the catalogue with which other tutorials begin.
INGEST = "pcretrieve ingest scans/ --labels scans/labels.csv --catalogue bodies.sqlite"


@pytest.fixture(scope="module")
def bodies(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The catalogue of the first tutorial, by its command."""
    folder = tmp_path_factory.mktemp("bodies")
    for sample in SAMPLES:
        (folder / "scans" / sample).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / "scans" / sample, folder / "scans" / sample)
    shutil.copy(ROOT / "scans" / "labels.csv", folder / "scans")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        result = CliRunner().invoke(cli, shlex.split(INGEST)[1:])
    assert result.exit_code == 0, (result.output, result.exception)
    return folder / "bodies.sqlite"


def test_the_first_tutorial_makes_the_catalogue_of_the_others() -> None:
    text = (ROOT / "docs" / "tutorials" / "first_catalogue.md").read_text(encoding="utf-8")
    assert f"\n{INGEST}\n" in text


@pytest.mark.parametrize("tutorial", TUTORIALS, ids=lambda path: path.stem)
def test_the_blocks_run_in_order(
    tutorial: Path, folder: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    text = tutorial.read_text(encoding="utf-8")
    if "bodies.sqlite" in text:
        pr.backup(request.getfixturevalue("bodies"), folder / "bodies.sqlite")
    names: dict[str, object] = {}
    ran = 0
    for language, block in blocks(tutorial):
        path = named_file(block)
        if path is not None:
            path.parent.mkdir(exist_ok=True)
            path.write_text(block, encoding="utf-8")
            if path.name == "pyproject.toml":
                install_plugin(folder / "site", monkeypatch)
        elif language == "python":
            exec(compile(block, tutorial.name, "exec"), names)
            ran += 1
        elif language == "bash":
            for line in block.splitlines():
                if line == INGEST:  # by which the fixture made the catalogue
                    continue
                program, *words = shlex.split(line)
                assert program == "pcretrieve"
                result = CliRunner().invoke(cli, words)
                assert result.exit_code == 0, (line, result.output, result.exception)
                ran += 1
        else:
            assert language == "slurm", f"{language}: tests/test_job_arrays.py runs such scripts"
    assert ran > 0


def test_blocks_of_the_other_documents_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Python runs, and files of options have options of these names with such values."""
    monkeypatch.chdir(tmp_path)
    write_mesh(shapes.ellipsoid((1, 1.2, 1.5), subdivisions=3), tmp_path / "egg.off")
    ran = set()
    for document in OTHERS:
        names: dict[str, object] = {}
        for language, block in blocks(document):
            if language == "python":
                exec(compile(block, document.name, "exec"), names)
            elif language == "toml" and (path := named_file(block)):
                path.write_text(block, encoding="utf-8")
                options = pr.PipelineOptions.of(path)
                for table, values in tomllib.loads(block).items():
                    kept = getattr(options, table).model_dump(mode="json")
                    assert {name: kept[name] for name in values} == values
            ran.add((document.name, language))
    assert {("guide.md", "python"), ("scanners.md", "toml")} <= ran


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_cells_of_notebooks_run_in_order(notebook: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.chdir(notebook.parent)
    document = json.loads(notebook.read_text(encoding="utf-8"))
    cells = ["".join(cell["source"]) for cell in document["cells"] if cell["cell_type"] == "code"]
    assert cells
    names: dict[str, object] = {}
    for cell in cells:
        exec(compile(cell, notebook.name, "exec"), names)
