"""Print how far the signature moves if a scan of a person has one hole, by its place and its radius.

    scripts/benchmark holes --people people --anny bodies        # bodies: make_people --bodies
    scripts/benchmark holes --people simulated --limit 4 --places crown shin --radii 3 4
    scripts/benchmark holes --people tosca-people --output holes --worst 4

Each person is scanned whole, by uniform points with noise, and again with all points but those in a ball,
of which the radius is relative to the diagonal. "moved" is the distance of the default signatures of both
scans in the metric of people, median and largest; it is compared with the distance of two poses of a person,
and of the nearest other person. "area" is that of the surface relative to the surface of the whole scan,
median and largest. "right" is how often the nearest of whole scans of all people in another pose is of the
same person. "seconds" are of processor time for a scan. A mark at the end names what is asked and missed:
m the median, l the largest move, a the area, r the right person, f a scan that failed.

Without soles, the box of the points is another one, and so is the grid. The row "again" tells how far other
points and other noise move the signature of a whole scan, and a line for each person stands below it: what
soles add to that is the root of the difference of the squares, as if both were independent.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from benchmarks.bodies import KINDS, PLACES, Body, Sources, neighbourhood
from benchmarks.judging import FAILED, Examined, examined, metric_of_people
from benchmarks.measuring import (
    Column,
    Table,
    add_anny,
    add_data,
    all_in_workers,
    argument_parser,
    png,
    positive,
    print_lines,
)
from benchmarks.sensors import noisy, outer_points
from benchmarks.simulation import write_ply
from pcretrieve.draw import pictures
from pcretrieve.formats import write_mesh
from pcretrieve.values import FloatArray, PointCloud, TriangleMesh
from pcretrieve.values.files import write_file

OF_PEOPLE = ("people", "simulated", "tosca-people")
RADII = (1.0, 2.0, 3.0, 4.0, 6.0)

# The place where no ball is cut out, but all that is near the ground; beside it, the body is scanned again
# whole, by other points.
SOLES = "soles"
AGAIN = "again"

TABLE = Table(
    Column("people", 12, align="<"),
    Column("hole at", 8, align="<"),
    Column("radius/%", 8, "g"),
    Column("scans", 5, "d"),
    *(Column(title, 7, ".2f") for title in ("moved", "largest")),
    *(Column(title, 7, ".3f") for title in ("area", "largest")),
    Column("right", 7),
    Column("seconds", 7, ".1f"),
    Column("words", 36, align="<"),
    Column("missed", 1, align="<"),
)

# What is asked: the largest median move relative to the distance of two poses, up to a radius of 4 %, and
# beyond; the radius up to which no move may reach the nearest other person; the largest area.
SMALL, LARGE, UP_TO, LARGEST_AREA = 0.5, 1.0, 4.0, 1.03


class Task(NamedTuple):
    """A scan: a body, a hole or none, the number of points, and where the scan and surface are written."""

    body: Body
    seed: int
    place: str
    radius: float
    n_points: int
    output: Path | None

    def __hash__(self) -> int:
        return hash((self.body.name, self.place, self.radius))

    @property
    def name(self) -> str:
        """The name of the scan."""
        return f"{self.body.name}_{self.place or 'whole'}{self.radius:g}".removesuffix(
            "0"
        )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argument_parser(__doc__)
    add_data(parser)
    add_anny(parser)
    add = parser.add_argument
    add(
        "--people",
        nargs="+",
        choices=OF_PEOPLE,
        default=["simulated"],
        help="kinds of people",
    )
    add(
        "--limit",
        type=positive,
        default=8,
        help="people of each kind (default: %(default)s)",
    )
    add(
        "--places",
        nargs="+",
        choices=(*PLACES, SOLES),
        default=list(PLACES),
        metavar="PLACE",
        help="of holes; soles: the radius is the height below which nothing is seen, in "
        "percent of that of the body",
    )
    add(
        "--radii",
        nargs="+",
        type=float,
        default=RADII,
        metavar="PERCENT",
        help="of the diagonal",
    )
    add(
        "--points", type=positive, default=40_000, help="of a scan (default: %(default)s)"
    )
    add(
        "--seed",
        type=int,
        default=0,
        help="seed of people and points (default: %(default)s)",
    )
    add("--workers", type=positive, default=2, help="processes (default: %(default)s)")
    add(
        "--output",
        type=Path,
        metavar="FOLDER",
        help="write scans, surfaces and rows.jsonl here",
    )
    add(
        "--worst",
        type=int,
        default=0,
        metavar="N",
        help="draw the worst scans, into --output",
    )
    given = parser.parse_args(arguments)
    if given.worst and given.output is None:
        parser.error("--worst draws into the folder --output: name one")
    print_lines(_lines(given))


def _lines(given: argparse.Namespace) -> Iterator[str]:
    yield TABLE.head
    for kind in given.people:
        yield from _of_kind(kind, given)


def _of_kind(kind: str, given: argparse.Namespace) -> Iterator[str]:
    sources = Sources(given.data, given.anny or given.data / "anny", given.seed)
    everybody = KINDS[kind](sources, given.limit, 2)
    output = None if given.output is None else given.output / kind
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
    whole = [
        Task(pose, given.seed, "", 0.0, given.points, output)
        for two in everybody
        for pose in two
    ]
    cut = [
        Task(two[0], given.seed, place, radius, given.points, output)
        for place in given.places
        for radius in given.radii
        for two in everybody
    ]
    if SOLES in given.places:
        cut += [
            Task(two[0], given.seed + 1, AGAIN, 0.0, given.points, output)
            for two in everybody
        ]
    found = all_in_workers(scanned, whole + cut, kind, workers=given.workers)
    metric = metric_of_people()
    places = [_placed(one, metric) for one in found]
    first, gallery = (
        np.array(places[: len(whole) : 2]),
        np.array(places[1 : len(whole) : 2]),
    )
    between = np.linalg.norm(first[:, np.newaxis] - gallery, axis=2)  # (n, n)
    poses = float(np.nanmedian(np.diag(between)))
    others = float(
        np.nanmedian(np.where(np.eye(len(between)), np.inf, between).min(axis=1))
    )
    n_right = int((between.argmin(axis=1) == np.arange(len(between))).sum())
    yield (
        f"{kind}: two poses of a person are {poses:.1f} apart, the nearest other person {others:.1f}; "
        f"of the whole scans {n_right} of {len(everybody)} are right"
    )
    rows: list[dict[str, Any]] = []
    n = len(everybody)
    for start in range(0, len(cut), n):
        row = []
        for k in range(n):
            task, one = cut[start + k], found[len(whole) + start + k]
            place = places[len(whole) + start + k]
            apart = np.linalg.norm(gallery - place, axis=1)
            row.append(
                {
                    **one.as_row(),
                    "scan": task.name,
                    "person": task.body.label,
                    "place": task.place,
                    "radius": task.radius,
                    "moved": float(np.linalg.norm(place - first[k])),
                    "area": one.area / found[2 * k].area,
                    "own": float(apart[k]),
                    "rank": int((apart < apart[k]).sum()) + 1
                    if one.word != FAILED
                    else n,
                }
            )
        rows += row
        yield TABLE.row(kind, *_cell(row, poses, others))
    yield from _beside_noise(rows)
    if output is not None:
        lines = [json.dumps(row) for row in rows]
        write_file(output / "rows.jsonl", ("\n".join(lines) + "\n").encode())
        by_move = sorted(
            zip(rows, cut, strict=True), key=lambda pair: -_sortable(pair[0]["moved"])
        )
        for worst, task in by_move[: given.worst]:
            yield f"    {worst['scan']}: moved {worst['moved']:.2f}, {_drawn(task)}"


def _beside_noise(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """How far each person moves without soles, beside how far another whole scan moves."""
    again = {row["person"]: row["moved"] for row in rows if row["place"] == AGAIN}
    added: list[float] = []
    for row in rows:
        if row["place"] != SOLES:
            continue
        moved, noise = row["moved"], again[row["person"]]
        added.append(float(np.sqrt(max(moved**2 - noise**2, 0.0))))
        yield (
            f"    {row['person']}: without soles {moved:.2f}, another whole scan {noise:.2f}, "
            f"soles add {added[-1]:.2f}"
        )
    if added:
        yield f"    soles add {np.median(added):.2f} (median), {max(added):.2f} (largest)"


def _sortable(value: float) -> float:
    return np.inf if value != value else value


def _placed(one: Examined, metric: Any) -> FloatArray:
    """The default signature in the metric of people; not a number if the scan failed."""
    if one.word == FAILED:
        return np.full(len(metric.mean), np.nan)
    return np.asarray(metric.apply(np.array([one.point]))[0])


def _cell(row: list[dict[str, Any]], poses: float, others: float) -> tuple[Any, ...]:
    """What is printed of all scans with one hole."""
    made = [one for one in row if one["word"] != FAILED]
    moves, areas = ([one[name] for one in made] or [np.nan] for name in ("moved", "area"))
    n_right = sum(one["rank"] == 1 for one in row)
    radius = row[0]["radius"]
    asked = {
        "m": np.median(moves) <= (SMALL if radius <= UP_TO else LARGE) * poses,
        "l": radius > UP_TO or max(moves) < others,
        "a": max(areas) <= LARGEST_AREA,
        "r": n_right == len(row),
        "f": len(made) == len(row),
    }
    counts = Counter(one["word"] for one in row)
    return (
        row[0]["place"],
        radius,
        len(row),
        float(np.median(moves)),
        max(moves),
        float(np.median(areas)),
        max(areas),
        f"{n_right}/{len(row)}",
        float(np.median([one["seconds"] for one in row])),
        ", ".join(f"{word} {count}" for word, count in counts.most_common()),
        "".join(mark for mark, is_met in asked.items() if not is_met),
    )


# --- scans --------------------------------------------------------------------------------------------------


def cloud_of(task: Task) -> PointCloud:
    """The scan: the same points for all holes of a body."""
    body, mesh = task.body, task.body.mesh
    rng = np.random.default_rng((task.seed, *body.name.encode()))
    points, faces = outer_points(mesh, task.n_points, rng)
    measured = noisy(mesh, points, rng)
    if task.place == SOLES:
        height = mesh.vertices[:, 1] - mesh.vertices[:, 1].min()
        lowest = mesh.vertices[:, 1].min() + task.radius / 100 * height.max()
        measured = measured[points[:, 1] > lowest]
    elif task.radius:
        centre, radius = body.places[task.place], task.radius / 100 * mesh.diagonal
        # The corners of a face of which a part is in the ball are at most an edge outside.
        longest = np.linalg.norm(np.diff(mesh.vertices[mesh.faces], axis=1), axis=2).max()
        near = neighbourhood(mesh, centre, radius + longest)
        gone = near[mesh.faces[faces]].any(axis=1)
        gone &= np.linalg.norm(points - mesh.vertices[centre], axis=1) < radius
        measured = measured[~gone]
    return PointCloud(measured)


def scanned(task: Task) -> Examined:
    """Scan a body, and examine the scan; both are written if there is a folder."""
    cloud = cloud_of(task)
    found, surface = examined(cloud)
    if task.output is not None:
        write_ply(task.output / f"{task.name}.ply", cloud.points)
        if surface is not None:
            write_mesh(surface, task.output / f"{task.name}_surface.ply")
    return found


def _drawn(task: Task) -> Path:
    """Draw the points of a scan, in the first row, and its surface, in the second."""
    from benchmarks.sets import read_mesh

    if task.output is None:
        raise TypeError("pictures must have a folder")
    cloud = cloud_of(task)
    file = task.output / f"{task.name}_surface.ply"
    surface = read_mesh(file) if file.exists() else None
    path = task.output / f"{task.name}.png"
    write_file(path, png(contact_sheet(cloud, surface)))
    return path


PIXELS = 400


def contact_sheet(cloud: PointCloud, surface: TriangleMesh | None) -> Image.Image:
    """Points from four sides, and the surface below them; y is up."""
    cameras = pictures.cameras_around(cloud.points, np.eye(3))
    sheet = Image.new("RGB", (PIXELS * len(cameras), PIXELS * 2), "white")
    for column, camera in enumerate(cameras):
        width = 2 * camera.half / np.sqrt(len(cloud.points))
        picture = pictures.depth_picture(
            cloud.points, pictures.CLAY, camera, width=width, size=PIXELS
        )
        sheet.paste(picture, (PIXELS * column, 0), picture)
        if surface is not None:
            colours = np.tile(pictures.CLAY, (len(surface.faces), 1))
            picture = pictures.surface_picture(
                surface.vertices, surface.faces, colours, camera, size=PIXELS
            )
            sheet.paste(picture, (PIXELS * column, PIXELS), picture)
    return sheet
