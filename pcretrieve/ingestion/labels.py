"""Label files, and published sets by name → the class of each scan.

A layout says where a set, as its authors publish it, has the classes: in the names of the files, or in a
label file beside them. Label files are looked for in the folder of the scans, and in the two folders above.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import cache, partial
from itertools import islice, product
from pathlib import Path, PureWindowsPath
from typing import Any, NamedTuple

from pcretrieve.errors import BenchmarkError, InputError
from pcretrieve.formats import ScanPath
from pcretrieve.ingestion.discover import discover, read_table, read_text

NAME_COLUMNS = ("file", "path", "filename", "name", "id", "shape")
LABEL_COLUMNS = ("class", "label", "category", "subject")
# Largest number of paths in the message about a name that matches several shapes.
QUOTED = 3

TRAILING_NUMBER = re.compile(r"(\d+)$")

# Number of folders in which a label file is looked for: that of the scans, and those above it.
N_FOLDERS = 3


class Layout(NamedTuple):
    """How a set, as it is published, names the classes of its shapes.

    files: patterns of the names of its label files, or none.
    path: otherwise a regular expression of the end of a path; its group is the class.
    """

    published: str = ""
    files: tuple[str, ...] = ()
    path: str = ""

    @property
    def source(self) -> str:
        """Where the set is published, as the end of a message."""
        return f" (published at {self.published})" if self.published else ""


SHREC11 = "https://www.itl.nist.gov/iad/vug/sharp/contest/2011/NonRigid/"
SHREC14 = "http://www.cs.cf.ac.uk/shaperetrieval/shrec14/"
FAUST = "https://faust-leaderboard.is.tuebingen.mpg.de/"
TOSCA = "http://tosca.cs.technion.ac.il/book/resources_data.html"
PSB = "https://shape.cs.princeton.edu/benchmark/"

BESIDE = ("test.cla", "labels.csv")
# Person after person, each in ten poses: the last digit is the pose.
SCAN_OF_FAUST = r"tr_(?:scan|reg)_(\d\d)\d\.\w+"
NAME_AND_NUMBER = r"([^/]*[^/\d])\d+\.\w+"
IN_FOLDER = r"([^/]+)/[^/]+"

#: The layouts by name. The guide says what each set has, and how it is evaluated.
LAYOUTS: Mapping[str, Layout] = {
    "shrec11": Layout(SHREC11, files=BESIDE),
    "shrec14-real": Layout(SHREC14, files=BESIDE),
    "shrec14-synthetic": Layout(SHREC14, files=BESIDE),
    "faust": Layout(FAUST, path=SCAN_OF_FAUST),
    "tosca": Layout(TOSCA, path=NAME_AND_NUMBER),
    "psb": Layout(PSB, files=("*.cla",)),
    "folders": Layout(path=IN_FOLDER),
    "csv": Layout(files=("labels.csv",)),
}


def discover_labelled(
    arguments: Sequence[str | Path],
    labels: str | Path | None,
    beside: Iterable[str | Path] = (),
    limits: Mapping[str, Any] | None = None,
) -> tuple[list[ScanPath], dict[str, str]]:
    """Find the files of scans, as by `discover`, and their classes."""
    layout = LAYOUTS.get(str(labels), Layout())
    folders = [Path(argument) for argument in arguments if Path(argument).is_dir()]
    named = (
        file for folder in folders for name in layout.files for file in folder.rglob(name)
    )
    files = [*beside, *named, *([] if labels is None else [labels])]
    scans = discover(arguments, files, limits)
    return scans, {} if labels is None else labels_of(labels, map(str, scans))


def labels_of(labels: str | Path, scans: Iterable[str]) -> dict[str, str]:
    """The classes that a label file, or the layout of a published set, gives to scans by their paths."""
    layout = LAYOUTS.get(str(labels))
    if layout is None:
        return read_labels(labels)
    paths = {path: ScanPath.parse(path).file for path in scans}
    if layout.files:
        found = _from_files(str(labels), layout, paths)
    else:
        fits = {
            path: re.search(f"/{layout.path}$", f"/{file}")
            for path, file in paths.items()
        }
        found = {path: fit[1] for path, fit in fits.items() if fit}
    if not found:
        raise BenchmarkError(
            f"no path is one of the layout {labels}{layout.source}; give a label file, a CSV file with "
            "the columns file and class"
        )
    return found


def _from_files(name: str, layout: Layout, paths: Mapping[str, Path]) -> dict[str, str]:
    """The classes in label files; each names the scans in its own folder and below."""
    label_file = cache(partial(_label_file, name, layout))
    of_file: dict[Path, dict[str, str]] = {}
    for path, scan in paths.items():
        of_file.setdefault(label_file(scan.parent), {})[path] = path
    found: dict[str, str] = {}
    for file, own in of_file.items():
        found |= match_labels(read_labels(file), own)[0]
    return found


def _label_file(name: str, layout: Layout, folder: Path) -> Path:
    for place, pattern in product((folder, *folder.parents)[:N_FOLDERS], layout.files):
        files = sorted(place.glob(pattern))
        if len(files) > 1:
            named = ", ".join(file.name for file in files)
            raise BenchmarkError(
                f"the layout {name} needs one label file in {place}, got {named}"
            )
        if files:
            return files[0]
    raise BenchmarkError(
        f"the layout {name} has its classes in {' or '.join(layout.files)}, which is not in "
        f"{folder}, nor in the two folders above{layout.source}"
    )


def read_labels(path: str | Path) -> dict[str, str]:
    """Read a label file."""
    path = Path(path)
    labels: dict[str, str] = {}
    try:
        text = read_text(path, "label file", LAYOUTS)
        if text.startswith("PSB"):
            return _princeton(path, text)
        for shape, its_class in read_table(
            path, "label file", text, NAME_COLUMNS, LABEL_COLUMNS
        ):
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
    name, with or without the suffix of the path, and with the separators of any system. Of a name with the
    letter of a drive, the longest ending counts that a path has. If there is none, a number, as in a ``.cla``
    file, matches the shape whose name ends with the number (``5`` matches ``T5``). A number that is an id
    must not also be the name of another shape that has no label, as when one ``.cla`` file is given for two
    sets.
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
    # Name by the id of a shape that it could stand for too.
    passed_over: dict[str, str] = {}
    for name, label in labels.items():
        plain = name if name in paths else _plain(name, by_path)
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


def _plain(name: str, known: Collection[str]) -> str:
    """A name with the separators of `known` names; one with a drive without the folders that they lack."""
    if name in known:
        return name
    path = PureWindowsPath(name)
    if not path.drive:
        return path.as_posix()
    endings = ("/".join(path.parts[start:]) for start in range(1, len(path.parts)))
    return next((ending for ending in endings if ending in known), name)


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
    words = text.split()
    labels: dict[str, str] = {}
    rest = iter(words[4:])
    try:
        for name in rest:
            next(rest)
            count = int(next(rest))
            models = [*islice(rest, count)]
            if len(models) != count:
                raise ValueError(
                    f"class {name} declares {count} models, {len(models)} follow"
                )
            labels |= dict.fromkeys(models, name)
        if len(labels) != int(words[3]):
            raise ValueError(
                f"its header declares {words[3]} models, {len(labels)} follow"
            )
    except (IndexError, StopIteration, ValueError) as error:
        raise InputError(
            f"the label file {path} is not a complete .cla file ({error})"
        ) from error
    return labels
