"""Print how many whole and damaged scans are called good or incomplete.

Simulated people and the meshes of TOSCA are scanned by nine cameras. Of each scan there are copies without a
lower limb or the head, with a hole of 8 % of the height, and with a tenth of the points on one side. "error"
is the median distance of the log-signature (r-bihdm, L = 23) to that of the clean mesh; the most frequent
reasons follow.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.bodies import Body
from benchmarks.judging import FAILED, examined
from benchmarks.measuring import (
    Column,
    Table,
    add_data,
    all_in_workers,
    argument_parser,
    print_lines,
)
from benchmarks.sensors import WHOLE, left_by
from benchmarks.sets import SETS, Item, left_out
from pcretrieve.options import PipelineOptions
from pcretrieve.simulation import RigOptions, scan
from pcretrieve.values import PointCloud

# Conditions as they are printed, and the damages that they stand for.
CONDITIONS = {"whole": WHOLE, "no limb": "limb", "hole": "hole", "density 10 : 1": "side"}

TABLE = Table(
    Column("set", 8, align="<"),
    Column("condition", 15, align="<"),
    *(Column(title, 10, "d") for title in ("scans", "good", "incomplete", "failed")),
    Column("error", 6, ".2f"),
    Column("reasons", 1, align="<"),
)


class Judged(NamedTuple):
    """What is found of one scan: of each check by its name, the measurement and the expected error."""

    condition: str
    judgement: str
    error: float
    reasons: tuple[str, ...]
    checks: dict[str, tuple[float | None, float]]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argument_parser(__doc__)
    add_data(parser)
    parser.add_argument(
        "--limit", type=int, default=20, help="bodies of each set (default: %(default)s)"
    )
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help="write what was found of each scan"
    )
    given = parser.parse_args(arguments)
    print_lines(_lines(given.data, given.limit, given.json))


def _lines(data: Path, limit: int, file: Path | None) -> Iterator[str]:
    yield TABLE.head
    everything: dict[str, Any] = {}
    for name, items in SETS.items():
        if name == "tosca" and (missing := left_out(name, data / name)):
            yield missing
            continue
        tasks = [Task(item, condition) for item in items(data, limit) for condition in CONDITIONS]
        found = all_in_workers(judged, tasks, name)
        everything[name] = [one._asdict() for one in found]
        for condition in CONDITIONS:
            here = [one for one in found if one.condition == condition]
            counts = Counter(one.judgement for one in here)
            named = Counter(reason.partition(":")[0] for one in here for reason in one.reasons)
            shown = ", ".join(f"{reason} {n}" for reason, n in named.most_common(4))
            errors = [one.error for one in here if one.error == one.error]
            numbers = (counts["good"], counts["incomplete"], counts["failed"])
            yield TABLE.row(name, condition, len(here), *numbers, float(np.median(errors)), shown)
    if file is not None:
        file.write_text(json.dumps(everything, indent=1))


class Task(NamedTuple):
    """A body, and what is done to its scan."""

    item: Item
    condition: str

    def __hash__(self) -> int:
        return hash((self.item.name, self.condition))


def judged(task: Task) -> Judged:
    """Scan a body, damage the scan, and judge it."""
    item, condition = task
    rng = np.random.default_rng((item.number, list(CONDITIONS).index(condition)))
    points = scan(item.mesh, RigOptions(), rng).points
    body = Body(item.name, item.label, item.mesh)
    kept = left_by(CONDITIONS[condition], points, body, rng)
    found, _ = examined(PointCloud(points[kept]))
    whole, _ = examined(item.mesh, PipelineOptions().changed(surface={"mode": "keep"}))
    if found.word == FAILED:
        return Judged(condition, FAILED, float("nan"), found.reasons, {})
    error = float(np.linalg.norm(np.subtract(found.judged, whole.judged)))
    values = {name: (check["value"], check["error"]) for name, check in found.checks.items()}
    return Judged(condition, found.word, error, found.reasons, values)
