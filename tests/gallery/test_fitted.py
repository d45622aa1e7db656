"""Stored indexes belong to a state of the catalogue, and give the results of newly computed indexes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapes
from scipy.spatial.transform import Rotation

from pcretrieve import Catalogue, PipelineOptions, SignatureIndex
from pcretrieve.catalogue import Content, Record
from pcretrieve.catalogue.cache import CHECKSUMS
from pcretrieve.descriptors import describe
from pcretrieve.gallery import fitted, groups
from pcretrieve.gallery.fitted import index, signatures
from pcretrieve.gallery.groups import places
from pcretrieve.pipeline.process import process
from pcretrieve.retrieval import coordinates, fit_whitening
from pcretrieve.values import Shape, TriangleMesh


@cache
def egg() -> Shape:
    return process(shapes.ellipsoid((1, 1, 1), subdivisions=3), PipelineOptions())


FEW = PipelineOptions().changed(signature={"method": "r-bihdm", "n_values": 59})
N_INDEXED = 40


def put_other(store: Catalogue, number: int) -> None:
    """An egg with somebody else's signature."""
    change = np.exp(np.random.default_rng(number).normal(size=59) * 0.3)
    values = describe(egg(), FEW.signature).values * change
    label = f"kind{number % 5}"
    store.put(
        Record(f"s{number:03}", f"/s{number:03}.off", f"h{number}", label),
        Content(egg(), values),
    )


@pytest.fixture
def indexed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Catalogue]:
    """A small catalogue of which indexes are stored all the same."""
    for module in (fitted, groups):
        monkeypatch.setattr(module, "SMALLEST_KEPT", 1)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with Catalogue(tmp_path / "c.sqlite", FEW, create=True) as store:
        for number in range(N_INDEXED):
            put_other(store, number)
        yield store


def asked(whitening: str = "none", distance: str = "log") -> PipelineOptions:
    """Options by which the stored values are compared."""
    retrieval = {"whitening": whitening, "distance": distance}
    return FEW.changed(retrieval=retrieval, signature={"scale": "area"})


def kept(store: Catalogue) -> list[Path]:
    folder = store.cache.folder
    return sorted(folder.iterdir()) if folder is not None and folder.exists() else []


def assert_same(
    found: SignatureIndex, store: Catalogue, options: PipelineOptions
) -> None:
    """An index is the one of the present shapes, whatever was stored or fitted before."""
    table, kind = signatures(store, options=options), options.retrieval.whitening
    whitening = None
    if kind in ("pca", "within-class"):
        logs = coordinates(table.values, "logarithms")
        whitening = fit_whitening(kind, logs, table.labels, options_digest=table.digest)
    assert index(store, options=options).whitening == (whitening or found.whitening)
    anew = SignatureIndex(
        table, options.retrieval, whitening=whitening or found.whitening
    )
    for values in table.values[::7]:
        for query in (values, values * 1.05):
            assert found.query(query, 12) == anew.query(query, 12)


WHITENINGS = ("none", "people", "neighbours", "pca", "within-class")


@pytest.mark.parametrize(
    ("distance", "whitening"), [("log", one) for one in WHITENINGS] + [("d1", "none")]
)
def test_an_index_that_was_kept_answers_as_one_made_anew(
    distance: str, whitening: str, indexed: Catalogue
) -> None:
    options = asked(whitening, distance)
    assert_same(index(indexed, options=options), indexed, options)
    assert len(kept(indexed)) == 1
    with Catalogue(indexed.location) as other:
        statements: list[str] = []
        other.rows.database._connection.set_trace_callback(statements.append)
        found = index(other, options=options)
        assert index(other, options=options) is found
        assert not [text for text in statements if "signatures" in text], (
            "it was computed again"
        )
        assert_same(found, indexed, options)


def test_what_others_add_remove_and_label_is_noticed(
    indexed: Catalogue, monkeypatch: pytest.MonkeyPatch
) -> None:
    earlier = index(indexed)
    drawn = places(indexed)
    monkeypatch.delattr(groups, "plane_map")  # a map is not computed again
    np.testing.assert_array_equal(places(indexed), drawn)
    with Catalogue(indexed.location) as other:
        put_other(other, N_INDEXED)
        assert list(index(indexed).ids) == [*earlier.ids, f"s{N_INDEXED:03}"]
        assert len(kept(indexed)) == 1, "the map of before is gone"
        other.remove("s003")
        assert "s003" not in index(indexed).ids
        for kind in ("pca", "within-class"):
            assert_same(index(indexed, options=asked(kind)), indexed, asked(kind))
        before = index(indexed, options=asked("within-class")).whitening
        other.rows.revise(labels={"/s004.off": "kind0"})
        assert index(indexed, options=asked("within-class")).whitening != before
    assert_same(
        index(indexed, options=asked("within-class")), indexed, asked("within-class")
    )


@pytest.mark.parametrize("damage", ["missing", "one bit"])
def test_one_that_is_damaged_is_found_and_made_anew(
    damage: str, indexed: Catalogue
) -> None:
    index(indexed, options=asked())
    (folder,) = kept(indexed)
    file = folder / "gallery.npy"
    data = file.read_bytes()
    file.unlink()  # the index above has the old one mapped
    if damage == "one bit":
        file.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    assert [path for path, _ in indexed.cache.faults()] == [folder]
    with Catalogue(indexed.location) as other:
        assert_same(index(other, options=asked()), indexed, asked())
    assert kept(indexed) == [folder]
    assert [*indexed.cache.faults()] == []


def photographs(folder: Path) -> list[Path]:
    """Folders of a reader, one of which is old, one named like an index and one like an unfinished one."""
    mine = [
        folder / name
        for name in ("photos", "0" * 16 + "-" + "1" * 16, ".unfinished-photos")
    ]
    for each in mine:
        each.mkdir(parents=True)
        (each / "photo.jpg").write_text("a photograph")
        os.utime(each, (0, 0))
    return mine


@pytest.mark.parametrize("target", [".", "..", "an absolute path", "a real folder"])
def test_no_folder_beside_a_catalogue_of_somebody_else_is_removed(
    target: str, indexed: Catalogue, tmp_path: Path
) -> None:
    beside = Path(indexed.location).with_name("c.sqlite.gallery")
    mine = photographs(tmp_path)
    if target == "a real folder":
        mine += photographs(beside)
    else:
        beside.symlink_to(tmp_path if target == "an absolute path" else target)
    index(indexed, options=asked())
    put_other(indexed, N_INDEXED)
    index(indexed, options=asked())
    assert len(kept(indexed)) == 1
    assert [each for each in mine if not (each / "photo.jpg").exists()] == []


@pytest.mark.parametrize("target", [".", "..", "an absolute path"])
def test_what_a_link_in_the_cache_leads_to_is_not_removed(
    target: str, indexed: Catalogue, tmp_path: Path
) -> None:
    mine = photographs(tmp_path / "mine")
    (mine[1] / CHECKSUMS).write_text("{}")  # like an index of another state
    index(indexed, options=asked())
    (folder,) = kept(indexed)
    links = [
        folder.with_name(name) for name in ("2" * 16 + "-" + "3" * 16, ".unfinished-link")
    ]
    for link in links:
        link.symlink_to(mine[1] if target == "an absolute path" else target)
        os.utime(link, (0, 0), follow_symlinks=False)
    mine += photographs(folder.parent)
    put_other(indexed, N_INDEXED)
    index(indexed, options=asked())
    assert [
        each for each in mine if each.name[0] != "." and not (each / "photo.jpg").exists()
    ] == []
    assert [link for link in links if not link.is_symlink()] == []


def test_people_of_one_build_are_no_copies(tmp_path: Path) -> None:
    """Their moments are alike, but not their signatures; a scan of one of them, made again, is a copy."""
    rng = np.random.default_rng(0)
    with Catalogue(tmp_path / "c.sqlite", FEW, create=True) as store:
        for number in range(12):
            own = np.exp(rng.normal(size=59) * 0.3)
            for scan in range(4):
                # The third and the fourth scan of each are the same, but for the noise.
                noise = 0.001 if scan == 3 else 0.03
                change = own * np.exp(rng.normal(size=59) * noise)
                if scan == 2:
                    first = change
                elif scan == 3:
                    change = first * change / own
                name = f"{number:02}{scan}"
                record = Record(name, f"/{name}.off", f"h{name}", f"p{number}")
                values = describe(egg(), FEW.signature).values * change
                store.put(record, Content(egg(), values))
        plain = FEW.changed(retrieval={"whitening": "none"})
        found = groups.duplicates(store, options=plain)
        wrong = [pair for pair in found if pair.first[:2] != pair.second[:2]]
        n_apart = 48 * 44 // 2
        assert len(wrong) <= np.ceil(groups.FALSE_COPIES * n_apart)
        assert {(f"{number:02}2", f"{number:02}3") for number in range(12)} <= {
            (pair.first, pair.second) for pair in found
        }
        moments = index(store, options=FEW.of_copies)
        assert len(groups.near_pairs(moments, groups.SAME)) == 48 * 47 // 2


def test_surfaces_are_compared_in_any_place_size_and_handedness() -> None:
    """A body whose upper half is turned by 10° is farther from itself than a mirrored coarse copy."""
    body = shapes.body(4)
    turn = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix()
    copy = TriangleMesh(body.vertices @ turn * [-3, 3, 3] + 1, body.faces[:, ::-1])
    assert groups._surface_gap(body, copy) < 1e-9
    assert groups._surface_gap(body, shapes.body(5)) < groups.ONE_SURFACE
    height = body.vertices[:, 2]
    angle = np.radians(10) * np.clip(height / np.ptp(height), 0, 1)
    x, y, z = body.vertices.T
    bent = np.column_stack(
        [x * np.cos(angle) - z * np.sin(angle), y, x * np.sin(angle) + z * np.cos(angle)]
    )
    assert groups._surface_gap(body, TriangleMesh(bent, body.faces)) > groups.ONE_SURFACE
