"""Repeat the experiments of the paper on its own descriptor, and print the figures beside those of the paper.

    .venv/bin/python scripts/reproduce_paper --data FOLDER --plot figure7.png

needs the set `tosca` in the folder for all but figure 6, and matplotlib, from the extra `benchmark`, for
`--plot`. Figures, sections and equations are those of J. Ye and Y. Yu, "A fast modal space transform for
robust nonrigid shape retrieval", The Visual Computer 32 (2016). About 4 minutes on a 2.5 GHz Xeon, most of
them in fTetWild.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from threadpoolctl import threadpool_limits

from pcretrieve.benchmarks.arguments import add_data, argument_parser
from pcretrieve.benchmarks.paper.appendix_a import appendix_a
from pcretrieve.benchmarks.paper.figure_6 import figure_6
from pcretrieve.benchmarks.paper.figure_7 import figure_7
from pcretrieve.benchmarks.paper.section_4_4 import section_4_4
from pcretrieve.benchmarks.sets import left_out, read_mesh
from pcretrieve.benchmarks.tables import print_lines
from pcretrieve.errors import PcretrieveError
from pcretrieve.types import TriangleMesh

__all__ = ["main"]

# Meshes of TOSCA that figure 7 and appendix A are repeated on.
SHAPES = ("cat0", "david0", "horse0")

PARTS = ("figure6", "figure7", "drift", "discrepancy")


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables.

    Parameters
    ----------
    arguments : sequence of str, optional
        By default the arguments of the command line.
    """
    parser = argument_parser(__doc__)
    add_data(parser)
    parser.add_argument("--only", choices=PARTS, action="append", help="only this part; may be repeated")
    parser.add_argument("--plot", type=Path, help="picture of figure 7 to write, such as figure7.png")
    given = parser.parse_args(arguments)
    try:
        with threadpool_limits(1):
            print_lines(_lines(given.data / "tosca", given.only or PARTS, given.plot))
    except PcretrieveError as error:
        sys.exit(str(error))


def _lines(folder: Path, parts: Sequence[str], plot: Path | None) -> Iterator[str]:
    for part in parts:
        if part == "figure6":
            yield from figure_6()
        elif missing := left_out(part, folder):
            yield missing
        elif part == "drift":
            yield from section_4_4(_first_poses(folder))
        else:
            meshes = {name: read_mesh(folder / f"{name}.off") for name in SHAPES}
            yield from figure_7(meshes, plot) if part == "figure7" else appendix_a(meshes)


def _first_poses(folder: Path) -> dict[str, tuple[TriangleMesh, TriangleMesh]]:
    """The first two meshes of each class."""
    files: dict[str, list[Path]] = {}
    for path in sorted(folder.glob("*.off")):
        files.setdefault(path.stem.rstrip("0123456789"), []).append(path)
    return {name: (read_mesh(paths[0]), read_mesh(paths[1])) for name, paths in files.items()}
