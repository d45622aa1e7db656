"""Label files: which class each shape belongs to."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping
from pathlib import Path

from pcretrieve.errors import BenchmarkError

__all__ = ["match_labels", "read_labels"]

NAME_COLUMNS = ("file", "path", "filename", "name", "id", "shape")
LABEL_COLUMNS = ("class", "label", "category", "subject")
# Paths that are quoted where a name stands for several.
QUOTED = 3

TRAILING_NUMBER = re.compile(r"(\d+)$")


def read_labels(path: str | Path) -> dict[str, str]:
    """Classes by name.

    Parameters
    ----------
    path : str or Path
        A CSV file with a header, of which one column (``file``, ``path``, ``name``, ``id``) names the shape
        and one (``class``, ``label``) its class; or a ``.cla`` file of the Princeton Shape Benchmark.

    Raises
    ------
    BenchmarkError
        If it cannot be read, or is neither.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise BenchmarkError(f"cannot read the label file {path}: {reason}") from error
    return _princeton(path, text) if text.startswith("PSB") else _table(path, text)


def match_labels(labels: Mapping[str, str], paths: Mapping[str, str]) -> tuple[dict[str, str], list[str]]:
    """Labels by shape id.

    A name in a label file stands for the shape with that id; else for the one whose path ends in that name,
    with or without its suffix; else, a bare number as in a ``.cla`` file, for the one whose name ends in it
    (``5`` for ``T5``).

    Parameters
    ----------
    labels : mapping of name to class
    paths : mapping of id to path

    Returns
    -------
    labels : dict of id to class
    unknown : list of str
        Names that stand for no shape.

    Raises
    ------
    BenchmarkError
        If a name stands for several shapes, or a shape is given two classes.
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
    for name, label in labels.items():
        plain = name.removeprefix("./")
        shapes = {plain} & paths.keys() or by_path.get(plain) or by_number.get(plain) or set()
        if plain.startswith("/"):
            shapes = {shape_id for shape_id, path in paths.items() if path == plain}
        if not shapes:
            unknown.append(name)
        if len(shapes) > 1:
            some = ", ".join(sorted(paths[shape_id] for shape_id in shapes)[:QUOTED])
            raise BenchmarkError(
                f"a label must stand for one shape, {name!r} stands for {len(shapes)}, such as {some}: write "
                "out more of the path"
            )
        for shape_id in shapes:
            if matched.setdefault(shape_id, label) != label:
                raise BenchmarkError(
                    f"a shape must have one class, {paths[shape_id]} is labelled {matched[shape_id]!r} and "
                    f"{label!r}: correct the label file"
                )
    return matched, unknown


def _table(path: Path, text: str) -> dict[str, str]:
    labels: dict[str, str] = {}
    try:
        rows = csv.DictReader(io.StringIO(text, newline=""))
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
        raise BenchmarkError(f"the label file {path} is not a CSV file: {error}") from error
    return labels


def _princeton(path: Path, text: str) -> dict[str, str]:
    """``PSB 1``, a line of counts, then per class ``name parent n`` (parent 0: none) and n model numbers."""
    head, words = text.split()[:4], text.split()[4:]
    labels: dict[str, str] = {}
    position = 0
    try:
        while position < len(words):
            name, _, count = words[position], words[position + 1], int(words[position + 2])
            models = words[position + 3 : position + 3 + count]
            if len(models) != count:
                raise ValueError(f"class {name} promises {count} models, {len(models)} follow")
            labels |= dict.fromkeys(models, name)
            position += 3 + count
        if len(labels) != int(head[3]):
            raise ValueError(f"its header promises {head[3]} models, {len(labels)} follow")
    except (IndexError, ValueError) as error:
        raise BenchmarkError(f"the label file {path} is not a complete .cla file ({error})") from error
    return labels
