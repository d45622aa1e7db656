"""Print what scans of many kinds of bodies by many sensors are called, whole and damaged.

    scripts/benchmark grades --scans scans --anny bodies --data data       # makes the scans, once
    scripts/benchmark grades --scans scans --run before.jsonl              # examines them, and prints
    scripts/benchmark grades --scans scans --run before.jsonl --leave-out turntable     # only prints

Kinds: people of Anny (bodies: make_people --bodies), animals, hands, bones and parts of machines. Sensors:
nine cameras; uniform points with noise, six holes and strays; one depth camera beside a turntable, with hair
that answers in patches and soles that nobody saw; 10,000 and 200,000 uniform points; nine cameras above the
soles; and clean meshes, which are used as they are. Damages: the end of a limb or the head, a hole of 8 % of
the length, nine tenths of the points on one side, and a second body that is pressed into the first.

Each individual is scanned whole in two poses, or on two sides. The nearest of a scan is looked for among
the whole scans by the same sensor in the other pose, by the default descriptor: in the metric of people, or,
for other kinds, with the whitening that these scans teach. The file of the results has a line of JSON for
each scan: what it was called, its expected error, all checks with outcome, measurement and expected error,
its coordinates, the distance to the signature of the own clean mesh ("error": of the signature by which scans
are judged, "moved": of the default one), and the rank of the own individual. Scans that are in the file are
not examined again: take a new file after a change of the code.
"""

from __future__ import annotations

import argparse
import json
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.bodies import KINDS, Body, Sources
from benchmarks.judging import FAILED, examined, metric_of_people
from benchmarks.measuring import (
    Column,
    Table,
    add_anny,
    add_data,
    all_in_workers,
    argument_parser,
    positive,
    print_lines,
    progress,
)
from benchmarks.sensors import DAMAGES, PAIR, SENSORS, WHOLE, left_by, pressed
from benchmarks.simulation import write_ply
from benchmarks.simulation.samples import moved, random_motion
from pcretrieve.errors import PcretrieveError
from pcretrieve.formats import read_scan, write_mesh
from pcretrieve.ingestion.pool import in_processes
from pcretrieve.options import PipelineOptions
from pcretrieve.retrieval import fit_whitening, people
from pcretrieve.values import FloatArray
from pcretrieve.values.files import write_file

# The sensor that clean meshes stand for; two poses of each individual.
MESH, N_POSES = "mesh", 2

# Kinds by default; those that the metric of people is for.
SOME_KINDS = ("people", "animals", "hands", "bones", "cad")
OF_PEOPLE = ("people", "simulated", "tosca-people")

# Parts of machines have no limbs.
WITHOUT_LIMBS = ("cad",)

Row = dict[str, Any]


def main(arguments: Sequence[str] | None = None) -> None:
    """Make scans, or examine them and print the tables."""
    parser = argument_parser(__doc__)
    add_data(parser)
    add_anny(parser)
    add = parser.add_argument
    add("--scans", type=Path, required=True, metavar="FOLDER", help="where the scans are")
    add(
        "--run",
        type=Path,
        metavar="FILE",
        help="examine the scans; results, as lines of JSON",
    )
    add("--kinds", nargs="+", choices=KINDS, default=SOME_KINDS, metavar="KIND")
    add(
        "--sensors",
        nargs="+",
        choices=(*SENSORS, MESH),
        default=(*SENSORS, MESH),
        metavar="NAME",
    )
    damages = (WHOLE, *DAMAGES, PAIR)
    add("--damages", nargs="+", choices=damages, default=damages, metavar="DAMAGE")
    add(
        "--limit",
        type=positive,
        default=6,
        help="individuals of a kind (default: %(default)s)",
    )
    add(
        "--seed",
        type=int,
        default=0,
        help="seed of bodies and scans (default: %(default)s)",
    )
    add("--leave-out", choices=SENSORS, help="print the figures of this sensor apart")
    add("--workers", type=positive, default=2, help="processes (default: %(default)s)")
    given = parser.parse_args(arguments)
    if given.run is None:
        print_lines(_made(given))
    else:
        print_lines(_ran(given))


# --- scans --------------------------------------------------------------------------------------------------


class Making(NamedTuple):
    """The scans of a body by a sensor: whole, with each damage, and pressed into another body."""

    kind: str
    sensor: str
    body: Body
    pose: int
    other: Body | None
    damages: tuple[str, ...]
    folder: Path
    seed: int

    def __hash__(self) -> int:
        return hash((self.kind, self.sensor, self.body.name))

    def path(self, damage: str) -> Path:
        """The file of a scan."""
        return self.folder / self.kind / self.sensor / damage / f"{self.body.name}.ply"

    def rng(self, *purpose: str) -> np.random.Generator:
        """A generator of its own for each scan."""
        words = " ".join([self.kind, self.sensor, self.body.name, *purpose])
        return np.random.default_rng((self.seed, zlib.crc32(words.encode())))


def _made(given: argparse.Namespace) -> Iterator[str]:
    """Make the scans that are not there, and list them."""
    sources = Sources(given.data, given.anny or given.data / "anny", given.seed)
    for kind in given.kinds:
        everybody = KINDS[kind](sources, given.limit, N_POSES)
        tasks = []
        for number, poses in enumerate(everybody):
            other = everybody[(number + 1) % len(everybody)][-1]
            for sensor in given.sensors:
                for pose, body in enumerate(poses):
                    damages = tuple(_damages(kind, sensor, pose, given.damages))
                    task = (
                        kind,
                        sensor,
                        body,
                        pose,
                        other,
                        damages,
                        given.scans,
                        given.seed,
                    )
                    tasks.append(Making(*task))
        made = all_in_workers(make, tasks, kind, workers=given.workers)
        yield f"{kind}: {len(everybody)} individuals, {sum(map(len, made))} scans in {given.scans}"


def _damages(kind: str, sensor: str, pose: int, chosen: Sequence[str]) -> Iterator[str]:
    """What is made of a body in a pose: damages only of the first one."""
    yield WHOLE
    if sensor == MESH or pose > 0:
        return
    for damage in chosen:
        if damage == WHOLE or (damage == "limb" and kind in WITHOUT_LIMBS):
            continue
        yield damage


def make(task: Making) -> list[Path]:
    """Write the scans of a body that are not there."""
    paths = {damage: task.path(damage) for damage in task.damages}
    missing = [damage for damage, path in paths.items() if not path.exists()]
    if not missing:
        return list(paths.values())
    for path in paths.values():
        path.parent.mkdir(parents=True, exist_ok=True)
    if task.sensor == MESH:
        _write(task, WHOLE, lambda path: write_mesh(task.body.mesh, path))
        return list(paths.values())
    points = SENSORS[task.sensor](task.body, task.rng())
    for damage in missing:
        rng = task.rng(damage)
        if damage == PAIR and task.other is not None:
            both = pressed(task.body, task.other, rng)
            scanned = SENSORS[task.sensor](both, rng)
        else:
            scanned = points[left_by(damage, points, task.body, rng)]
        placed = moved(random_motion(rng), scanned)
        _write(task, damage, partial(write_ply, points=placed))
    return list(paths.values())


def _write(task: Making, damage: str, write: Callable[[Path], Any]) -> None:
    """Write a scan, and beside it what it is of."""
    path = task.path(damage)
    about = {
        "kind": task.kind,
        "sensor": task.sensor,
        "damage": damage,
        "name": task.body.name,
        "label": task.body.label,
        "pose": task.pose,
    }
    write(path)
    write_file(path.with_suffix(".json"), json.dumps(about).encode())


# --- results ------------------------------------------------------------------------------------------------


def _ran(given: argparse.Namespace) -> Iterator[str]:
    """Examine the scans that are not in the file of results, and print what they are called."""
    known = _rows(given.run)
    chosen = [about for about in _abouts(given.scans) if _is_chosen(about, given)]
    missing = [about["file"] for about in chosen if about["file"] not in known]
    about_of = {about["file"]: about for about in chosen}
    files = [given.scans / file for file in missing]
    running = in_processes(examined_file, files, workers=given.workers)
    for file, outcome in progress(running, "scans", len(files)):
        if isinstance(outcome, PcretrieveError):
            outcome = {"word": FAILED, "reasons": (str(outcome),), "checks": {}}
        name = str(file.relative_to(given.scans))
        known[name] = about_of[name] | outcome
        with given.run.open("a", encoding="utf-8") as lines:
            lines.write(json.dumps(known[name]) + "\n")
    rows = [known[file] for file in about_of]
    add_ranks(rows)
    text = "".join(json.dumps(row) + "\n" for row in known.values())
    write_file(given.run, text.encode())
    yield from tables(rows, given.leave_out)


def _rows(path: Path) -> dict[str, Row]:
    """The results of a file, by the files of the scans."""
    if not path.exists():
        return {}
    rows = map(json.loads, path.read_text("utf-8").splitlines())
    return {row["file"]: row for row in rows}


def _abouts(folder: Path) -> list[Row]:
    """What is known of all scans of a folder."""
    found = []
    for path in sorted(folder.glob("*/*/*/*.json")):
        about = json.loads(path.read_text("utf-8"))
        found.append(about | {"file": str(path.with_suffix(".ply").relative_to(folder))})
    return found


def _is_chosen(about: Row, given: argparse.Namespace) -> bool:
    """Whether a scan is to be examined; clean meshes are, because others are compared with them."""
    if about["kind"] not in given.kinds:
        return False
    if about["sensor"] == MESH:
        return True
    return about["sensor"] in given.sensors and about["damage"] in (WHOLE, *given.damages)


def examined_file(path: Path) -> Row:
    """What is found of the scan of a file."""
    return examined(read_scan(path))[0].as_row()


def add_ranks(rows: Sequence[Row]) -> None:
    """Add to each row the rank of the own individual, the nearest one, and distances to the own clean mesh.

    The rank is missing if the scan failed, or all whole scans of the individual in the other pose.
    """
    clean = {(row["kind"], row["name"]): row for row in rows if row["sensor"] == MESH}
    of_people = metric_of_people()
    options = PipelineOptions().signature
    for cell in sorted({(row["kind"], row["sensor"]) for row in rows}):
        here = [
            row
            for row in rows
            if (row["kind"], row["sensor"]) == cell
            and row["damage"] != PAIR
            and row.get("point")
        ]
        whole = [row for row in here if row["damage"] == WHOLE]
        if not whole:
            continue
        metric = of_people
        if cell[0] not in OF_PEOPLE:
            taught = np.array([row["point"] for row in whole])
            metric = fit_whitening("unsupervised", taught, people=people(options))
        places = metric.apply(np.array([row["point"] for row in here]))
        for row, place in zip(here, places, strict=True):
            own = clean.get((row["kind"], row["name"]), {})
            if own.get("point"):
                at = metric.apply(np.array([own["point"]]))[0]
                row["moved"] = float(np.linalg.norm(place - at))
                row["error"] = float(
                    np.linalg.norm(np.subtract(row["judged"], own["judged"]))
                )
            row |= _ranked(row, place, here, places)


def _ranked(row: Row, place: FloatArray, here: Sequence[Row], places: FloatArray) -> Row:
    """The rank of the own individual among whole scans in the other pose, and the nearest individual."""
    nearest: dict[str, float] = {}
    for other, at in zip(here, places, strict=True):
        if other["damage"] == WHOLE and other["pose"] != row["pose"]:
            apart = float(np.linalg.norm(place - at))
            nearest[other["label"]] = min(apart, nearest.get(other["label"], np.inf))
    if row["label"] not in nearest:
        return {"rank": None, "nearest": None}
    own = nearest[row["label"]]
    words = [
        other["word"]
        for other in here
        if other["damage"] == WHOLE
        and other["pose"] != row["pose"]
        and other["label"] == row["label"]
    ]
    return {
        "wanted": words,
        "rank": 1 + sum(apart < own for apart in nearest.values()),
        "nearest": min(nearest, key=lambda label: nearest[label]),
        "own": own,
        "next": min(
            (apart for label, apart in nearest.items() if label != row["label"]),
            default=None,
        ),
    }


# --- tables -------------------------------------------------------------------------------------------------

# Words of grades, in the order of columns; others follow.
WORDS = ("good", "poor", "incomplete", FAILED)

TABLE = Table(
    *(
        Column(title, width, align="<")
        for title, width in (("kind", 12), ("sensor", 10), ("damage", 6))
    ),
    Column("scans", 5, "d"),
    *(Column(word, 10, "d") for word in WORDS),
    Column("right", 7),
    Column("good if right", 13),
    Column("not if wrong", 12),
    *(Column(title, 6, ".2f") for title in ("±", "error")),
    Column("seconds", 7, ".1f"),
    Column("reasons", 1, align="<"),
)


def tables(rows: Sequence[Row], left_out: str | None) -> Iterator[str]:
    """The lines of all cells, and how often what is asked holds."""
    yield TABLE.head
    cells: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        cells.setdefault((row["kind"], row["sensor"], row["damage"]), []).append(row)
    for cell, here in sorted(cells.items(), key=lambda item: _order(item[0])):
        yield TABLE.row(*cell, *_cell(here))
    yield ""
    yield from _asked("all sensors", rows)
    if left_out is not None:
        others = [row for row in rows if row["sensor"] != left_out]
        yield from _asked(f"without {left_out}", others)
        yield from _asked(
            f"{left_out}, left out", [row for row in rows if row["sensor"] == left_out]
        )


def _order(cell: tuple[str, str, str]) -> tuple[int, ...]:
    kind, sensor, damage = cell
    return (
        list(KINDS).index(kind),
        (*SENSORS, MESH).index(sensor),
        (WHOLE, *DAMAGES, PAIR).index(damage),
    )


def _cell(rows: Sequence[Row]) -> tuple[Any, ...]:
    counts = Counter(row["word"] for row in rows)
    ranked = [row for row in rows if row.get("rank") is not None]
    right = [row for row in ranked if row["rank"] == 1]
    wrong = [row for row in ranked if row["rank"] > 1]
    reasons = Counter(
        reason.partition(":")[0] for row in rows for reason in row.get("reasons") or ()
    )
    return (
        len(rows),
        *(counts[word] for word in WORDS),
        _share(right, ranked),
        _share([row for row in right if _is_good(row)], right),
        _share([row for row in wrong if not _is_good(row)], wrong),
        _median(rows, "expected_error"),
        _median(rows, "error"),
        _median(rows, "seconds"),
        ", ".join(f"{reason} {n}" for reason, n in reasons.most_common(4)),
    )


def _is_good(row: Row) -> bool:
    return bool(row["word"] == "good")


def _share(some: Sequence[Row], of: Sequence[Row]) -> str:
    return f"{len(some)}/{len(of)}" if of else "-"


def _median(rows: Sequence[Row], name: str) -> float:
    values = [
        row[name] for row in rows if row.get(name) is not None and row[name] == row[name]
    ]
    return float(np.median(values)) if values else float("nan")


class Asked(NamedTuple):
    """A figure: which scans count, which of them are as asked, and the least shares, of all and of a cell."""

    title: str
    counts: Callable[[Row], bool]
    holds: Callable[[Row], bool]
    share: float
    of_cell: float


def _is_found(row: Row) -> bool:
    """Whether a scan of two bodies is not called one good body."""
    return not _is_good(row)


def _one_body(row: Row) -> bool:
    """Whether a check tells two bodies, or the scan failed because of them."""
    told = any(
        name.startswith("One body") and check["outcome"] != "passed"
        for name, check in row["checks"].items()
    )
    return told or any("two bodies" in reason for reason in row.get("reasons") or ())


def _has(damage: str, row: Row) -> bool:
    return bool(row["damage"] == damage)


def _whole_scan(row: Row) -> bool:
    return bool(row["damage"] == WHOLE and row["sensor"] != MESH)


ASKED = (
    Asked(
        "whole scans whose nearest is right: good",
        lambda row: _whole_scan(row) and row.get("rank") == 1,
        _is_good,
        0.95,
        0.92,
    ),
    Asked("whole scans: good", _whole_scan, _is_good, 0.0, 0.0),
    Asked(
        "whole scans: nearest is right",
        lambda row: _whole_scan(row),
        lambda row: row.get("rank") == 1,
        0.0,
        0.0,
    ),
    Asked(
        "scans whose nearest is wrong: not good",
        lambda row: row["sensor"] != MESH and (row.get("rank") or 1) > 1,
        lambda row: not _is_good(row),
        0.90,
        0.0,
    ),
    # An answer may be wrong because the scan that should have been found is bad.
    Asked(
        "the same, or the scan that was wanted is not",
        lambda row: row["sensor"] != MESH and (row.get("rank") or 1) > 1,
        lambda row: not _is_good(row) or set(row["wanted"]) != {"good"},
        0.90,
        0.0,
    ),
    *(
        Asked(
            f"{damage}: not good",
            partial(_has, damage),
            lambda row: not _is_good(row),
            0.90,
            0.0,
        )
        for damage in DAMAGES
    ),
    Asked("clean meshes: good", lambda row: row["sensor"] == MESH, _is_good, 0.99, 0.0),
    Asked("pairs: found", lambda row: row["damage"] == PAIR, _one_body, 0.90, 0.0),
    Asked("pairs: not good", lambda row: row["damage"] == PAIR, _is_found, 0.0, 0.0),
    Asked(
        "whole scans and meshes: two bodies told",
        lambda row: row["damage"] == WHOLE,
        _one_body,
        0.0,
        0.0,
    ),
)

FIGURES = Table(
    Column("scans of", 22, align="<"),
    Column("figure", 42, align="<"),
    Column("", 9),
    Column("share", 6, ".3f"),
    Column("asked", 6, ".2f"),
    Column("met", 3, align="<"),
    Column("worst cells", 1, align="<"),
)

# Number of cells that are named.
N_WORST = 3


def _asked(title: str, rows: Sequence[Row]) -> Iterator[str]:
    """The figures that are asked, of some scans, and the cells where they are worst."""
    yield FIGURES.head
    for asked in ASKED:
        cells: dict[tuple[str, str], list[bool]] = {}
        for row in rows:
            if asked.counts(row):
                cells.setdefault((row["kind"], row["sensor"]), []).append(
                    asked.holds(row)
                )
        flat = [held for cell in cells.values() for held in cell]
        if not flat:
            continue
        worst = sorted(cells.items(), key=lambda item: np.mean(item[1]))
        is_met = np.mean(flat) >= asked.share and np.mean(worst[0][1]) >= asked.of_cell
        named = ", ".join(
            f"{kind} {sensor} {sum(held)}/{len(held)}"
            for (kind, sensor), held in worst[:N_WORST]
            if np.mean(held) < 1
        )
        yield FIGURES.row(
            title,
            asked.title,
            f"{sum(flat)}/{len(flat)}",
            float(np.mean(flat)),
            asked.share or None,
            "" if not asked.share else "yes" if is_met else "no",
            named,
        )
