"""Simulate people of the body model Anny in several poses, and write their raw scans and ``labels.csv``.

With ``--bodies``, the surfaces themselves are written instead, for benchmarks that scan them otherwise.

The shapes are adults of the model's own distribution of age, sex, height, weight, muscle and proportions,
with local changes of limbs, hips, torso, neck, hands, feet and head drawn in addition, because people of one
height and weight still differ. Poses are standing, walking, reaching, sitting and folded, each angle drawn
within the limits of its joint. Nine cameras scan each body. They see no soles, and parts that touch are one.

With ``--sensors``, the sensor of each scan is drawn instead: some cameras, uniform points, a turntable, or
depth steps, with points, noise, holes and unseen places of its own. The angles of the joints are from wider
ranges, poses come more than once, and a quarter of the scans have a damage: the end of a limb, the head or a
patch is missing, or one side is thin. The names of the files and columns of the labels say which. With
``--usual``, poses are as without ``--sensors``, and nothing is damaged.

The model is that of R. Brégier et al., "Human mesh modeling for Anny body", arXiv 2511.03589 (2025); the
package is under the licence Apache 2.0, its shapes under CC0. It is for developers only:

    pip install anny                       # in an environment that has pcretrieve; torch comes with it
    scripts/make_people --out people --people 1000 --seed 1
    scripts/make_people --out many --people 1000 --seed 5 --poses 4 --sensors cameras uniform turntable steps
    pcretrieve ingest people --labels people/labels.csv --catalogue people.sqlite

Each person and each scan has a random generator of its own, so that a run that was interrupted goes on.
"""

from __future__ import annotations

import argparse
import csv
import io
from collections.abc import Iterable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.bodies import Body, sealed, skin_of
from benchmarks.measuring import argument_parser, progress
from benchmarks.sensors import DAMAGES, KINDS, NINE_ABOVE, WHOLE, drawn, left_by
from benchmarks.simulation import scan
from benchmarks.simulation.samples import moved, random_motion, write_ply
from pcretrieve.formats import write_mesh
from pcretrieve.retrieval import Positions
from pcretrieve.values import FloatArray, TriangleMesh
from pcretrieve.values.files import write_file

EPILOG = """example:
  scripts/make_people --out people --people 100 --seed 1
  scripts/make_people --out bodies --people 200 --seed 48 --bodies
"""

POSES = ("stand", "walk", "reach", "sit", "fold")

# Ages of adults, in years of the model.
AGES = (18.0, 80.0)

# Standard deviation of local changes, whose largest value is 1 in the model; and of what left and right
# sides differ by. Chosen by eye: at .5 some bodies look like caricatures.
LOCAL, ASYMMETRY = 0.25, 0.03

# Beginnings of the names of the local changes that are drawn. Those of eyes, lips and nostrils are finer than
# the spacing of the points.
CHANGED = (
    *(
        "upperarm",
        "lowerarm",
        "measure",
        "upperleg",
        "lowerleg",
        "leg-valgus",
        "hip",
        "torso",
        "stomach",
    ),
    *(
        "buttocks",
        "hand",
        "foot",
        "neck",
        "head",
        "chin",
        "cheek",
        "nose-scale",
        "ear-scale",
        "pelvis",
        "bulge",
    ),
)

# How much wider the ranges of angles are for scans by several sensors, and the share of these with a damage.
WIDER, DAMAGED = 1.3, 0.25

# How far the armpit is below the joint of the shoulder, relative to the height.
ARMPIT = 0.04


class People:
    """Bodies of the model, by the number of the person."""

    def __init__(self, seed: int) -> None:
        import torch
        from anny import Anny
        from anny.shape_distribution import SimpleShapeDistribution

        torch.set_num_threads(1)
        self._seed, self._torch = seed, torch
        self._model: Any = Anny(local_changes="default", topology="anny").to(
            dtype=torch.float32
        )
        ages = torch.distributions.Uniform(*map(torch.tensor, AGES))
        self._shapes = SimpleShapeDistribution(self._model, ages)
        self.faces = np.asarray(self._model.faces)

    def poses(self, person: int, number: int) -> list[str]:
        """Different poses of one person, by their names."""
        rng = np.random.default_rng((self._seed, person, 0))
        return [str(name) for name in rng.permutation(POSES)[:number]]

    def body(
        self,
        person: int,
        pose: str,
        *,
        posing: np.random.Generator | None = None,
        width: float = 1.0,
    ) -> TriangleMesh:
        """The surface of a person in a pose, y up, in metres.

        posing: what draws the angles; by default one for the person and the pose.
        width: how much wider than usual the ranges of angles are.
        """
        torch = self._torch
        rng = np.random.default_rng((self._seed, person, 1))
        torch.manual_seed(int(rng.integers(2**31)))
        shape = {name: value.float() for name, value in self._shapes.sample(1)[1].items()}
        local = {
            name: torch.tensor([value]) for name, value in self._changes(rng).items()
        }
        motions = torch.eye(4).repeat(1, self._model.bone_count, 1, 1)
        if posing is None:
            posing = np.random.default_rng((self._seed, person, 2 + POSES.index(pose)))
        for bone, turn in joints(pose, posing, width).items():
            matrix = torch.as_tensor(turn.as_matrix(), dtype=torch.float32)
            motions[0, self._model.bone_labels.index(bone), :3, :3] = matrix
        with torch.no_grad():
            found = self._model(
                pose_parameters=motions,
                phenotype_kwargs=shape,
                local_changes_kwargs=local,
            )
        # Z up, and the face looks along -y.
        x, y, z = found["vertices"][0].double().numpy().T
        return TriangleMesh(np.column_stack([x, z, -y]), self.faces)

    @cached_property
    def _skin(self) -> Positions:
        """The faces of the outer skin."""
        return skin_of(self.body(0, "stand"))

    @cached_property
    def _places(self) -> dict[str, int]:
        """The vertices of the crown and of the armpits."""
        with self._torch.no_grad():
            rest = self._model(
                pose_parameters=self._torch.eye(4).repeat(1, self._model.bone_count, 1, 1)
            )
        vertices, heads = (
            rest[name][0].double().numpy()
            for name in ("rest_vertices", "rest_bone_heads")
        )
        down = ARMPIT * np.ptp(vertices[:, 2]) * np.array([0.0, 0.0, 1.0])
        places = {"crown": int(vertices[:, 2].argmax())}
        for side in "LR":
            shoulder = heads[self._model.bone_labels.index(f"upperarm01.{side}")]
            apart = np.linalg.norm(vertices - (shoulder - down), axis=1)
            places[f"armpit.{side}"] = int(apart.argmin())
        return places

    def scanned(
        self, person: int, number: int, kinds: Sequence[str], *, is_usual: bool
    ) -> tuple[str, str, str, FloatArray]:
        """A scan of a person by a sensor of one of some kinds: its pose, kind, damage and points (n, 3).

        is_usual: whether angles are in the usual ranges, no pose comes twice and nothing is damaged.
        """
        rng = np.random.default_rng((self._seed, person, 100 + number))
        pose, kind = str(rng.choice(POSES)), str(rng.choice(kinds))
        damage = str(rng.choice(DAMAGES)) if rng.random() < DAMAGED else WHOLE
        if is_usual:
            pose, damage = self.poses(person, number + 1)[-1], WHOLE
        width = 1.0 if is_usual else WIDER
        surface = self.body(person, pose, posing=rng, width=width)
        body = Body(
            f"{person}-{number}", str(person), sealed(surface, self._skin), self._places
        )
        points = drawn(kind, body, rng)
        points = points[left_by(damage, points, body, rng)]
        return pose, kind, damage, moved(random_motion(rng), points)

    def _changes(self, rng: np.random.Generator) -> dict[str, float]:
        """Local changes by their names, nearly the same on the left and on the right."""
        changes = {}
        for name in self._model.local_change_labels:
            side, part = (name[:2], name[2:]) if name[:2] in ("l-", "r-") else ("", name)
            if side != "r-" and part.startswith(CHANGED):
                changes[name] = float(np.clip(rng.normal(0, LOCAL), -0.8, 0.8))
                if side:
                    changes[f"r-{part}"] = changes[name] + float(rng.normal(0, ASYMMETRY))
        return changes


def joints(
    pose: str, rng: np.random.Generator, width: float = 1.0
) -> dict[str, Rotation]:
    """Turns of bones about the axes of the room: x to the left of the body, y to its back, z up.

    At rest the arms point down and away from the body by about 45 degrees. All angles are in degrees. Their
    ranges are so much wider about their middles; knees and elbows bend one way only.
    """

    def turn(
        x: float = 0.0, y: float = 0.0, z: float = 0.0, error: float = 0.0
    ) -> Rotation:
        return Rotation.from_euler(
            "xyz", np.array([x, y, z]) + rng.normal(0, width * error, 3), degrees=True
        )

    def between(low: float, high: float) -> float:
        more = (width - 1) * (high - low) / 2
        return float(rng.uniform(low - more, high + more))

    # Of each side: how far the arm is raised, swung ahead and bent, and turned inwards; how far the leg is
    # bent in hip and knee, and spread.
    lowered, ahead, bent, inwards = [-30.0, -30.0], [0.0, 0.0], [12.0, 12.0], 0.0
    hips, knees, spread, bow = [0.0, 0.0], [4.0, 4.0], [2.0, 2.0], 0.0
    if pose == "stand":
        lowered = [-between(20, 34) for _ in lowered]
        spread = [between(-1, 7) for _ in spread]
    elif pose == "walk":
        step = between(15, 35)
        hips, knees = [step, -0.7 * step], [10.0, between(10, 45)]
        ahead, bent = [-step, step], [12.0, between(15, 60)]
    elif pose == "reach":
        reaching = [True, bool(rng.random() < 0.5)]
        lowered = [between(10, 100) if does else -30.0 for does in reaching]
        ahead = [between(0, 60) if does else 0.0 for does in reaching]
    elif pose == "sit":
        thighs, bow = between(75, 95), between(-5, 15)
        hips, knees = [thighs, thighs], [thighs, thighs]
        spread = [between(0, 15) for _ in spread]
        ahead, bent = (
            [between(15, 45), between(15, 45)],
            [between(20, 70), between(20, 70)],
        )
    else:  # fold: arms before the chest, the back bowed, the knees bent
        ahead, bent, inwards, bow = (
            [between(20, 45)] * 2,
            [between(80, 115)] * 2,
            between(20, 45),
            between(0, 35),
        )
        crouch = max(0.0, between(0, 50))
        hips, knees = [0.9 * crouch] * 2, [1.3 * crouch] * 2
    bent, knees = [max(0.0, each) for each in bent], [max(0.0, each) for each in knees]
    turns = {}
    for side, sign, row in (("L", 1, 0), ("R", -1, 1)):
        turns[f"upperarm01.{side}"] = turn(x=-ahead[row], error=3) * turn(
            y=-sign * lowered[row], error=3
        )
        turns[f"lowerarm01.{side}"] = turn(x=-bent[row], error=4) * turn(
            z=-sign * inwards
        )
        turns[f"wrist.{side}"] = turn(error=8)
        turns[f"upperleg01.{side}"] = turn(x=-hips[row], y=-sign * spread[row], error=2)
        turns[f"lowerleg01.{side}"] = turn(x=knees[row] + abs(rng.normal(0, 3)))
        turns[f"foot.{side}"] = turn(x=rng.normal(0, 6))
        curl = abs(rng.normal(10, 12))
        for finger in range(2, 6):
            for part in (1, 2, 3):
                turns[f"finger{finger}-{part}.{side}"] = turn(
                    y=sign * (curl + rng.normal(0, 2))
                )
        turns[f"finger1-1.{side}"] = turn(error=6)
    for number in range(1, 6):
        turns[f"spine0{number}"] = turn(x=bow / 5, error=1.3)
    for bone in ("neck01", "head"):
        turns[bone] = turn(error=5)
    return turns


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the scans of so many people, without those that are there already."""
    parser = argument_parser(__doc__, EPILOG)
    add = parser.add_argument
    add("--out", type=Path, required=True, help="folder to write to")
    add("--people", type=int, default=100, help="number of people (default: %(default)s)")
    add(
        "--first",
        type=int,
        default=0,
        help="number of the first of them (default: %(default)s)",
    )
    add(
        "--poses",
        type=int,
        default=3,
        help="number of scans of each (default: %(default)s)",
    )
    add(
        "--seed",
        type=int,
        default=1,
        help="seed of all random numbers (default: %(default)s)",
    )
    add("--bodies", action="store_true", help="write surfaces, not scans")
    add(
        "--sensors",
        nargs="+",
        choices=KINDS,
        help="draw the sensor of each scan from these, a wider pose and some damages",
    )
    add(
        "--usual",
        action="store_true",
        help="with --sensors: usual poses, each once, and no damages",
    )
    given = parser.parse_args(arguments)
    if given.usual and given.poses > len(POSES):
        parser.error(f"--usual has {len(POSES)} poses, got --poses {given.poses}")
    try:
        people = People(given.seed)
    except ImportError as error:
        parser.error(f"{error}: pip install anny, which installs torch too")
    given.out.mkdir(parents=True, exist_ok=True)
    if given.sensors:
        _write_drawn(people, given)
        return
    rows = [("file", "class")]
    for person in progress(_numbers(given), "people"):
        name = f"person-{given.seed}-{person:05}"
        for pose in people.poses(person, given.poses):
            path = given.out / f"{name}_{pose}.ply"
            rows.append((path.name, name))
            if path.exists():
                continue
            body = people.body(person, pose)
            if given.bodies:
                write_mesh(body, path)
                continue
            rng = np.random.default_rng((given.seed, person, 10 + POSES.index(pose)))
            write_ply(path, moved(random_motion(rng), scan(body, NINE_ABOVE, rng).points))
    _write_table(given.out, rows)


def _numbers(given: argparse.Namespace) -> range:
    """The numbers of the people."""
    return range(given.first, given.first + given.people)


def _write_drawn(people: People, given: argparse.Namespace) -> None:
    """Write scans by sensors that are drawn at random; those that are there are not made again."""
    rows = [("file", "class", "pose", "sensor", "damage")]
    for person in progress(_numbers(given), "people"):
        name = f"person-{given.seed}-{person:05}"
        for number in range(given.poses):
            there = sorted(given.out.glob(f"{name}_{number}_*.ply"))
            if there:
                pose, kind, damage = there[0].stem.split("_")[2:]
            else:
                pose, kind, damage, points = people.scanned(
                    person, number, given.sensors, is_usual=given.usual
                )
            path = given.out / f"{name}_{number}_{pose}_{kind}_{damage}.ply"
            if not there:
                write_ply(path, points)
            rows.append((path.name, name, pose, kind, damage))
    _write_table(given.out, rows)


def _write_table(folder: Path, rows: Iterable[Sequence[str]]) -> None:
    """Write the labels of a folder of scans."""
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows(rows)
    write_file(folder / "labels.csv", text.getvalue().encode())
