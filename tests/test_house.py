"""The laws of the house: how large a room may be, and which way it may look. See `scripts/house`."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from benchmarks.house import (
    arrows,
    imported,
    option_names,
    room,
    sources,
    tokens_by_room,
    tree,
)

# Rooms in the order in which data flows: a room imports rooms above it only.
ROOMS = (
    "errors",
    "plugins",
    "arrays",
    "draw",
    "values",
    "options",
    "formats",
    "points",
    "surface",
    "spectral",
    "descriptors",
    "retrieval",
    "shrec",
    "catalogue",
    "checks",
    "pipeline",
    "ingestion",
    "query",
    "evaluation",
    "estimators",
    "pages",
    "simulation",
    "web",
    "cli",
)

# Names, operators and numbers of the package, as `tokenize` counts them.
# Docstrings, comments and air are free.
MOST_TOKENS = 228_000
MOST_MODULES = 180
MOST_ARROWS = 115
MOST_OPTIONS = 45

# Rooms that faces use beside the front door, and no more than these: `demo` writes simulated scans.
BEHIND = {"cli": {"simulation"}, "pages": {"pipeline"}, "web": {"ingestion", "query"}}

# Slow to import: each is imported in functions.
HEAVY = {
    *("cv2", "distributed", "fsspec", "laspy", "matplotlib", "open3d", "pandas", "potpourri3d"),
    *("psycopg", "pye57", "pytetwild", "robust_laplacian", "sqlalchemy", "starlette", "trimesh"),
}


def functions(path: Path) -> Iterator[ast.FunctionDef]:
    yield from (node for node in ast.walk(tree(path)) if isinstance(node, ast.FunctionDef))


def test_the_package_can_be_read() -> None:
    tokens = tokens_by_room()
    assert set(tokens) == {*ROOMS, "__init__", "__main__"}
    assert sum(tokens.values()) <= MOST_TOKENS
    assert len(sources()) <= MOST_MODULES


def test_functions_take_at_most_eight_arguments() -> None:
    for path in sources():
        for each in functions(path):
            given = [*each.args.posonlyargs, *each.args.args, *each.args.kwonlyargs]
            # What a command takes is its options; a face takes keywords, each with its default.
            is_face = room(path) == "cli" or len(each.args.kwonlyargs) > 3
            n_given = len([one for one in given if one.arg not in ("self", "cls")])
            assert is_face or n_given <= 8, (path, each.name)


def test_data_flows_one_way() -> None:
    upwards = [(one, other) for one, other in arrows() if ROOMS.index(other) > ROOMS.index(one)]
    assert sorted(upwards) == []
    assert len(arrows()) <= MOST_ARROWS


def test_compared_systems_are_met_by_those_who_ask_for_them_alone() -> None:
    """Descriptors of `shrec` are found by address; only `evaluate` and `matrix` import matchers."""
    assert {one for one, other in arrows() if other == "shrec"} == {"evaluation"}


def test_the_command_line_calls_the_front_door() -> None:
    for face, also in BEHIND.items():
        seen = {other for one, other in arrows() if one == face}
        assert seen <= {"errors", "values", "options", "plugins", "draw", "pages"} | also, face


def test_what_is_heavy_is_imported_when_it_is_used() -> None:
    for path in sources():
        at_once = {name.split(".")[0] for name, is_at_once in imported(path) if is_at_once}
        # The application of the search page is imported by `serve` alone.
        assert at_once.isdisjoint(HEAVY) or path.name == "application.py", path


def test_compiled_functions_call_none_of_another_module() -> None:
    """Numba keeps what it has compiled until the file of that function changes, not those of its callees."""
    compiled = {
        each.name: (path, each)
        for path in sources()
        for each in functions(path)
        if any("njit" in ast.unparse(by) for by in each.decorator_list)
    }
    assert compiled
    for name, (path, each) in compiled.items():
        elsewhere = {other for other, (place, _) in compiled.items() if place != path}
        taken = {found.split(".")[-1] for found, _ in imported(path)} & elsewhere
        assert not taken & {node.id for node in ast.walk(each) if isinstance(node, ast.Name)}, name


def test_the_library_never_prints_and_writes_files_in_one_step() -> None:
    for path in sources():
        for call in (node for node in ast.walk(tree(path)) if isinstance(node, ast.Call)):
            name = getattr(call.func, "attr", getattr(call.func, "id", ""))
            assert name != "print" or room(path) == "cli", f"{path}:{call.lineno}"
            # The index of a catalogue is written into a folder that is renamed once it is
            # complete, and a worker asks the system to be ended first when memory runs out.
            writes = name in {"write_text", "write_bytes", "tofile"}
            assert not writes or path.name in {"files.py", "cache.py", "worker.py"}, (
                f"{path}:{call.lineno}"
            )


def test_options_are_few() -> None:
    assert len(option_names()) <= MOST_OPTIONS
