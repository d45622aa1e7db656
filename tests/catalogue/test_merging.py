"""A merge has each shape as its part has it, in any grouping, or names what contradicts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from benchmarks.catalogue import OPTIONS
from numpy.random import default_rng

from pcretrieve import Catalogue, merge_catalogues
from pcretrieve.catalogue import Merged, Record
from pcretrieve.catalogue.records import OWN, Entry
from pcretrieve.catalogue.tables import PAYLOADS, Payload
from pcretrieve.errors import CatalogueError

Content = list[tuple[Record, dict[str, bytes], dict[Payload, bytes]]]


def done(name: str, **changes: object) -> Entry:
    record = Record(name, f"/{name}.ply", f"hash-{name}", "label", area=1.0, added="2026-11-23")
    bits = name.encode() * 8
    payloads = {payload: bits * number for number, payload in enumerate(PAYLOADS, 1)}
    return Entry(replace(record, **changes), {OWN: bits, "other": bits * 2}, payloads)  # type: ignore[arg-type]


def failed(name: str, **changes: object) -> Entry:
    record = Record(name, f"/{name}.ply", "", status="failed", stage="clean", error="Bad", message="why")
    return Entry(replace(record, **changes), {}, {})  # type: ignore[arg-type]


@pytest.fixture
def part(tmp_path: Path) -> Callable[[Sequence[Entry]], Path]:
    """Makes an SQLite file with some shapes."""
    number = iter(range(100))

    def make(entries: Sequence[Entry]) -> Path:
        path = tmp_path / f"part-{next(number)}.sqlite"
        with Catalogue(path, OPTIONS, create=True) as store:
            store.add(entries)
        return path

    return make


def content(location: str | Path) -> Content:
    """Everything that a catalogue has, in ascending order of id."""
    with Catalogue(location) as store:
        entries = store.entries([origin.id for origin in store.origins()])
        return [(one.record, dict(one.signatures), {**one.payloads}) for one in entries]


def test_a_merge_goes_on_after_an_interruption(
    part: Callable[[Sequence[Entry]], Path], new_location: str
) -> None:
    """The catalogue that has some of the shapes gets the others, and a second merge changes nothing."""
    entries = [done("a"), failed("b"), done("c"), done("d", label=None)]
    whole = part(entries)
    merge_catalogues([part(entries[:2])], new_location)
    assert merge_catalogues([whole], new_location) == Merged(2, 2)
    with Catalogue(new_location) as merged:
        revision = merged.revision()
    assert merge_catalogues([whole, whole], new_location) == Merged(0, 4)
    assert content(new_location) == content(whole)
    with Catalogue(new_location) as merged:
        assert merged.revision() == revision


def test_parts_are_merged_in_any_grouping(part: Callable[[Sequence[Entry]], Path], tmp_path: Path) -> None:
    """Parts with failures, repetitions and missing labels at random."""
    rng = default_rng(7)
    makers: list[Callable[..., Entry]] = [done, failed]
    for trial in range(5):
        parts = [
            part(
                [
                    makers[rng.integers(2)](
                        name, label=[None, name.upper()][rng.integers(2)], added=f"{place}"
                    )
                    for name in "abcdefgh"
                    if rng.uniform() < 0.6
                ]
            )
            for place in range(3)
        ]
        one, two, left, right = (tmp_path / f"{trial}-{name}.sqlite" for name in ("1", "2", "3", "4"))
        merge_catalogues(parts[:2], left)
        merge_catalogues([left, parts[2]], one)
        merge_catalogues(parts[1:], right)
        merge_catalogues([parts[0], right], two)
        merge_catalogues(parts, whole := tmp_path / f"{trial}.sqlite")
        assert content(one) == content(two) == content(whole)


CONFLICTS: list[tuple[dict[str, str], str]] = [
    ({"content_hash": "new"}, r"/a.ply has different contents in .*part-0.sqlite and in .*part-1.sqlite"),
    ({"label": "cat"}, r"/a.ply has the labels 'label' and 'cat' in .*part-0.sqlite and in .*part-1"),
    ({"path": "/b.ply"}, r"'a' is /a.ply in .*part-0.sqlite and /b.ply in .*part-1.sqlite"),
]


def test_conflicts_are_named_and_nothing_is_stored(tmp_path: Path) -> None:
    for number, (changes, said) in enumerate(CONFLICTS):
        folder = tmp_path / f"{number}"
        folder.mkdir()
        parts = [folder / "part-0.sqlite", folder / "part-1.sqlite"]
        entries = [[done("a"), done("c")], [done("a", **changes), done("d")]]
        for path, stored in zip(parts, entries, strict=True):
            with Catalogue(path, OPTIONS, create=True) as store:
                store.add(stored)
        with pytest.raises(CatalogueError, match=f"with conflicts cannot be merged: {said}"):
            merge_catalogues(parts, folder / "all.sqlite")
        assert content(folder / "all.sqlite") == []
        with pytest.raises(CatalogueError, match=said):
            merge_catalogues(parts[1:], parts[0])
        assert [record.id for record, *_ in content(parts[0])] == ["a", "c"]
