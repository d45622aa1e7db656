"""Which way data flows, read from the imports themselves."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

import pcretrieve

ROOT = Path(pcretrieve.__file__).parent

# What every stage stands on.
FOUNDATION = {
    "arrays",
    "conversion",
    "atomic",
    "csv_text",
    "values",
    "errors",
    "names",
    "options",
    "plugins",
    "adapters",
    "draw",
    "suggestions",
}

# The order in which data flows: a package may import packages before it, not packages after it.
STAGES = [
    "formats",
    "points",
    "surface",
    "checks",
    "spectral",
    "descriptors",
    "retrieval",
    "matching",
    "catalogue",
    "pipeline",
    "ingestion",
    "query",
    "evaluation",
    "estimators",
    "inspection",
    "pages",
    "interface",
    "web",
    "simulation",
    "benchmarks",
    "cli",
]

# Slow to import, or unsafe: each behind one door, which opens when it is first used.
DOORS = {
    "cholespy": "spectral/krylov.py",
    "cv2": "adapters/opencv.py",
    "distributed": "ingestion/cluster.py",
    "faiss": "adapters/faiss.py",
    "fsspec": "adapters/fsspec.py",
    "lapy": "adapters/lapy.py",
    "lazrs": "adapters/lazrs.py",
    "matplotlib": "adapters/matplotlib.py",
    "open3d": "adapters/open3d.py",
    "psycopg": "adapters/postgresql.py",
    "pye57": "adapters/pye57.py",
    "pytetwild": "adapters/tetwild.py",
    "robust_laplacian": "adapters/robust_laplacian.py",
    "skimage": "adapters/scikit_image.py",
    "sqlalchemy": "catalogue/database.py",
    "starlette": "web/application.py",
    "trimesh": "adapters/trimesh.py",
    "uvicorn": "web/server.py",
}

# Stages from a scan to a signature, which one module alone puts together.
COMPOSED = {"points", "surface", "spectral", "descriptors"}


class Import(NamedTuple):
    """One imported module, as its absolute name, and whether it is imported with the importing one."""

    name: str
    at_once: bool


def sources() -> list[Path]:
    return sorted(ROOT.rglob("*.py"))


def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def imports(path: Path) -> Iterator[Import]:
    module = tree(path)
    later = {
        node
        for function in ast.walk(module)
        if isinstance(function, (ast.FunctionDef, ast.AsyncFunctionDef)) or is_for_type_checking(function)
        for node in ast.walk(function)
    }
    for node in ast.walk(module):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield Import(alias.name, node not in later)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively"
            assert node.module is not None
            for alias in node.names:
                yield Import(f"{node.module}.{alias.name}", node not in later)


def is_for_type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def room(path: Path) -> str:
    """The package that a source belongs to; for one at the top level, its own name."""
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def rooms_used(path: Path) -> set[str]:
    names = [found.name.split(".") for found in imports(path)]
    return {parts[1] for parts in names if parts[0] == "pcretrieve" and len(parts) > 1} - {room(path)}


@pytest.fixture(params=sources(), ids=lambda path: path.relative_to(ROOT).as_posix())
def source(request: pytest.FixtureRequest) -> Path:
    path: Path = request.param
    return path


def test_every_room_has_its_place() -> None:
    assert {room(path) for path in sources()} == {*STAGES, *FOUNDATION, "__init__", "__main__"}


def test_data_flows_one_way(source: Path) -> None:
    here = room(source)
    if here in STAGES:
        allowed = FOUNDATION | set(STAGES[: STAGES.index(here)])
        # The command line shows the version of the package, and every row of a catalogue states it.
        allowed |= {"__version__"} if here in ("cli", "ingestion", "web") else set()
    elif here in FOUNDATION:
        allowed = FOUNDATION
    else:
        return
    assert rooms_used(source) <= allowed


def test_nothing_but_the_pipeline_composes_the_stages() -> None:
    composing = {
        path.relative_to(ROOT).as_posix()
        for path in sources()
        # Benchmarks hold what single stages make against the truth.
        if len(rooms_used(path) & COMPOSED) > 2 and room(path) != "benchmarks"
    }
    assert composing == {"pipeline/stages.py"}


def test_third_parties_have_one_door_each(source: Path) -> None:
    for found in imports(source):
        package = found.name.split(".")[0]
        if package in DOORS:
            assert source.relative_to(ROOT).as_posix() == DOORS[package]
            assert not found.at_once, f"{package} must be imported where it is used"


def test_scikit_learn_is_for_estimators_clusters_and_maps_alone(source: Path) -> None:
    packages = {found.name.split(".")[0] for found in imports(source)}
    adapter = source.relative_to(ROOT).as_posix() == "adapters/scikit_learn.py"
    assert ("sklearn" in packages) <= (adapter or room(source) == "estimators")
    assert not (adapter and any(found.at_once for found in imports(source) if "sklearn" in found.name))


def test_doors_lead_somewhere() -> None:
    for package, door in DOORS.items():
        assert package in {found.name.split(".")[0] for found in imports(ROOT / door)}


def compiled(path: Path) -> list[ast.FunctionDef]:
    """The functions of a source that numba compiles."""
    functions = [node for node in tree(path).body if isinstance(node, ast.FunctionDef)]
    return [node for node in functions if any("njit" in ast.unparse(by) for by in node.decorator_list)]


COMPILED = {node.name: path for path in sources() for node in compiled(path)}


def test_compiled_functions_call_none_of_another_module(source: Path) -> None:
    """Numba keeps what it has compiled until the file of that function changes, not those of its callees."""
    elsewhere = {name for name, path in COMPILED.items() if path != source}
    imported = {found.name.split(".")[-1] for found in imports(source)} & elsewhere
    for function in compiled(source):
        called = {node.id for node in ast.walk(function) if isinstance(node, ast.Name)}
        assert not called & imported, function.name


# Files that are not results: an index of a catalogue is a folder that is renamed once it is complete,
# /proc is no disk, and an upload is removed once it has been processed.
WRITERS = {
    "atomic.py",
    "adapters/parent.py",
    "catalogue/gallery.py",
    "benchmarks/memory.py",
    "web/uploads.py",
}


def test_files_are_written_in_one_step(source: Path) -> None:
    """By `write_file`, so that a full disk or a stop leaves the old file whole."""
    if source.relative_to(ROOT).as_posix() in WRITERS:
        return
    for node in ast.walk(tree(source)):
        if isinstance(node, ast.Call):
            name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            given = [*node.args, *(keyword.value for keyword in node.keywords)]
            modes = {argument.value for argument in given if isinstance(argument, ast.Constant)}
            writes = name == "open" and modes & {"w", "wb", "a", "ab", "x", "xb", "r+", "r+b"}
            assert not writes, f"line {node.lineno}"
            assert name not in {"write_text", "write_bytes", "tofile"}, f"line {node.lineno}"


def test_the_library_never_prints(source: Path) -> None:
    if room(source) == "cli":
        return
    for node in ast.walk(tree(source)):
        printing = isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print"
        assert not printing, f"line {getattr(node, 'lineno', 0)}"
