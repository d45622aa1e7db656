"""Wall-clock times on one core, of functions that are called alternately."""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar

import click
from PIL import Image
from rich.console import Console
from rich.progress import track

from pcretrieve.errors import BenchmarkError, PcretrieveError
from pcretrieve.evaluation import RetrievalMeasures, rank_table
from pcretrieve.evaluation.measures import evaluate_rankings
from pcretrieve.ingestion.pool import in_processes
from pcretrieve.values import FloatArray
from pcretrieve.values.files import write_file

Result = TypeVar("Result")


def evaluate_table(*table: Any, **how: Any) -> RetrievalMeasures:
    """The measures of a table of signatures, ranked as by `rank_table`."""
    return evaluate_rankings(rank_table(*table, **how)[0])


def timed(function: Callable[[], Result]) -> tuple[float, Result]:
    """Call a function once and take the time."""
    started = time.perf_counter()
    result = function()
    return time.perf_counter() - started, result


def timed_by_turns(
    functions: Sequence[Callable[[], Result]], n_repeats: int
) -> list[tuple[list[float], Result]]:
    """Call each function in turn, `n_repeats` times over, so that other load on the machine slows all alike.

    Returns the times of each function in seconds, and the result of its first call.
    """
    calls = [[timed(function) for function in functions] for _ in range(n_repeats)]
    return [
        ([seconds for seconds, _ in own], own[0][1]) for own in zip(*calls, strict=True)
    ]


def use_one_core() -> None:
    """Confine this process, and those that it starts, to one core, if the operating system can do so."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


KIB = 1 << 10
MIB = 1 << 20


def resident_memory(pid: int) -> float:
    """Resident memory of a process and its descendants at this moment."""
    return sum(_resident(member) for member in _tree(pid))


def _resident(pid: int) -> float:
    with contextlib.suppress(OSError, IndexError):
        return (
            int(Path(f"/proc/{pid}/statm").read_text().split()[1])
            * os.sysconf("SC_PAGE_SIZE")
            / MIB
        )
    return 0.0


def largest_descendant(pid: int) -> float:
    """Resident memory of the largest of the descendants of a process at this moment, 0 without any."""
    return max(map(_resident, _tree(pid)[1:]), default=0.0)


def forget_peak() -> None:
    """Reset the kernel's record of the largest resident memory of this process and its descendants."""
    for pid in _tree(os.getpid()):
        with contextlib.suppress(OSError):
            Path(f"/proc/{pid}/clear_refs").write_text("5")


def peak_memory() -> float:
    """Largest resident memory of this process and its descendants since `forget_peak`."""
    kib = 0
    for pid in _tree(os.getpid()):
        with contextlib.suppress(OSError):
            found = re.search(
                r"VmHWM:\s*(\d+) kB", Path(f"/proc/{pid}/status").read_text()
            )
            kib += int(found[1]) if found else 0
    return kib / KIB or float("nan")


def _tree(pid: int) -> list[int]:
    """A process and its descendants."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return [pid]
    return [pid, *(descendant for child in children for descendant in _tree(int(child)))]


# Interval at which the memory of a running command is read; seconds.
POLL_SECONDS = 0.02


def run_command(*arguments: str) -> tuple[float, float]:
    """Run ``pcretrieve`` in a process of its own, and discard its standard output."""
    # With byte code, as pip installs it: without it Python compiles the package at each start, .05 s.
    environment = {
        name: value
        for name, value in os.environ.items()
        if name != "PYTHONDONTWRITEBYTECODE"
    }
    command = [sys.executable, "-m", "pcretrieve", *arguments]
    started = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, env=environment)
    peak = 0.0
    finished = threading.Event()

    def watch() -> None:
        nonlocal peak
        while not finished.wait(POLL_SECONDS):
            peak = max(peak, resident_memory(process.pid))

    watcher = threading.Thread(target=watch)
    watcher.start()
    code = process.wait()
    seconds = time.perf_counter() - started
    finished.set()
    watcher.join()
    if code:
        raise BenchmarkError(
            f"pcretrieve {' '.join(arguments)} ended with exit code {code}, not 0"
        )
    return seconds, peak


Thing = TypeVar("Thing")


def progress(
    things: Iterable[Thing], title: str, total: int | None = None
) -> Iterable[Thing]:
    """Iterate with a progress bar on standard error, if that is a terminal."""
    terminal = Console(stderr=True)
    is_file = not terminal.is_terminal
    return track(things, title, total, console=terminal, transient=True, disable=is_file)


def in_workers(
    function: Callable[[Thing], Result],
    things: Sequence[Thing],
    title: str,
    **limits: Any,
) -> dict[Thing, Result | PcretrieveError]:
    """What a function returns for each thing, or its error, in worker processes with a progress bar."""
    found = dict(in_processes(function, progress(things, title), **limits))
    return {thing: found[thing] for thing in things}


def all_in_workers(
    function: Callable[[Thing], Result],
    things: Sequence[Thing],
    title: str,
    **limits: Any,
) -> list[Result]:
    """As `in_workers`, where the first error is raised."""
    results = []
    for outcome in in_workers(function, things, title, **limits).values():
        if isinstance(outcome, PcretrieveError):
            raise outcome
        results.append(outcome)
    return results


def png(picture: Image.Image) -> bytes:
    """A picture as a PNG file."""
    data = io.BytesIO()
    picture.save(data, "PNG", optimize=True)
    return data.getvalue()


# Titles of the measures, in the order of the first fields of `RetrievalMeasures`.
MEASURES = ("NN", "FT", "ST", "E", "DCG", "mAP")


class Column(NamedTuple):
    """One column of a table."""

    title: str
    width: int
    format: str = ""
    align: str = ">"


class Table:
    """Lines of columns that are separated by one space."""

    def __init__(self, *columns: Column) -> None:
        self.columns = columns

    @property
    def head(self) -> str:
        """The line of the titles."""
        return self._line(column.title for column in self.columns)

    def row(self, *values: object) -> str:
        """Format the values of one line."""
        return self._line(
            self._cell(column, value)
            for column, value in zip(self.columns, values, strict=True)
        )

    @staticmethod
    def _cell(column: Column, value: object) -> str:
        if is_missing(value):
            return "-"
        return value if isinstance(value, str) else format(value, column.format)

    def _line(self, cells: Iterable[str]) -> str:
        padded = (
            f"{cell:{column.align}{column.width}}"
            for column, cell in zip(self.columns, cells, strict=True)
        )
        return " ".join(padded).rstrip()


def is_missing(value: object) -> bool:
    """Whether a value was not measured."""
    return value is None or value != value


def measure_values(measures: RetrievalMeasures) -> tuple[float, ...]:
    """The values of the measures in `MEASURES`."""
    return tuple(astuple(measures)[: len(MEASURES)])


def print_lines(lines: Iterable[str]) -> None:
    """Print each line on standard output as soon as it is computed."""
    for line in lines:
        click.echo(line)


def argument_parser(
    description: str | None, epilog: str | None = None
) -> argparse.ArgumentParser:
    """A parser whose help prints the description, a module's docstring, with its line breaks."""
    return argparse.ArgumentParser(
        description=description,
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def add_data(parser: argparse.ArgumentParser) -> None:
    """Add ``--data``, the folder that has a subfolder for each data set."""
    shown = "folder of the data sets (default: %(default)s)"
    parser.add_argument(
        "--data", type=Path, default=Path("data"), metavar="FOLDER", help=shown
    )


def add_anny(parser: argparse.ArgumentParser) -> None:
    """Add ``--anny``, the folder of bodies that `make_people` writes."""
    shown = "bodies of Anny (default: anny in --data)"
    parser.add_argument("--anny", type=Path, metavar="FOLDER", help=shown)


def positive(text: str) -> int:
    """An integer of at least 1, as the type of an argument."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1, got {number}")
    return number


def draw_curves(
    path: Path,
    x: Sequence[float] | FloatArray,
    curves: Mapping[str, FloatArray],
    *,
    x_label: str,
    y_label: str,
    scale: Literal["log", "linear"] = "log",
) -> None:
    """Write a picture of curves (n,), by names that may hold mathematical text, over x (n,)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    for name, curve in curves.items():
        axes.plot(x, curve, "o-", markersize=4, label=name)
    axes.set_xscale(scale)
    axes.set_yscale(scale)
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    figure.legend(loc="outside upper center", ncols=2)
    data = io.BytesIO()
    figure.savefig(data, dpi=150, format=path.suffix.removeprefix(".") or None)
    write_file(path, data.getvalue())
