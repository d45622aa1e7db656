"""Damaged files other than scans: each gives what it held, or an error that names the file."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import shapes
from mutations import altered, mutated, read_damaged

from pcretrieve import Catalogue, PipelineOptions, calibrate, ingest, status
from pcretrieve.catalogue import cache
from pcretrieve.evaluation import evaluate
from pcretrieve.evaluation.comparison import read_scores, write_evaluation
from pcretrieve.formats import write_mesh
from pcretrieve.ingestion.discover import discover
from pcretrieve.ingestion.labels import read_labels
from pcretrieve.matching import DistanceMatrix, read_matrix, write_matrix
from pcretrieve.retrieval.whitening import read_whitening

N_SEEDS = int(os.environ.get("PCRETRIEVE_SEEDS", "165"))
# Arrays of a stored index that are damaged: numbers and ids.
ARRAYS = ("gallery", "id_text")

# Files that were read wrongly once: a folder for each kind of file.
FOUND = sorted((Path(__file__).parent / "corpus").glob("*/*"))


class Target(NamedTuple):
    """A file, and how it is read."""

    path: Path
    read: Callable[[Path], object]
    damage: Callable[[bytes, int], bytes] = mutated


def read_catalogue(path: Path) -> object:
    """Everything that a catalogue holds."""
    for log in ("-wal", "-shm"):
        path.with_name(path.name + log).unlink(missing_ok=True)
    with Catalogue(path) as store:
        records = store.records()
        done = [record.id for record in records if record.status == "done"]
        meshes = [store.mesh(shape_id) for shape_id in done]
        whole = [store.shape(shape_id, ("spectrum", "overlaps")) for shape_id in done]
        return records, store.signatures(), store.areas(), meshes, whole


def read_status(path: Path) -> object:
    catalogue = path.with_name("indexed.sqlite")
    path.replace(path.with_name(".indexed.sqlite.batch"))
    return status(catalogue)


def read_index(path: Path) -> object:
    """The nearest neighbours by a stored index, one of whose arrays is damaged."""
    (folder,) = path.with_name("indexed.sqlite.gallery").iterdir()
    path.replace(folder / path.name.partition("-")[2])
    with Catalogue(path.with_name("indexed.sqlite")) as store:
        nearest = store.index().nearest("egg0", k=3).ids
    assert nearest == ("egg0", "egg1", "egg2")
    return nearest


def distances_in(path: Path) -> object:
    shutil.copy(path.with_name("matrix.ids"), path.with_suffix(".ids"))
    return read_matrix(path)


def written(folder: Path) -> dict[str, Target]:
    """A whole file of each kind, by name."""
    scans = folder / "scans"
    scans.mkdir()
    for number in range(6):
        egg = shapes.ellipsoid((1, 1 + number / 10, 1.5), subdivisions=2)
        write_mesh(egg, scans / f"egg{number}.off")
    (scans / "flat.xyz").write_text("1 2 3\n" * 200)
    labels = {f"egg{number}": f"class{number // 2}" for number in range(6)}
    for name in ("c.sqlite", "indexed.sqlite"):
        with Catalogue(folder / name, create=True) as store:
            ingest(discover([scans]), store, labels=labels)
            if name == "indexed.sqlite":
                store.index()
            else:
                options = store.options.changed(retrieval={"whitening": "none"})
                write_evaluation(evaluate(store, options=options).ranked.rankings, folder)
                table = store.signatures(options)
                calibrate(store, folder / "metric.npz", options=store.options)
    distances = np.abs(table.values[:, :1] - table.values[:, 0])
    for suffix in ("txt", "npy"):
        write_matrix(DistanceMatrix(table.ids, distances), folder / f"matrix.{suffix}")
    (folder / "options.toml").write_text("[surface]\nmode = 'keep'\ncell = 0.01\n[signature]\nn_values = 9\n")
    (folder / "labels.csv").write_text("file,class\n" + "".join(f"{a},{b}\n" for a, b in labels.items()))
    (folder / "labels.cla").write_text("PSB 1\n2 3\n\ncat 0 2\n5\n6\n\ndog 0 1\n7\n")
    (folder / "scans.txt").write_text("".join(f"scans/egg{number}.off\n" for number in range(6)))
    (folder / "scans.csv").write_text("path,x\n" + "".join(f"scans/egg{k}.off,\n" for k in range(6)))
    (folder / "batch").write_bytes((folder / ".indexed.sqlite.batch").read_bytes())
    (kept,) = (folder / "indexed.sqlite.gallery").iterdir()
    arrays = {name: Path(shutil.copy(next(kept.glob(f"{name}*.npy")), folder)) for name in ARRAYS}
    return {
        "catalogue": Target(folder / "c.sqlite", read_catalogue),
        "pages of a catalogue": Target(folder / "c.sqlite", read_catalogue, altered),
        **{f"index, {name}": Target(path, read_index) for name, path in arrays.items()},
        "whitening": Target(folder / "metric.npz", read_whitening),
        "options": Target(folder / "options.toml", PipelineOptions.from_toml),
        "labels": Target(folder / "labels.csv", read_labels),
        "labels of Princeton": Target(folder / "labels.cla", read_labels),
        "list of scans": Target(folder / "scans.txt", lambda path: discover([path])),
        "table of scans": Target(folder / "scans.csv", lambda path: discover([path])),
        "matrix": Target(folder / "matrix.txt", distances_in),
        "binary matrix": Target(folder / "matrix.npy", distances_in),
        "measures": Target(folder / "queries.csv", read_scores),
        "status": Target(folder / "batch", read_status),
    }


@pytest.fixture(scope="module")
def targets(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Target]]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cache, "SMALLEST_KEPT", 1)
        yield written(tmp_path_factory.mktemp("whole"))


KINDS = (
    *("catalogue", "pages of a catalogue", *(f"index, {array}" for array in ARRAYS)),
    *("whitening", "options", "labels", "labels of Princeton", "list of scans", "table of scans"),
    *("matrix", "binary matrix", "measures", "status"),
)


def test_every_kind_is_damaged(targets: dict[str, Target]) -> None:
    assert targets.keys() == {*KINDS}
    for path, read, _ in targets.values():
        read(Path(shutil.copy(path, path.with_name(f"copy-{path.name}"))))


def faults(kind: str, target: Target, damage: Callable[[bytes, int], bytes], n_seeds: int = 1) -> list[str]:
    """The faults of reading such a file with so many damages."""
    whole, damaged = target.path.read_bytes(), target.path.with_name(f"damaged-{target.path.name}")
    # Where a status cannot be read, there is none.
    named = "" if kind == "status" else damaged.stem
    return read_damaged(damaged, lambda seed: damage(whole, seed), target.read, n_seeds, named=named)[1]


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_file_is_read_or_named(kind: str, targets: dict[str, Target]) -> None:
    # A damaged index is computed and written again, which takes a tenth of a second.
    n_seeds = N_SEEDS // 10 if kind.startswith("index") else N_SEEDS
    assert not faults(kind, targets[kind], targets[kind].damage, n_seeds)


@pytest.mark.parametrize("path", FOUND, ids=lambda path: path.stem)
def test_a_file_that_was_read_wrongly_is_read_or_named(path: Path, targets: dict[str, Target]) -> None:
    kind = path.parent.name
    assert not faults(kind, targets[kind], lambda whole, seed: path.read_bytes())
