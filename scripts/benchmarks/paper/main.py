"""Repeat the experiments of the paper, and print the figures beside those of the paper.

    scripts/benchmark paper --data FOLDER --output paper

needs the sets `shrec11`, `tosca` and `mpeg7` in the folder; parts whose set is missing are left out, with a
line of output. Table 5 takes the meshes of SHREC'14 from the folders `shrec14-synthetic` and `shrec14-real`,
and in their absence simulated people; the descriptors in `shrec14_csd` have rows of their own. With --output,
a folder of pictures, CSV files and a page `paper.html` with everything is written, which needs matplotlib, of
the extra `benchmark`. Figures, tables, sections and equations are those of J. Ye and Y. Yu, "A fast modal
space transform for robust nonrigid shape retrieval", The Visual Computer 32 (2016).

By default, in less than five minutes on two cores, table 2 has three sizes of meshes, tables 3 and 4
have linear elements only, table 4 has a third of the background, table 5, figure 4 and figure 5 are made of a
part of their sets, and section 4.4 is without fTetWild. --full takes all, and more than half an hour.
"""

from __future__ import annotations

import argparse
import html
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from threadpoolctl import threadpool_limits

from benchmarks.measuring import add_data, argument_parser, print_lines
from benchmarks.paper.retrieval import retrieval_tables, table_2, table_5
from benchmarks.paper.shapes import figure_1, figure_4, figure_5, section_4_4
from benchmarks.paper.spectra import appendix_a, figure_6, figure_7
from benchmarks.sets import left_out, read_mesh
from pcretrieve.errors import PcretrieveError
from pcretrieve.values import TriangleMesh
from pcretrieve.values.files import write_file

# Meshes of TOSCA that figure 7 and appendix A are repeated on.
SHAPES = ("cat0", "david0", "horse0")

# Numbers of silhouettes of figure 4, and of meshes of figure 5, without --full.
N_SILHOUETTES, N_PERTURBED = 280, 150

PAGE = """<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>The experiments of the paper</title>
<style>body {{ font-family: system-ui, sans-serif; margin: 2rem auto; max-width: 90rem; padding: 0 1rem }}
pre {{ overflow-x: auto }} img {{ max-width: 100% }}</style>
<h1>The experiments of the paper</h1>
<p>J. Ye and Y. Yu, “A fast modal space transform for robust nonrigid shape retrieval”, The Visual Computer 32
(2016), repeated by pcretrieve.</p>
{sections}
</html>
"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argument_parser(__doc__)
    add_data(parser)
    parser.add_argument(
        "--only", choices=PARTS, action="append", help="only this part; may be repeated"
    )
    parser.add_argument(
        "--output", type=Path, help="folder for pictures, CSV files and a page"
    )
    parser.add_argument(
        "--full", action="store_true", help="whole sets, cubic elements, and fTetWild"
    )
    given = parser.parse_args(arguments)
    sections = []
    try:
        if given.output is not None:
            given.output.mkdir(parents=True, exist_ok=True)
        with threadpool_limits(1):
            for part in given.only or PARTS:
                started = time.monotonic()
                lines: list[str] = []
                for line in _lines(part, given):
                    print_lines([line])
                    lines.append(line)
                print_lines([f"({part}: {time.monotonic() - started:.0f} s)", ""])
                sections.append(_section(part, lines, given.output))
        if given.output is not None:
            write_file(
                given.output / "paper.html",
                PAGE.format(sections="\n".join(sections)).encode(),
            )
            print_lines([f"wrote {given.output / 'paper.html'}"])
    except (PcretrieveError, OSError) as error:
        sys.exit(str(error))


def _section(part: str, lines: Sequence[str], output: Path | None) -> str:
    """A part of the page: its lines, and the pictures that it has written."""
    pictures = (
        [] if output is None else sorted(path.name for path in output.glob("*.png"))
    )
    shown = [
        f'<p><img src="{name}" alt="{name}">'
        for name in pictures
        if any(name in line for line in lines)
    ]
    return f"<section id={part}>\n<pre>{html.escape(chr(10).join(lines))}</pre>\n{''.join(shown)}\n</section>"


def _output(given: argparse.Namespace, name: str) -> Path | None:
    return None if given.output is None else given.output / name


def _meshes(given: argparse.Namespace) -> dict[str, TriangleMesh]:
    return {name: read_mesh(given.data / "tosca" / f"{name}.off") for name in SHAPES}


# What prints each part, and the sets that it needs.
PARTS: Mapping[
    str, tuple[Callable[[argparse.Namespace], Iterator[str]], tuple[str, ...]]
] = {
    "figure1": (
        lambda o: figure_1(o.data / "shrec11", _output(o, "figure1.png")),
        ("shrec11",),
    ),
    "table2": (lambda o: table_2(full=o.full), ()),
    "table3": (
        lambda o: retrieval_tables("table3", o.data, o.output, full=o.full),
        ("shrec11",),
    ),
    "table4": (
        lambda o: retrieval_tables("table4", o.data, o.output, full=o.full),
        ("shrec11", "tosca"),
    ),
    "table5": (lambda o: table_5(o.data, full=o.full), ()),
    "figure4": (
        lambda o: figure_4(
            o.data / "mpeg7", _output(o, "figure4.png"), None if o.full else N_SILHOUETTES
        ),
        ("mpeg7",),
    ),
    "figure5": (
        lambda o: figure_5(o.data / "shrec11", None if o.full else N_PERTURBED),
        ("shrec11",),
    ),
    "figure6": (lambda o: figure_6(), ()),
    "figure7": (lambda o: figure_7(_meshes(o), _output(o, "figure7.png")), ("tosca",)),
    "drift": (
        lambda o: section_4_4(_first_poses(o.data / "tosca"), remeshed=o.full),
        ("tosca",),
    ),
    "discrepancy": (lambda o: appendix_a(_meshes(o)), ("tosca",)),
}


def _lines(part: str, given: argparse.Namespace) -> Iterator[str]:
    lines, needed = PARTS[part]
    missing = [line for name in needed if (line := left_out(part, given.data / name))]
    yield from missing[:1] or lines(given)


def _first_poses(folder: Path) -> dict[str, tuple[TriangleMesh, TriangleMesh]]:
    """The first two meshes of each class."""
    files: dict[str, list[Path]] = {}
    for path in sorted(folder.glob("*.off")):
        files.setdefault(path.stem.rstrip("0123456789"), []).append(path)
    return {
        name: (read_mesh(paths[0]), read_mesh(paths[1])) for name, paths in files.items()
    }
