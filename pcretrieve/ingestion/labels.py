"""Label files → the class of each shape."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from pcretrieve.errors import BenchmarkError

__all__ = ["match_labels", "read_labels"]

NAME_COLUMNS = ("file", "path", "filename", "name", "id", "shape")
LABEL_COLUMNS = ("class", "label", "category", "subject")
# Largest number of paths in the message about a name that matches several shapes.
QUOTED = 3

TRAILING_NUMBER = re.compile(r"(\d+)$")


def read_labels(path: str | Path) -> dict[str, str]:
    """Read a label file."""
    path = Path(path)
    try:
        text = path.read_bytes().decode("utf-8-sig")  # names may have the end of a line of any system
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise BenchmarkError(f"cannot read the label file {path}: {reason}") from error
    return _princeton(path, text) if text.startswith("PSB") else _table(path, text)


def match_labels(labels: Mapping[str, str], paths: Mapping[str, str]) -> tuple[dict[str, str], list[str]]:
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
            raise BenchmarkError(_several(name, [paths[shape_id] for shape_id in shapes]))
        for shape_id in shapes:
            if matched.setdefault(shape_id, label) != label:
                raise BenchmarkError(
                    f"a shape must have one class, {paths[shape_id]} is labelled {matched[shape_id]!r} and "
                    f"{label!r}: correct the label file"
                )
    if unlabelled := sorted(passed_over.keys() - matched.keys()):
        name = passed_over[unlabelled[0]]
        raise BenchmarkError(_several(name, [paths[name], paths[unlabelled[0]]]))
    return matched, unknown


def _several(name: str, shapes: Sequence[str]) -> str:
    """The message about a name that stands for several shapes, by their paths."""
    return (
        f"a label must stand for one shape, {name!r} stands for {len(shapes)}, such as "
        f"{', '.join(sorted(shapes)[:QUOTED])}: write out more of the path, or label one set at a time"
    )


def _table(path: Path, text: str) -> dict[str, str]:
    labels: dict[str, str] = {}
    try:
        # Spreadsheets separate columns by semicolons where the comma is the decimal point.
        head = text.partition("\n")[0]
        separator = ";" if ";" in head and "," not in head else ","
        rows = csv.DictReader(io.StringIO(text, newline=""), strict=True, delimiter=separator)
        header = {name.strip().lower(): name for name in rows.fieldnames or ()}
        name = next((header[column] for column in NAME_COLUMNS if column in header), None)
        label = next((header[column] for column in LABEL_COLUMNS if column in header), None)
        if name is None or label is None:
            raise BenchmarkError(
                f"the label file {path} must have a header with one of {', '.join(NAME_COLUMNS)} and one of "
                f"{', '.join(LABEL_COLUMNS)}, got {', '.join(header) or 'nothing'}"
            )
        for row in rows:
            shape, its_class = (row[name] or "").strip(), (row[label] or "").strip()
            if shape and its_class and labels.setdefault(shape, its_class) != its_class:
                raise BenchmarkError(
                    f"the label file {path} must give each shape one class, {shape!r} has "
                    f"{labels[shape]!r} and {its_class!r} (line {rows.line_num})"
                )
    except csv.Error as error:
        raise BenchmarkError(
            f"the label file {path} is not a CSV file ({error}): close each quotation mark, and write "
            'one within quotes as ""'
        ) from error
    return labels


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
        raise BenchmarkError(f"the label file {path} is not a complete .cla file ({error})") from error
    return labels
