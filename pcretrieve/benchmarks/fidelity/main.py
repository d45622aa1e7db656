"""Scan clean meshes virtually, reconstruct them, and print the errors against the clean meshes.

The clean mesh is the ground truth for the normals, the surface and the signature of its scan. Every run
prints the same numbers, except for times, because every scan has a random generator. A scan takes
about 4 seconds, a third of them for the measurements: 13 minutes for the 176 meshes of both sets under one
condition, on one core.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcretrieve.benchmarks.arguments import add_data, argument_parser, positive
from pcretrieve.benchmarks.fidelity.answers import TIMEOUT, answers
from pcretrieve.benchmarks.fidelity.conditions import CONDITIONS, DEFECTS, write_scan
from pcretrieve.benchmarks.fidelity.examination import (
    N_VALUES,
    Examination,
    Signatures,
    clean_signatures,
    examine,
    stacked,
)
from pcretrieve.benchmarks.fidelity.row import (
    NAN,
    TABLE,
    Row,
    append,
    mean,
    median,
    relative_spread,
    retrieval,
)
from pcretrieve.benchmarks.fidelity.textbook import textbook_seconds
from pcretrieve.benchmarks.progress import progress
from pcretrieve.benchmarks.sets import SETS, Item, spread
from pcretrieve.benchmarks.tables import print_lines
from pcretrieve.benchmarks.timing import use_one_core
from pcretrieve.errors import BenchmarkError, InputError, PcretrieveError
from pcretrieve.options import PipelineOptions
from pcretrieve.pipeline.process import signature

__all__ = ["main"]

EPILOG = """example:
  scripts/benchmark_fidelity --set humans --limit 10
  scripts/benchmark_fidelity --conditions typical-uniform harsh-rig --config mine.toml --name mine --csv f.csv

conditions:
  easy|typical|harsh - uniform|rig          points only, uniform or seen by nine cameras
  easy|typical|harsh - uniform|rig-sensors  the same, with the sensor position of each point
  defects                                   the clean mesh with holes, flipped and duplicate faces, and
                                            self-intersections
"""

# Euler characteristic of every mesh of both sets, if its holes are closed.
SPHERE = 2

# Largest number of meshes that --rescans scans repeatedly.
N_RESCANNED = 5


class Scans(NamedTuple):
    """The scans of one set under one condition.

    Attributes
    ----------
    set, condition : str
        Names of the set and the condition.
    items : list of Item
        The clean meshes.
    paths : list of Path
        The scan of each item.
    again : list of lists of Path
        Repeated scans of some items, a list for each of these items.
    timed : list of int
        Positions of the scans for which the textbook pipeline was timed.
    textbook : list of float
        Seconds of the textbook pipeline, for the scans for which it did not fail.
    """

    set: str
    condition: str
    items: list[Item]
    paths: list[Path]
    again: list[list[Path]]
    timed: list[int]
    textbook: list[float]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table.

    Parameters
    ----------
    arguments : sequence of str, optional
        By default the arguments of the command line.
    """
    given = _parser().parse_args(arguments)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = "1"  # for the workers, which have not imported numpy yet
    if given.workers == 1:
        use_one_core()
    try:
        print_lines(_run(given, _configurations(given)))
    except PcretrieveError as error:
        sys.exit(str(error))


def _parser() -> argparse.ArgumentParser:
    parser = argument_parser(__doc__, EPILOG)
    add = parser.add_argument
    add("--set", action="append", choices=SETS, help="one set only; may be repeated (default: all)")
    add_data(parser)
    add(
        "--conditions",
        nargs="+",
        choices=CONDITIONS,
        default=["typical-uniform"],
        metavar="NAME",
        help="see below",
    )
    add("--config", action="append", type=Path, default=[], metavar="TOML|PRESET", help="may be repeated")
    add(
        "--name",
        action="append",
        help="name of a configuration, in the order of --config (default: name of the file)",
    )
    add("--limit", type=positive, metavar="N", help="scan N meshes only, evenly spread over the set")
    add(
        "--rescans",
        type=positive,
        default=0,
        metavar="N",
        help="scan a few meshes N times and print the spread",
    )
    add("--textbook", type=positive, default=0, metavar="K", help="time the textbook pipeline on K scans")
    add("--csv", type=Path, metavar="FILE", help="append the rows to this file")
    add(
        "--workers",
        type=positive,
        default=1,
        metavar="N",
        help="processes; times mean something for one only (default: 1)",
    )
    return parser


def _configurations(given: argparse.Namespace) -> dict[str, PipelineOptions]:
    """Options by name, all with R-BiHDM signatures of one length, which earlier tables have too."""
    loaded = [PipelineOptions.named(name) for name in given.config] or [PipelineOptions()]
    names = given.name or [path.stem for path in given.config] or ["default"]
    if not len(set(names)) == len(names) == len(loaded):
        raise InputError(f"configurations must have distinct names, one for each, got {', '.join(names)}")
    return {
        name: options.changed(signature={"method": "r-bihdm", "n_values": N_VALUES})
        for name, options in zip(names, loaded, strict=True)
    }


def _run(given: argparse.Namespace, configurations: dict[str, PipelineOptions]) -> Iterator[str]:
    """Lines of every set under every condition with every configuration, as soon as they are known."""
    for name in given.set or SETS:
        items = SETS[name](given.data, given.limit)
        truths = {
            label: _truth(name, items, options, given.workers) for label, options in configurations.items()
        }
        yield f"{name}:"
        yield TABLE.head
        for condition in given.conditions:
            with tempfile.TemporaryDirectory() as folder:
                scans = _scanned(name, items, condition, given, Path(folder))
                for label, options in configurations.items():
                    row = _row(scans, label, options, truths[label], given.workers)
                    yield from row.lines()
                    if given.csv:
                        append(given.csv, row)


def _truth(name: str, items: list[Item], options: PipelineOptions, workers: int) -> Signatures:
    """Signatures of the clean meshes of a set."""
    arguments = [(item.mesh, options) for item in items]
    signed = answers(f"{name}: clean meshes", clean_signatures, arguments, workers=workers)
    done = [one for one in signed if one]
    if len(done) < len(signed):
        raise BenchmarkError(
            f"every clean mesh of {name} must have a signature, got none of {len(signed) - len(done)}"
        )
    return stacked(done)


def _scanned(name: str, items: list[Item], condition: str, given: argparse.Namespace, folder: Path) -> Scans:
    """Scan every mesh of a set, scan some of them repeatedly, and time the textbook pipeline on some."""
    title = f"{name} {condition}"
    paths = [
        write_scan(folder / item.name, item.mesh, condition, np.random.default_rng(item.number))
        for item in progress(items, f"{title}: scanning")
    ]
    again = [
        [
            write_scan(
                folder / f"{item.name}-{take}",
                item.mesh,
                condition,
                np.random.default_rng((item.number, take)),
            )
            # From 1, because the seed (n, 0) is equivalent to n, the seed of the first scan.
            for take in range(1, given.rescans + 1)
        ]
        for _, item in progress(spread(items, N_RESCANNED), f"{title}: scanning again")
    ]
    # The textbook pipeline begins with points, which a damaged mesh does not have.
    timed = [] if condition == DEFECTS else [k for k, _ in spread(paths, given.textbook)]
    arguments = [(paths[k], TIMEOUT) for k in timed]
    seconds = answers(f"{title}: textbook", textbook_seconds, arguments, workers=1)
    return Scans(name, condition, items, paths, again, timed, [s for s in seconds if s is not None])


def _row(scans: Scans, name: str, options: PipelineOptions, truth: Signatures, workers: int) -> Row:
    """Run one configuration on the scans of one condition; `truth` has the clean signatures."""
    title, n = f"{scans.set} {scans.condition} {name}", len(scans.items)
    arguments = [(path, item.mesh, options) for path, item in zip(scans.paths, scans.items, strict=True)]
    examined: list[Examination | None] = answers(title, examine, arguments, workers=workers)
    again = [(path, options) for own in scans.again for path in own]
    signed = iter(answers(f"{title} again", signature, again, workers=workers))
    repeats = [[one.values for _ in own if (one := next(signed))] for own in scans.again]
    rows = [k for k, answer in enumerate(examined) if answer]
    done = [answer for answer in examined if answer]
    found = stacked([answer.signatures for answer in done])
    errors = np.linalg.norm(np.log(found.relative / truth.relative[rows]), axis=1).tolist()
    stages = dict.fromkeys(stage for answer in done for stage in answer.stages)
    textbook = median(scans.textbook)
    clean = retrieval(truth, scans.items, range(n), options)._asdict()
    return Row(
        set=scans.set,
        condition=scans.condition,
        name=name,
        digest=options.digest,
        scans=n,
        failed=n - len(done),
        normals_right=mean(answer.normals for answer in done if answer.normals is not None),
        closed=sum(answer.closed for answer in done) / n,
        euler_right=sum(answer.euler == SPHERE for answer in done) / n,
        distance_mean=median(answer.mean for answer in done),
        distance_hausdorff=median(answer.hausdorff for answer in done),
        log_error_median=median(errors),
        log_error_mean=mean(errors),
        **retrieval(found, scans.items, rows, options)._asdict(),
        **{f"clean_{measure}": value for measure, value in clean.items()},
        seconds=median(answer.seconds for answer in done),
        processor_seconds=median(answer.processor for answer in done),
        stages=json.dumps({s: round(median(a.stages.get(s, 0.0) for a in done), 4) for s in stages}),
        peak_mib=max((answer.peak for answer in done), default=NAN),
        rescan_spread=relative_spread(repeats, found.values, [scans.items[k].label for k in rows]),
        textbook_seconds=textbook,
        textbook_ratio=textbook / median(a.seconds for k in scans.timed if (a := examined[k])),
    )
