"""Make people, ingest their scans, and learn the metric that the package ships, by one command.

    pip install anny                       # in an environment that has pcretrieve; torch comes with it
    scripts/benchmark learn people         # two to three hours on two cores, and 3 GB

Some people are in wider poses, and a quarter of their scans have a damage; others are in usual poses, and
nothing is damaged; the last are scanned by nine cameras. Coarser meshes of some of these teach, too, and
limbs that people of another model lack, and breath and hair of others: see `scripts/benchmark people`, which
learns, and writes pcretrieve/retrieval/people.npz.

Scans that were made, and ingested, are not made again: a run that was interrupted goes on.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks import people, recognition
from benchmarks.measuring import argument_parser
from benchmarks.recognition import HAIRED_POSES, N_HAIRED
from pcretrieve.values.files import write_file

# Sensors are drawn from these, for some people without cameras: there were fewest of the others.
ALL = ("--sensors", "cameras", "uniform", "turntable", "steps")
NO_CAMERAS = ("--sensors", "uniform", "turntable", "steps")

# Number of people of another model who teach what a missing limb changes.
N_LIMBLESS = 100

# The descriptor that takes the time is computed while scans are ingested, which uses all cores.
CONFIG = '[signature]\nmethod = "hapt"\nn_values = 59\n'


class Group(NamedTuple):
    """People that one call of make_people makes: the seed, how many, scans of each, and other options."""

    seed: int
    people: int
    poses: int
    options: tuple[str, ...] = ()
    first: int = 0

    @property
    def name(self) -> str:
        return f"people-{self.seed}-{self.first}"

    def arguments(self, folder: Path) -> list[str]:
        """The arguments of make_people."""
        numbers = {
            "--people": self.people,
            "--poses": self.poses,
            "--seed": self.seed,
            "--first": self.first,
        }
        words = [str(word) for pair in numbers.items() for word in pair]
        return ["--out", str(folder / self.name), *words, *self.options]


# Those of whom coarser meshes teach; those of whom breath and hair do, who are not scanned; and all who are.
COARSER = Group(1, 150, 3)
HAIRED = Group(91, N_HAIRED, HAIRED_POSES, ("--bodies",))
GROUPS = (
    Group(71, 300, 4, ALL),
    Group(72, 249, 4, ALL),
    *(Group(seed, 175, 3, (*ALL, "--usual")) for seed in range(81, 87)),
    *(Group(seed, 175, 3, (*NO_CAMERAS, "--usual")) for seed in (87, 88)),
    COARSER,
    Group(1, 204, 3, first=150),
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Make the scans, ingest them, and learn."""
    parser = argument_parser(__doc__)
    parser.add_argument("folder", type=Path, help="folder of scans and catalogues")
    folder = parser.parse_args(arguments).folder
    folder.mkdir(parents=True, exist_ok=True)
    config = folder / "hapt.toml"
    write_file(config, CONFIG.encode())
    for group in GROUPS:
        people.main(group.arguments(folder))
        scans = folder / group.name
        ingest = ["ingest", scans, "--labels", scans / "labels.csv", "--config", config]
        ingest += ["--catalogue", catalogue_of(group, folder)]
        subprocess.run(
            [sys.executable, "-m", "pcretrieve", *map(str, ingest)], check=True
        )
    catalogues = [str(catalogue_of(group, folder)) for group in GROUPS]
    coarser = ["--coarser", str(catalogue_of(COARSER, folder))]
    limbless = ["--limbless", str(N_LIMBLESS)]
    people.main(HAIRED.arguments(folder))
    haired = ["--haired", str(folder / HAIRED.name)]
    recognition.main([*catalogues, "--learn", *coarser, *limbless, *haired])


def catalogue_of(group: Group, folder: Path) -> Path:
    """The catalogue of the scans of some people."""
    return folder / f"{group.name}.sqlite"
