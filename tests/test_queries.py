"""A query is a file, the id of a stored shape, or a signature, and reads no more than it must."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
import shapes

from pcretrieve import Catalogue, PipelineOptions
from pcretrieve.catalogue import Content, Record
from pcretrieve.descriptors import describe
from pcretrieve.errors import InputError
from pcretrieve.formats import write_mesh
from pcretrieve.ingestion.discover import content_hash
from pcretrieve.pipeline.process import process
from pcretrieve.query import search
from pcretrieve.values import Shape, Signature

OPTIONS = PipelineOptions()
N_SHAPES = 6


@cache
def egg(number: int) -> Shape:
    return process(shapes.ellipsoid((1, 1, 1 + number / 5), subdivisions=3), OPTIONS)


@pytest.fixture
def catalogue(tmp_path: Path) -> Iterator[Catalogue]:
    """Six eggs, of which the scan of the third is a file, and a failure."""
    with Catalogue(tmp_path / "eggs.sqlite", create=True) as store:
        for number in range(N_SHAPES):
            values = describe(egg(number), OPTIONS.signature).values
            store.put(
                Record(f"egg{number}", f"/eggs/{number}.off", f"hash{number}"), Content(egg(number), values)
            )
        scan = tmp_path / "scan.off"
        write_mesh(shapes.ellipsoid((1, 1, 1.4), subdivisions=3), scan)
        stored = replace(store.record("egg2"), content_hash=content_hash(scan))
        store.put(stored, Content(egg(2), describe(egg(2), OPTIONS.signature).values))
        store.put(Record("broken", "/broken.ply", "", status="failed", stage="read", message="no scan"))
        yield store


def test_a_file_an_id_and_a_signature_are_answered_alike(catalogue: Catalogue, tmp_path: Path) -> None:
    signature = Signature(describe(egg(2), OPTIONS.signature).values, "combined", OPTIONS.signature_digest)
    expected = search(catalogue, "egg2", k=4)
    assert expected.ids[0] == "egg2"
    assert expected.distances[0] == 0
    for query in (tmp_path / "scan.off", str(tmp_path / "scan.off"), signature):
        assert search(catalogue, query, k=4) == expected


def test_a_file_wins_over_an_id(
    catalogue: Catalogue, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scan.off").rename(tmp_path / "egg5")
    assert search(catalogue, "egg5").ids[0] == "egg2"
    (tmp_path / "egg5").rename(tmp_path / "egg5.off")
    assert search(catalogue, "egg5").ids[0] == "egg5"
    assert search(catalogue, "egg5.off").ids[0] == "egg2"
    (tmp_path / "egg3").mkdir()
    assert search(catalogue, "egg3").ids[0] == "egg3", "a folder is no scan"


@pytest.mark.parametrize(
    ("query", "said"),
    [
        ("nobody", "'nobody' is no file and no shape of .*; `pcretrieve list` names the shapes"),
        ("broken", "shape 'broken' has no signature: it failed in read: no scan"),
    ],
)
def test_what_is_no_query(query: str, said: str, catalogue: Catalogue) -> None:
    with pytest.raises(InputError, match=said):
        search(catalogue, query)


def test_signatures_that_were_computed_are_kept(catalogue: Catalogue) -> None:
    """Asked again, by whomever, nothing of a shape is read; of one that is new, what is needed."""
    options = OPTIONS.changed(signature={"method": "wks"})
    first = catalogue.signatures(options)
    with Catalogue(catalogue.location) as other:
        statements: list[str] = []
        other.database._connection.set_trace_callback(statements.append)
        assert other.signatures(options) == first
        assert not [text for text in statements if "arrays" in text]
        new = egg(N_SHAPES)
        other.put(Record("new", "/new.off", "h"), Content(new, describe(new, OPTIONS.signature).values))
        other.put(
            replace(other.record("egg0"), content_hash="other content"),
            Content(egg(1), describe(egg(1), OPTIONS.signature).values),
        )
        statements.clear()
        table = other.signatures(options)
        assert (
            len([text for text in statements if text.startswith('SELECT shape, "spectra", "moments"')]) == 2
        )
    expected = [describe(egg(number), options.signature).values for number in (1, 1, 2, 3, 4, 5, N_SHAPES)]
    assert table.values.tolist() == [values.tolist() for values in expected]
