"""What the protocol `Executor` asks for, of those of pcretrieve and of the example in CONTRIBUTING.md."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes
from dask_cluster import DaskCluster
from packages import install, install_contributed

from pcretrieve import Catalogue, ingest
from pcretrieve.errors import (
    InputError,
    MemoryExceeded,
    OptionError,
    PcretrieveError,
    ReconstructionError,
    Stage,
    UnexpectedError,
    in_stage,
)
from pcretrieve.formats import write_mesh
from pcretrieve.ingestion import EXECUTORS, DaskExecutor, Executor

LIMITS: dict[str, Any] = {"workers": 2, "timeout": 60.0, "memory": None}


@pytest.fixture(params=["processes", "calling-process", "dask"])
def executor(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Executor:
    if request.param == "dask":
        cluster: DaskCluster = request.getfixturevalue("cluster")
        return DaskExecutor(scheduler_file=cluster.file)
    install_contributed(tmp_path / "site", monkeypatch)
    return EXECUTORS[request.param]


def half(number: int) -> float:
    return number / 2


def halved(values: np.ndarray) -> np.ndarray:
    return values / 2


def nothing(number: int) -> None:
    pass


def raise_in_surface(error: Exception, item: int) -> int:
    if item % 2:
        with in_stage(Stage.SURFACE):
            raise error
    return item


def test_each_item_has_one_outcome(executor: Executor) -> None:
    outcomes = list(executor(half, range(20), **LIMITS))
    assert sorted(outcomes) == [(item, item / 2) for item in range(20)]
    assert not list(executor(half, [], **LIMITS))


def test_items_and_outcomes_can_be_arrays_and_none(executor: Executor) -> None:
    assert dict(executor(nothing, range(3), **LIMITS)) == dict.fromkeys(range(3))
    ((item, outcome),) = executor(halved, [np.arange(3)], **LIMITS)
    np.testing.assert_array_equal(item, [0, 1, 2])
    np.testing.assert_array_equal(outcome, [0, 0.5, 1])


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (ReconstructionError("no body"), ReconstructionError),
        (InputError("no such thing"), InputError),
        (MemoryError(), MemoryExceeded),
        (KeyError("x"), UnexpectedError),
    ],
    ids=lambda value: getattr(value, "__name__", type(value).__name__),
)
def test_what_is_raised_is_the_outcome_of_that_item(
    executor: Executor, error: Exception, kind: type[PcretrieveError]
) -> None:
    outcomes = dict(executor(partial(raise_in_surface, error), range(4), **LIMITS))
    assert (outcomes[0], outcomes[2]) == (0, 2)
    for item in (1, 3):
        outcome = outcomes[item]
        assert type(outcome) is kind
        assert outcome.stage is Stage.SURFACE


def test_items_are_read_by_the_caller_as_they_are_needed(executor: Executor) -> None:
    readers = []

    def items() -> Iterator[int]:
        for item in range(1000):
            readers.append(threading.get_ident())
            yield item

    with closing(executor(half, items(), **LIMITS)) as outcomes:
        next(outcomes)
        assert len(readers) < 20
    n_read = len(readers)
    assert set(readers) == {threading.get_ident()}
    assert not list(outcomes)
    assert len(readers) == n_read


def test_what_reading_raises_is_raised(executor: Executor) -> None:
    def items() -> Iterator[int]:
        yield 1
        raise OSError("no space left")

    with pytest.raises(OSError, match="no space left"):
        list(executor(half, items(), **LIMITS))


# --- ingest ---------------------------------------------------------------------------------------------


def test_all_executors_make_the_same_catalogue(executor: Executor, tmp_path: Path) -> None:
    write_mesh(shapes.ellipsoid((1, 1, 2), subdivisions=3), tmp_path / "egg.off")
    (tmp_path / "flat.xyz").write_text("1 2 3\n" * 200)
    scans = [tmp_path / "egg.off", tmp_path / "flat.xyz"]
    summary = ingest(scans, tmp_path / "c.sqlite", executor=executor)
    ingest(scans, tmp_path / "other.sqlite")
    assert ([r.id for r in summary.done], [r.id for r in summary.failed]) == (["egg"], ["flat"])
    with Catalogue(tmp_path / "c.sqlite") as made, Catalogue(tmp_path / "other.sqlite") as expected:
        assert made.signatures() == expected.signatures()
        assert made.shape("egg").surfaces == expected.shape("egg").surfaces
        failed, other = made.record("flat"), expected.record("flat")
        assert (failed.stage, failed.error, failed.message) == (other.stage, other.error, other.message)


def test_an_executor_is_taken_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install_contributed(tmp_path / "site", monkeypatch)
    write_mesh(shapes.ellipsoid((1, 1, 2), subdivisions=3), tmp_path / "egg.off")
    ingest(tmp_path / "egg.off", tmp_path / "c.sqlite", executor="calling-process")
    with Catalogue(tmp_path / "c.sqlite") as catalogue:
        assert catalogue.signatures().ids == ("egg",)
    with pytest.raises(OptionError, match="no executor 'ship'; there are processes, calling-process"):
        ingest(tmp_path / "egg.off", tmp_path / "other.sqlite", executor="ship")
    assert not (tmp_path / "other.sqlite").exists()


def test_an_executor_that_loses_scans_is_an_error(tmp_path: Path) -> None:
    def lose(function: object, items: Iterator[object], /, **limits: object) -> Iterator[object]:
        list(items)
        yield from ()

    write_mesh(shapes.ellipsoid((1, 1, 2), subdivisions=3), tmp_path / "egg.off")
    with pytest.raises(PcretrieveError, match=r"but 1 have none, .*egg\.off among them: start the ingest"):
        ingest(tmp_path / "egg.off", tmp_path / "c.sqlite", executor=lose)  # type: ignore[arg-type]


# --- the table ------------------------------------------------------------------------------------------


def test_names_are_those_of_the_table() -> None:
    assert tuple(EXECUTORS.own) == EXECUTORS.names.own


def test_what_cannot_be_called_is_no_executor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    points = "[pcretrieve.executors]\nship = ships:SHIP\n"
    install(tmp_path / "site", "ships", {"ships": "SHIP = 7\n"}, points, monkeypatch)
    with pytest.raises(OptionError, match="the executor 'ship' of the package ships must be a callable of"):
        EXECUTORS["ship"]
