"""Published sets by name → the class of each scan, from the names and folders of its files.

A layout says where a set, as its authors publish it, has the classes: in the names of the files, or in a
label file beside them. Label files are looked for in the folder of the scans, and in the two folders above.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from pcretrieve.errors import BenchmarkError, InputError
from pcretrieve.formats import split_member
from pcretrieve.ingestion.discover import discover
from pcretrieve.ingestion.labels import match_labels, read_labels

__all__ = ["LAYOUTS", "Layout", "discover_labelled", "labels_of"]

logger = logging.getLogger(__name__)

# Number of folders in which a label file is looked for: that of the scans, and those above it.
N_FOLDERS = 3

# Number of poses of each person in FAUST, whose files are numbered person after person.
POSES_OF_FAUST = 10


@dataclass(frozen=True, slots=True)
class Layout:
    """How a set names the classes of its shapes."""

    name: str
    class_of: Callable[[Path], str | None] | None = None
    label_files: tuple[str, ...] = ()
    n_shapes: int = 0
    n_classes: int = 0
    protocol: str = ""
    published: str = ""


def _before_number(path: Path) -> str | None:
    """The name of a file without the number at its end: ``cat`` for ``cat10.off``."""
    found = re.fullmatch(r"(.*\D)\d+", path.stem)
    return found[1] if found else None


def _person(path: Path) -> str | None:
    """The person of FAUST: ``person1`` for ``tr_scan_012.ply`` and ``tr_reg_012.ply``."""
    found = re.fullmatch(r"tr_(?:scan|reg)_(\d{3})", path.stem)
    return f"person{int(found[1]) // POSES_OF_FAUST}" if found else None


def _folder(path: Path) -> str | None:
    return path.parent.name or None


ALL_QUERIES = "each shape is a query in all others"
CARDIFF = "http://www.cs.cf.ac.uk/shaperetrieval/shrec14/"
BESIDE = ("test.cla", "labels.csv")

#: The layouts by name.
LAYOUTS: Mapping[str, Layout] = MappingProxyType(
    {
        layout.name: layout
        for layout in (
            Layout(
                "shrec11",
                label_files=BESIDE,
                n_shapes=600,
                n_classes=30,
                protocol=f"{ALL_QUERIES}, 20 of each class; watertight meshes, --surface keep",
                published="https://www.itl.nist.gov/iad/vug/sharp/contest/2011/NonRigid/",
            ),
            Layout(
                "shrec14-real",
                label_files=BESIDE,
                n_shapes=400,
                n_classes=40,
                protocol=f"{ALL_QUERIES}, 40 people in 10 poses; --surface keep",
                published=CARDIFF,
            ),
            Layout(
                "shrec14-synthetic",
                label_files=BESIDE,
                n_shapes=300,
                n_classes=15,
                protocol=f"{ALL_QUERIES}, 15 people in 20 poses; --surface keep",
                published=CARDIFF,
            ),
            Layout(
                "faust",
                class_of=_person,
                n_shapes=100,
                n_classes=10,
                protocol=f"{ALL_QUERIES}, 10 people in 10 poses: the training scans, or their registrations",
                published="https://faust-leaderboard.is.tuebingen.mpg.de/",
            ),
            Layout(
                "tosca",
                class_of=_before_number,
                n_shapes=80,
                n_classes=9,
                protocol=f"{ALL_QUERIES}; high-resolution meshes, some of which are open",
                published="http://tosca.cs.technion.ac.il/book/resources_data.html",
            ),
            Layout(
                "psb",
                label_files=("*.cla",),
                protocol=f"{ALL_QUERIES}; 907 models of the base classification, for training or for test",
                published="https://shape.cs.princeton.edu/benchmark/",
            ),
            Layout("folders", class_of=_folder, protocol=f"{ALL_QUERIES}; the class is the folder"),
            Layout(
                "csv",
                label_files=("labels.csv",),
                protocol=f"{ALL_QUERIES}; the classes are in labels.csv beside the scans",
            ),
        )
    }
)


def discover_labelled(
    arguments: Sequence[str | Path], labels: str | Path | None, beside: Iterable[str | Path] = ()
) -> tuple[list[Path], dict[str, str]]:
    """Find the files of scans, and their classes."""
    layout = LAYOUTS.get(str(labels))
    files = [*beside]
    if layout is not None:
        folders = [Path(argument) for argument in arguments if Path(argument).is_dir()]
        files += [file for folder in folders for name in layout.label_files for file in folder.rglob(name)]
    elif labels is not None:
        files.append(labels)
    try:
        scans = discover(arguments, files)
    except InputError as error:
        if layout is None:
            raise
        raise InputError(f"{error.message}{_where(layout)}") from error
    return scans, {} if labels is None else labels_of(labels, scans)


def labels_of(labels: str | Path, scans: Iterable[str | Path]) -> dict[str, str]:
    """The classes that a label file, or the layout of a published set, gives."""
    layout = LAYOUTS.get(str(labels))
    if layout is None:
        return read_labels(labels)
    paths = [str(path) for path in scans]
    if layout.class_of is None:
        found = _from_files(layout, paths)
    else:
        classes = {path: layout.class_of(split_member(Path(path))[0]) for path in paths}
        found = {path: label for path, label in classes.items() if label is not None}
    if not found:
        raise BenchmarkError(
            f"no path is one of the layout {layout.name}{_where(layout)}; give a label file, a CSV file with "
            "the columns file and class"
        )
    n_classes = len(set(found.values()))
    if layout.n_shapes and (len(found), n_classes) != (layout.n_shapes, layout.n_classes):
        logger.warning(
            "%s has %d shapes in %d classes, of which %d in %d are here%s",
            layout.name,
            layout.n_shapes,
            layout.n_classes,
            len(found),
            n_classes,
            _where(layout),
        )
    return found


def _where(layout: Layout) -> str:
    return f" (published at {layout.published})" if layout.published else ""


def _from_files(layout: Layout, paths: list[str]) -> dict[str, str]:
    """The classes in label files, of which each names scans in its own folder and below."""
    file_of: dict[Path, Path] = {}
    of_file: dict[Path, dict[str, str]] = {}
    for path in paths:
        folder = split_member(Path(path))[0].parent
        if folder not in file_of:
            file_of[folder] = _label_file(layout, folder)
        of_file.setdefault(file_of[folder], {})[path] = path
    found: dict[str, str] = {}
    for file, own in of_file.items():
        found |= match_labels(read_labels(file), own)[0]
    return found


def _label_file(layout: Layout, folder: Path) -> Path:
    for place in (folder, *folder.parents)[:N_FOLDERS]:
        for pattern in layout.label_files:
            files = sorted(place.glob(pattern))
            if len(files) > 1:
                named = ", ".join(file.name for file in files)
                raise BenchmarkError(f"the layout {layout.name} needs one label file in {place}, got {named}")
            if files:
                return files[0]
    raise BenchmarkError(
        f"the layout {layout.name} has its classes in {' or '.join(layout.label_files)}, which is not in "
        f"{folder}, nor in the two folders above{_where(layout)}"
    )
