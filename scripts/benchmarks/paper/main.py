"""Repeat the experiments of the paper, and print the figures beside those of the paper.

    .venv/bin/python scripts/reproduce_paper --data FOLDER --output paper

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
from collections.abc import Iterator, Mapping, Sequence
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

__all__ = ["main"]

# Meshes of TOSCA that figure 7 and appendix A are repeated on.
SHAPES = ("cat0", "david0", "horse0")

# The sets that each part needs.
PARTS: Mapping[str, tuple[str, ...]] = {
    "figure1": ("shrec11",),
    "table2": (),
    "table3": ("shrec11",),
    "table4": ("shrec11", "tosca"),
    "table5": (),
    "figure4": ("mpeg7",),
    "figure5": ("shrec11",),
    "figure6": (),
    "figure7": ("tosca",),
    "drift": ("tosca",),
    "discrepancy": ("tosca",),
}

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
    parser.add_argument("--only", choices=PARTS, action="append", help="only this part; may be repeated")
    parser.add_argument("--output", type=Path, help="folder for pictures, CSV files and a page")
    parser.add_argument("--full", action="store_true", help="whole sets, cubic elements, and fTetWild")
    given = parser.parse_args(arguments)
    sections = []
    try:
        if given.output is not None:
            given.output.mkdir(parents=True, exist_ok=True)
        with threadpool_limits(1):
            for part in given.only or PARTS:
                started = time.monotonic()
                lines: list[str] = []
                print_lines(_kept(_lines(part, given), lines))
                print_lines([f"({part}: {time.monotonic() - started:.0f} s)", ""])
                sections.append(_section(part, lines, given.output))
        if given.output is not None:
            write_file(given.output / "paper.html", PAGE.format(sections="\n".join(sections)).encode())
            print_lines([f"wrote {given.output / 'paper.html'}"])
    except (PcretrieveError, OSError) as error:
        sys.exit(str(error))


def _kept(lines: Iterator[str], kept: list[str]) -> Iterator[str]:
    """The same lines, which are kept too."""
    for line in lines:
        kept.append(line)
        yield line


def _section(part: str, lines: Sequence[str], output: Path | None) -> str:
    """A part of the page: its lines, and the pictures that it has written."""
    pictures = [] if output is None else sorted(path.name for path in output.glob("*.png"))
    shown = [
        f'<p><img src="{name}" alt="{name}">' for name in pictures if any(name in line for line in lines)
    ]
    return f"<section id={part}>\n<pre>{html.escape(chr(10).join(lines))}</pre>\n{''.join(shown)}\n</section>"


def _lines(part: str, given: argparse.Namespace) -> Iterator[str]:
    data: Path = given.data
    for name in PARTS[part]:
        if missing := left_out(part, data / name):
            yield missing
            return
    if part == "table2":
        yield from table_2(full=given.full)
    elif part in ("table3", "table4"):
        yield from retrieval_tables(part, data, given.output, full=given.full)
    elif part == "table5":
        yield from table_5(data, full=given.full)
    elif part == "figure1":
        yield from figure_1(data / "shrec11", None if given.output is None else given.output / "figure1.png")
    elif part == "figure4":
        strips = None if given.output is None else given.output / "figure4.png"
        yield from figure_4(data / "mpeg7", strips, None if given.full else N_SILHOUETTES)
    elif part == "figure5":
        yield from figure_5(data / "shrec11", None if given.full else N_PERTURBED)
    elif part == "figure6":
        yield from figure_6()
    elif part == "drift":
        yield from section_4_4(_first_poses(data / "tosca"), remeshed=given.full)
    else:
        meshes = {name: read_mesh(data / "tosca" / f"{name}.off") for name in SHAPES}
        if part == "figure7":
            yield from figure_7(meshes, None if given.output is None else given.output / "figure7.png")
        else:
            yield from appendix_a(meshes)


def _first_poses(folder: Path) -> dict[str, tuple[TriangleMesh, TriangleMesh]]:
    """The first two meshes of each class."""
    files: dict[str, list[Path]] = {}
    for path in sorted(folder.glob("*.off")):
        files.setdefault(path.stem.rstrip("0123456789"), []).append(path)
    return {name: (read_mesh(paths[0]), read_mesh(paths[1])) for name, paths in files.items()}
