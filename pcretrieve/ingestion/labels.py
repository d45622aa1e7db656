"""Label files, and published sets by name → the class of each scan.

A layout says where a set, as its authors publish it, has the classes: in the names of the files, or in a
label file beside them. Label files are looked for in the folder of the scans, and in the two folders above.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from pcretrieve.errors import BenchmarkError, InputError
from pcretrieve.formats import split_member
from pcretrieve.ingestion.discover import discover, read_table, read_text

logger = logging.getLogger(__name__)

NAME_COLUMNS = ("file", "path", "filename", "name", "id", "shape")
LABEL_COLUMNS = ("class", "label", "category", "subject")
# Largest number of paths in the message about a name that matches several shapes.
QUOTED = 3

TRAILING_NUMBER = re.compile(r"(\d+)$")

# Number of folders in which a label file is looked for: that of the scans, and those above it.
N_FOLDERS = 3

# Number of poses of each person in FAUST, whose files are numbered person after person.
POSES_OF_FAUST = 10


class Layout(NamedTuple):
    """How a set names the classes of its shapes: in their paths, or in label files of some names."""

    name: str
    place: Callable[[Path], str | None] | tuple[str, ...]
    n_shapes: int
    n_classes: int
    details: str
    published: str = ""

    @property
    def protocol(self) -> str:
        """How the set is evaluated."""
        return f"each shape is a query in all others{self.details}"

    @property
    def source(self) -> str:
        """Where the set is published, as the end of a message."""
        return f" (published at {self.published})" if self.published else ""


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


BESIDE = ("test.cla", "labels.csv")
NIST = "https://www.itl.nist.gov/iad/vug/sharp/contest/2011/NonRigid/"
CARDIFF = "http://www.cs.cf.ac.uk/shaperetrieval/shrec14/"
TUEBINGEN = "https://faust-leaderboard.is.tuebingen.mpg.de/"
TECHNION = "http://tosca.cs.technion.ac.il/book/resources_data.html"
PRINCETON = "https://shape.cs.princeton.edu/benchmark/"
OF_FAUST = ", 10 people in 10 poses: the training scans, or their registrations"
OF_PSB = "; 907 models of the base classification, for training or for test"

#: The layouts by name.
LAYOUTS: Mapping[str, Layout] = MappingProxyType(
    {
        layout.name: layout
        for layout in (
            Layout(
                "shrec11",
                BESIDE,
                600,
                30,
                ", 20 of each class; watertight meshes, --surface keep",
                NIST,
            ),
            Layout(
                "shrec14-real", BESIDE, 400, 40, ", 40 people in 10 poses; --surface keep", CARDIFF
            ),
            Layout(
                "shrec14-synthetic",
                BESIDE,
                300,
                15,
                ", 15 people in 20 poses; --surface keep",
                CARDIFF,
            ),
            Layout("faust", _person, 100, 10, OF_FAUST, TUEBINGEN),
            Layout(
                "tosca",
                _before_number,
                80,
                9,
                "; high-resolution meshes, some of which are open",
                TECHNION,
            ),
            Layout("psb", ("*.cla",), 0, 0, OF_PSB, PRINCETON),
            Layout("folders", _folder, 0, 0, "; the class is the folder"),
            Layout(
                "csv", ("labels.csv",), 0, 0, "; the classes are in labels.csv beside the scans"
            ),
        )
    }
)


def discover_labelled(
    arguments: Sequence[str | Path],
    labels: str | Path | None,
    beside: Iterable[str | Path] = (),
    limits: Mapping[str, Any] | None = None,
) -> tuple[list[Path], dict[str, str]]:
    """Find the files of scans, as by `discover`, and their classes."""
    layout = LAYOUTS.get(str(labels))
    files = [*beside]
    if layout is None:
        files += [labels] if labels is not None else []
    elif isinstance(layout.place, tuple):
        folders = [Path(argument) for argument in arguments if Path(argument).is_dir()]
        files += [
            file for folder in folders for name in layout.place for file in folder.rglob(name)
        ]
    try:
        scans = discover(arguments, files, limits)
    except InputError as error:
        if layout is None:
            raise
        raise InputError(f"{error.message}{layout.source}") from error
    return scans, {} if labels is None else labels_of(labels, scans)


def labels_of(labels: str | Path, scans: Iterable[str | Path]) -> dict[str, str]:
    """The classes that a label file, or the layout of a published set, gives."""
    layout = LAYOUTS.get(str(labels))
    if layout is None:
        return read_labels(labels)
    paths = [str(path) for path in scans]
    if isinstance(layout.place, tuple):
        found = _from_files(layout, layout.place, paths)
    else:
        classes = {path: layout.place(split_member(Path(path))[0]) for path in paths}
        found = {path: label for path, label in classes.items() if label is not None}
    if not found:
        raise BenchmarkError(
            f"no path is one of the layout {layout.name}{layout.source}; give a label file, a CSV file with "
            "the columns file and class"
        )
    here, whole = (len(found), len({*found.values()})), (layout.n_shapes, layout.n_classes)
    if layout.n_shapes and here != whole:
        words = "%s has %d shapes in %d classes, of which %d in %d are here%s"
        logger.warning(words, layout.name, *whole, *here, layout.source)
    return found


def _from_files(layout: Layout, names: tuple[str, ...], paths: list[str]) -> dict[str, str]:
    """The classes in label files, of which each names scans in its own folder and below."""
    label_file = cache(partial(_label_file, layout, names))
    of_file: dict[Path, dict[str, str]] = {}
    for path in paths:
        of_file.setdefault(label_file(split_member(Path(path))[0].parent), {})[path] = path
    found: dict[str, str] = {}
    for file, own in of_file.items():
        found |= match_labels(read_labels(file), own)[0]
    return found


def _label_file(layout: Layout, names: tuple[str, ...], folder: Path) -> Path:
    for place in (folder, *folder.parents)[:N_FOLDERS]:
        for pattern in names:
            files = sorted(place.glob(pattern))
            if len(files) > 1:
                named = ", ".join(file.name for file in files)
                raise BenchmarkError(
                    f"the layout {layout.name} needs one label file in {place}, got {named}"
                )
            if files:
                return files[0]
    raise BenchmarkError(
        f"the layout {layout.name} has its classes in {' or '.join(names)}, which is not in {folder}, nor in "
        f"the two folders above{layout.source}"
    )


def read_labels(path: str | Path) -> dict[str, str]:
    """Read a label file."""
    path = Path(path)
    labels: dict[str, str] = {}
    try:
        text = read_text(path, "label file")
        if text.startswith("PSB"):
            return _princeton(path, text)
        for shape, its_class in read_table(path, "label file", text, NAME_COLUMNS, LABEL_COLUMNS):
            if shape and its_class and labels.setdefault(shape, its_class) != its_class:
                raise InputError(
                    f"the label file {path} must give each shape one class, {shape!r} has "
                    f"{labels[shape]!r} and {its_class!r}"
                )
    except InputError as error:
        raise BenchmarkError(error.message) from error
    return labels


def match_labels(
    labels: Mapping[str, str], paths: Mapping[str, str]
) -> tuple[dict[str, str], list[str]]:
    """Match the names of a label file with shapes.

    A name matches the shape with this id. If there is none, it matches the shape whose path ends with the
    name, with or without the suffix of the path. If there is none, a number, as in a ``.cla`` file, matches
    the shape whose name ends with the number (``5`` matches ``T5``). A number that is an id must not also be
    the name of another shape that has no label, as when one ``.cla`` file is given for two sets.
    """
    by_path: dict[str, set[str]] = {}
    by_number: dict[str, set[str]] = {}
    for shape_id, path in paths.items():
        parts = Path(path).parts
        for start in range(1, len(parts)):
            name = "/".join(parts[start:])
            for ending in {name, name.removesuffix(Path(path).suffix)}:
                by_path.setdefault(ending, set()).add(shape_id)
        if number := TRAILING_NUMBER.search(Path(path).stem):
            by_number.setdefault(str(int(number[1])), set()).add(shape_id)
    matched: dict[str, str] = {}
    unknown = []
    passed_over: dict[str, str] = {}  # name by the id of a shape that it could stand for too
    for name, label in labels.items():
        plain = name.removeprefix("./")
        named = by_path.get(plain) or by_number.get(plain) or set()
        shapes = {plain} & paths.keys() or named
        if plain.isdecimal():
            passed_over |= dict.fromkeys(named - shapes, name)
        if plain.startswith("/"):
            shapes = {shape_id for shape_id, path in paths.items() if path == plain}
        if not shapes:
            unknown.append(name)
        if len(shapes) > 1:
            raise _ambiguous(name, [paths[shape_id] for shape_id in shapes])
        for shape_id in shapes:
            if matched.setdefault(shape_id, label) != label:
                raise BenchmarkError(
                    f"a shape must have one class, {paths[shape_id]} is labelled {matched[shape_id]!r} and "
                    f"{label!r}: correct the label file"
                )
    if unlabelled := sorted(passed_over.keys() - matched.keys()):
        name = passed_over[unlabelled[0]]
        raise _ambiguous(name, [paths[name], paths[unlabelled[0]]])
    return matched, unknown


def _ambiguous(name: str, shapes: Sequence[str]) -> BenchmarkError:
    """A name stands for several shapes, given by their paths."""
    return BenchmarkError(
        f"a label must stand for one shape, {name!r} stands for {len(shapes)}, such as "
        f"{', '.join(sorted(shapes)[:QUOTED])}: write out more of the path, or label one set at a time"
    )


def _princeton(path: Path, text: str) -> dict[str, str]:
    """Classes of the models in a ``.cla`` file."""
    # After "PSB 1" and a line of counts, each class has a line "name parent n", in which the parent 0 means
    # none, and n model numbers.
    head, words = text.split()[:4], text.split()[4:]
    labels: dict[str, str] = {}
    position = 0
    try:
        while position < len(words):
            name, _, count = words[position], words[position + 1], int(words[position + 2])
            models = words[position + 3 : position + 3 + count]
            if len(models) != count:
                raise ValueError(f"class {name} declares {count} models, {len(models)} follow")
            labels |= dict.fromkeys(models, name)
            position += 3 + count
        if len(labels) != int(head[3]):
            raise ValueError(f"its header declares {head[3]} models, {len(labels)} follow")
    except (IndexError, ValueError) as error:
        raise InputError(f"the label file {path} is not a complete .cla file ({error})") from error
    return labels
