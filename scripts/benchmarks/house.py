"""Print the size of the house: tokens, lines, modules, arrows between rooms, options, tests, prose.

    scripts/house            # counts, in seconds
    scripts/house --tests    # and the cases, by collecting them
    scripts/house --path     # and the way of a query to the solver, by running one

A room is a package or a module at the top of `pcretrieve/`. An arrow leads from a room to a room that it
imports, also in a function or for type checkers only. Templates, styles and scripts of pages are lines too.
"""

from __future__ import annotations

import argparse
import ast
import io
import os
import re
import subprocess
import sys
import tempfile
import tokenize
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "pcretrieve"
SOURCES = (".py", ".pyi", ".html", ".css", ".js", ".sql")

# Columns from which a line of code counts as wide.
WIDE = 90

# Written into a folder of PYTHONPATH: notes the frames of pcretrieve when a process starts and at the solver.
HOOK = """
import os, sys, threading
def note(frame, event, argument):
    code = frame.f_code
    at_solver = code.co_name == "eigenpairs" and "/pcretrieve/spectral/" in code.co_filename
    if event == "call" and (at_solver or code.co_name == "start" and "multiprocessing" in code.co_filename):
        lines = []
        while frame is not None:
            if "/pcretrieve/" in frame.f_code.co_filename:
                lines.append(frame.f_code.co_filename.split("/pcretrieve/")[-1] + ":" + frame.f_code.co_name)
            frame = frame.f_back
        with open(os.environ["FRAMES"] + ("/solver" if at_solver else f"/start{os.getpid()}"), "w") as file:
            file.write("\\n".join(reversed(lines)))
        if at_solver:
            sys.setprofile(None)
sys.setprofile(note)
"""


def sources() -> list[Path]:
    """All modules of the package."""
    return sorted(PACKAGE.rglob("*.py"))


def room(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].partition(".")[0]


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def lines_by_room() -> dict[str, int]:
    counted: dict[str, int] = {}
    for path in sorted(PACKAGE.rglob("*")):
        if path.suffix in SOURCES and not path.name.endswith(".min.js"):
            lines = len(path.read_text(encoding="utf-8").splitlines())
            counted[room(path)] = counted.get(room(path), 0) + lines
    return counted


def tokens_by_room() -> dict[str, int]:
    """Names, operators and numbers of the code: strings, docstrings, comments and air are free."""
    counted: dict[str, int] = {}
    for path in sources():
        tokens = n_tokens(path.read_text(encoding="utf-8"))
        counted[room(path)] = counted.get(room(path), 0) + tokens
    return counted


def n_tokens(text: str) -> int:
    """Names, operators and numbers of a source, but none inside f-strings: one token up to Python 3.11."""
    counted, depth = 0, 0
    for word in tokenize.generate_tokens(io.StringIO(text).readline):
        kind = tokenize.tok_name[word.type]
        depth += kind.endswith("STRING_START")
        counted += not depth and word.type in (
            tokenize.NAME,
            tokenize.OP,
            tokenize.NUMBER,
        )
        depth -= kind.endswith("STRING_END")
    return counted


def law(name: str) -> str:
    """A ceiling in tests/test_house.py."""
    laws = tree(ROOT / "tests" / "test_house.py").body
    return next(
        f"{ast.literal_eval(each.value):,}"
        for each in laws
        if isinstance(each, ast.Assign) and ast.unparse(each.targets[0]) == name
    )


def wide_lines(path: Path) -> int:
    """Lines of code of 90 columns or more, without docstrings and comments."""
    lines = path.read_text(encoding="utf-8").splitlines()
    texts = {
        number
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        for number in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    return sum(
        len(line) >= WIDE and number not in texts and not line.lstrip().startswith("#")
        for number, line in enumerate(lines, 1)
    )


def tuple_assignments(path: Path) -> int:
    """Assignments of several constants in one statement, which have no comment each."""
    return sum(
        isinstance(target, ast.Tuple)
        and all(ast.unparse(name).isupper() for name in target.elts)
        for node in tree(path).body
        if isinstance(node, ast.Assign)
        for target in node.targets
    )


def imported(path: Path) -> Iterator[tuple[str, bool]]:
    """Absolute names of what a module imports, and whether it does so when it is imported itself."""
    module = tree(path)
    functions = [
        node
        for node in ast.walk(module)
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
    ]
    checking = [
        node
        for node in module.body
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
    ]
    later = {inner for outer in (*functions, *checking) for inner in ast.walk(outer)}
    for node in ast.walk(module):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node not in later) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (
                (f"{node.module}.{alias.name}", node not in later) for alias in node.names
            )


@cache
def arrows() -> frozenset[tuple[str, str]]:
    """Pairs of rooms of which the first imports the second; the face of the package draws none."""
    rooms = set(lines_by_room()) - {"__init__", "__main__"}
    found = set()
    for path in sources():
        for name, _ in imported(path):
            parts = name.split(".")
            if parts[0] == "pcretrieve" and len(parts) > 1 and parts[1] in rooms:
                found.add((room(path), parts[1]))
    return frozenset(
        (one, other) for one, other in found if one != other and one in rooms
    )


def docstring_lines(path: Path) -> int:
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    bodies = [
        node.body
        for node in ast.walk(tree(path))
        if isinstance(node, kinds) and node.body
    ]
    texts = [body[0] for body in bodies if isinstance(body[0], ast.Expr)]
    return sum(
        (text.end_lineno or 0) - text.lineno + 1
        for text in texts
        if isinstance(text.value, ast.Constant) and isinstance(text.value.value, str)
    )


def code_lines(path: Path) -> int:
    """Lines with code: neither blank, nor comments, nor docstrings."""
    text = path.read_text(encoding="utf-8")
    skipped = (
        tokenize.COMMENT,
        tokenize.NL,
        tokenize.NEWLINE,
        tokenize.INDENT,
        tokenize.DEDENT,
        tokenize.ENDMARKER,
    )
    used: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in skipped:
            used.update(range(token.start[0], token.end[0] + 1))
    return len(used) - docstring_lines(path)


def option_names() -> list[str]:
    """Names of all options with their tables."""
    from pcretrieve import PipelineOptions

    tables = {
        name: getattr(PipelineOptions(), name) for name in PipelineOptions.model_fields
    }
    return [
        f"{table}.{name}"
        for table, options in tables.items()
        for name in type(options).model_fields
    ]


def entry_point_groups() -> set[str]:
    """Groups of entry points that the package reads: what the records `Names` are made with."""
    calls = [
        node
        for path in sources()
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Call)
    ]
    return {
        str(call.args[1].value)
        for call in calls
        if ast.unparse(call.func) == "Names"
        and len(call.args) > 1
        and isinstance(call.args[1], ast.Constant)
    }


def prose() -> tuple[float, float]:
    """KB of text of the documents, and of the README."""
    documents = [
        path for path in (ROOT / "docs").rglob("*.md") if "_build" not in path.parts
    ]
    return sum(path.stat().st_size for path in documents) / 1e3, (
        ROOT / "README.md"
    ).stat().st_size / 1e3


def test_lines() -> int:
    return sum(
        len(path.read_text(encoding="utf-8").splitlines())
        for path in (ROOT / "tests").rglob("*.py")
    )


def test_cases(*, everything: bool) -> int:
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-n", "0"]
    command += [] if everything else ["-m", "not slow"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
    found = re.search(r"(\d+)(?:/\d+)? tests collected", done.stdout)
    return int(found[1]) if found else 0


def path_of_a_query() -> tuple[list[str], list[str]]:
    """Frames of the package in both processes from the command to the solver, and their modules."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "sitecustomize.py").write_text(HOOK, encoding="utf-8")
        scan = ROOT / "scans" / "person-1" / "person-1_stand.ply"
        catalogue = folder / "one.sqlite"
        command = [sys.executable, "-m", "pcretrieve"]
        subprocess.run(
            [*command, "ingest", scan.with_name("person-1_walk.ply"), "-c", catalogue],
            check=True,
        )
        environment = os.environ | {"PYTHONPATH": name, "FRAMES": name}
        subprocess.run(
            [*command, "query", "-c", catalogue, scan], check=True, env=environment
        )
        parts = [*sorted(folder.glob("start*"))[:1], folder / "solver"]
        frames = [
            line
            for part in parts
            for line in part.read_text(encoding="utf-8").splitlines()
        ]
    frames = [frame for frame in frames if not frame.endswith("<module>")]
    return frames, sorted({frame.split(":")[0] for frame in frames})


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--tests", action="store_true", help="count the cases of the tests too"
    )
    parser.add_argument(
        "--path", action="store_true", help="follow a query to the solver too"
    )
    given = parser.parse_args(arguments)
    rooms = lines_by_room()
    tokens, lines = tokens_by_room(), sum(map(code_lines, sources()))
    n_tuples, n_wide = (
        sum(map(tuple_assignments, sources())),
        sum(map(wide_lines, sources())),
    )
    largest = max(tokens, key=tokens.__getitem__)
    rows = [
        ("tokens", law("MOST_TOKENS"), f"{sum(tokens.values()):,}"),
        (f"tokens of the largest room, {largest}", "22,000", f"{tokens[largest]:,}"),
        ("tokens a line of code", "9", f"{sum(tokens.values()) / lines:.1f}"),
        (f"lines of code of {WIDE} columns and more", "3 %", f"{n_wide / lines:.1%}"),
        ("tuple assignments of constants", "0", str(n_tuples)),
        ("lines of pcretrieve/, with templates", "", f"{sum(rooms.values()):,}"),
        ("modules", law("MOST_MODULES"), str(len(sources()))),
        ("lines of code", "", f"{lines:,}"),
        ("lines of docstrings", "", f"{sum(map(docstring_lines, sources())):,}"),
        ("arrows between rooms", law("MOST_ARROWS"), str(len(arrows()))),
        ("options", law("MOST_OPTIONS"), str(len(option_names()))),
        ("groups of entry points", "2", str(len(entry_point_groups()))),
        ("lines of tests", "", f"{test_lines():,}"),
        ("KB of documents, of README", "", "{:.0f} + {:.0f}".format(*prose())),
    ]
    if given.tests:
        rows.append(("cases by default", "2,500", str(test_cases(everything=False))))
        rows.append(("cases in all", "", str(test_cases(everything=True))))
    if given.path:
        frames, modules = path_of_a_query()
        rows.append(("modules from query to the solver", "12", str(len(modules))))
        rows.append(("frames from query to the solver", "14", str(len(frames))))
    for title, asked, measured in rows:
        print(f"{title:40} {asked:>18} {measured:>12}")
    print("\ntokens and lines by room")
    for name, n in sorted(tokens.items(), key=lambda item: -item[1]):
        print(f"  {name:20} {n:6,} {rooms[name]:6,}")
