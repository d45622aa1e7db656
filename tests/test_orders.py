"""Whatever happens to a catalogue, in whatever order: it has the rows that a dict has after the same events.

Hypothesis chooses the events, and shortens an order that fails. PCRETRIEVE_ORDERS says how many orders there
are, PCRETRIEVE_SEED chooses others than by default.
"""

from __future__ import annotations

import hashlib
import math
import multiprocessing
import os
import pickle
import shutil
import signal
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any
from uuid import uuid4

import pytest
import shapes
from hypothesis import HealthCheck, seed, settings, strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    invariant,
    rule,
    run_state_machine_as_test,
)
from processes import MADE, PATIENCE, remembered

import pcretrieve as pr
from pcretrieve import Catalogue, Record, Summary
from pcretrieve.catalogue.copies import MergedCatalogues
from pcretrieve.catalogue.postgresql import PostgresqlDatabase
from pcretrieve.catalogue.records import free_id, numbered_id
from pcretrieve.catalogue.sqlite import SqliteDatabase
from pcretrieve.errors import CatalogueError, InputError
from pcretrieve.formats import write_mesh
from pcretrieve.ingestion import progress
from pcretrieve.web import keeping

# Small closed meshes that are kept as they are, of which few numbers are computed.
OPTIONS: dict[str, dict[str, Any]] = {
    "surface": {"mode": "keep"},
    "spectral": {"n_pairs": 12},
    "signature": {"method": "shape-dna", "n_values": 5},
}
NAMES = ("one/a.off", "one/b.off", "two/a.off", "two/c.off")
N_GOOD, N = 3, 5  # the others cannot be read


@dataclass(frozen=True)
class Row:
    """What is compared of a shape, or of a failure; without content, if its file could not be opened."""

    id: str
    content: int | None
    label: str | None = None

    @property
    def is_done(self) -> bool:
        return self.content is not None and self.content < N_GOOD


Table = dict[str, Row]  # by the name of the file
Files = dict[str, int | None]  # content by name; None of a link to nowhere
Fates = dict[str, str]
EMPTY: Mapping[str, str] = {}


# --- what should happen to a dict -------------------------------------------------------------------------


def store(table: Table, name: str, row: Row) -> bool:
    """Store a row by its name, which keeps its id; false if that is a failure where there is a shape."""
    if (earlier := table.get(name)) is None:
        taken = {one.id for one in table.values()}
        table[name] = replace(
            row, id=free_id(Record(row.id, name, ""), taken.__contains__)
        )
    elif row.is_done or not earlier.is_done:
        table[name] = replace(row, id=earlier.id)
    return row.is_done


def ingest(
    table: Table,
    files: Files,
    names: Iterable[str],
    fates: Fates,
    labels: Mapping[str, str] = EMPTY,
    retries: bool = False,
) -> Iterator[bool]:
    """An ingest, which stops before each transaction, with whether a scan has been processed for it.

    fates: what becomes of each file.
    """
    names = [*names]
    moved, removed, unreadable, process = {}, [], {}, {}
    held = dict(sorted(table.items(), key=lambda item: item[1].id))
    ids = {name: row.id for name, row in held.items()}
    for name in names:
        numbered = (
            numbered_id(Path(name).stem, number) for number in range(1, len(ids) + 2)
        )
        ids.setdefault(name, next(one for one in numbered if one not in ids.values()))
    gone = {
        held[name].content: name
        for name in held
        if name not in names and files.get(name) is None
    }
    same = {
        content: [name for name, row in held.items() if row.content == content]
        for content in range(N)
    }
    queued: dict[int, str] = {}
    for name in names:
        content, earlier = files.get(name), held.get(name)
        if content is None:
            row = earlier or Row(ids[name], None)
            unreadable[name] = replace(
                row, content=None, label=labels.get(name, row.label)
            )
            continue
        if not earlier and (old := gone.pop(content, None)):
            moved[old], held[name], ids[name] = name, held[old], held[old].id
            same[content][same[content].index(old)] = name
            earlier = held[name]
        there = [
            one
            for one in same[content]
            if one not in names or files.get(one) in (None, content)
        ]
        if earlier and earlier.content == content and (earlier.is_done or not retries):
            fates[name] = "held"
        elif (content in queued or there) and not (
            earlier and earlier.content == content
        ):
            if earlier and (
                not earlier.is_done or (content not in queued and content < N_GOOD)
            ):
                removed.append(name)
            fates[name] = f"copy of {queued.get(content) or there[0]}"
        else:
            queued[content] = name
            process[name] = Row(
                ids[name], content, labels.get(name, earlier.label if earlier else None)
            )
    given = {
        name: label
        for name, label in labels.items()
        if name in held and name in {*fates, *process}
    }
    if moved or removed or given:
        yield False
        for old, name in moved.items():
            if old in table and name not in table:
                table[name] = table.pop(old)
        for name in removed:
            table.pop(name, None)
        for name in given.keys() & table.keys():
            table[name] = replace(table[name], label=given[name])
    for rows in (unreadable, process):
        for name, row in rows.items():
            yield rows is process
            fates[name] = "done" if store(table, name, row) else "failed"


def ingested(
    table: Table, files: Files, names: Iterable[str], labels: Mapping[str, str] = EMPTY
) -> Fates:
    """An ingest from its start to its end."""
    fates: Fates = {}
    for _ in ingest(table, files, names, fates, labels):
        pass
    return fates


def merged(table: Table, other: Table) -> Table | str:
    """Both in one, or what is said of their conflicts."""
    whole, said = dict(table), []
    for name, row in other.items():
        mine = table.get(name, row)
        if mine.is_done and row.is_done and mine.content != row.content:
            said.append(f"{name} has different contents in")
        if mine.label and row.label and mine.label != row.label:
            said.append(f"{name} has the labels {mine.label!r} and {row.label!r} in")
        chosen = row if row.is_done and not mine.is_done else mine
        whole[name] = replace(chosen, label=mine.label or row.label)
    by_id = {row.id: name for name, row in whole.items()}
    said += [
        f"{row.id!r} is .*{name} in"
        for name, row in whole.items()
        if by_id[row.id] != name
    ]
    return "|".join(said) or whole


# --- what happens -----------------------------------------------------------------------------------------


@cache
def contents() -> dict[int, bytes]:
    """Contents of files."""
    with TemporaryDirectory() as folder:
        files = {number: Path(folder) / f"{number}.off" for number in range(N)}
        for number, file in files.items():
            file.write_text("OFF\n" * number)
            if number < N_GOOD:
                write_mesh(shapes.ellipsoid((1, 1.2, 1.5 + number), subdivisions=1), file)
        pr.ingest(folder, f"{folder}/c.sqlite", options=OPTIONS, executor=remembered)
        return {number: file.read_bytes() for number, file in files.items()}


def killed_ingest(made: bytes, location: str, folder: Path, transaction: int) -> None:
    """In a process of its own: an ingest that is killed at the end of a transaction; the first one counts."""
    MADE.update(pickle.loads(made))
    progress.INTERVAL = math.inf
    numbers = count()
    for database in (SqliteDatabase, PostgresqlDatabase):

        @contextmanager
        def writing(
            self: Any, *given: Any, whole: Any = database.writing
        ) -> Iterator[None]:
            with whole(self, *given):
                yield
                if next(numbers) == transaction:
                    os.kill(os.getpid(), signal.SIGKILL)

        database.writing = writing  # type: ignore[method-assign]
    pr.ingest(folder, location, options=OPTIONS, executor=remembered)


def started(location: str, folder: Path, transaction: int = -1) -> Any:
    """The process of such an ingest, which nobody kills without a number of a transaction."""
    context = multiprocessing.get_context("forkserver")
    # SciPy once, and not by each.
    context.set_forkserver_preload(["test_orders", "pcretrieve.spectral"])
    process = context.Process(
        target=killed_ingest, args=(pickle.dumps(MADE), location, folder, transaction)
    )
    process.start()
    return process


def exit_codes(processes: list[Any]) -> set[int]:
    for process in processes:
        process.join(PATIENCE)
    return {process.exitcode for process in processes}


names_of_files, numbers = st.sampled_from(NAMES), st.integers(0, N - 1)
classes = st.dictionaries(names_of_files, st.sampled_from(("cat", "dog")), max_size=2)


class Orders(RuleBasedStateMachine):
    """A folder of scans, and catalogues of it; what happens to each happens to the dict `table`."""

    server: str | None = None  # the URL of a database, for a second catalogue

    def __init__(self) -> None:
        super().__init__()
        self.root = Path(mkdtemp(prefix="pcretrieve-orders-"))
        self.folder = self.root / "scans"
        self.files: Files = {}
        self.table: Table = {}
        self.backups: list[tuple[Path, Table]] = []
        self.hashes = {
            hashlib.sha256(data).hexdigest(): number
            for number, data in contents().items()
        }
        for name in NAMES:
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
        self.patch = pytest.MonkeyPatch()
        self.patch.setattr("pcretrieve.gallery.fitted.SMALLEST_KEPT", 1)
        self.patch.setenv("XDG_CACHE_HOME", str(self.root))
        # Of the server that forks.
        self.patch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
        self.readers: list[Catalogue] = []
        self.open([])

    def open(self, parts: list[Path]) -> None:
        """Go on with new catalogues, of the shapes of others."""
        self.close()
        self.locations = [str(self.root / f"{uuid4().hex}.sqlite")]
        self.locations += [f"{self.server}?schema={uuid4().hex}"] if self.server else []
        for location in self.locations:
            with Catalogue(
                location, pr.PipelineOptions.of(OPTIONS), create=True
            ) as catalogue:
                if parts:
                    pr.merge_catalogues(parts, catalogue)
        self.readers = [Catalogue(location) for location in self.locations]

    def close(self) -> None:
        for reader in self.readers:
            if isinstance(reader.rows.database, PostgresqlDatabase):
                reader.rows.database.execute(
                    f'DROP SCHEMA "{reader.location.partition("=")[2]}" CASCADE'
                )
            reader.close()

    def teardown(self) -> None:
        self.close()
        self.patch.undo()
        shutil.rmtree(self.root)

    def seen(self, where: Catalogue | Path) -> Table:
        """The rows of a catalogue."""
        with Catalogue.opened(where) as catalogue:
            records = {self.name(record.path): record for record in catalogue.records()}
        rows = {
            name: Row(r.id, self.hashes.get(r.content_hash), r.label)
            for name, r in records.items()
        }
        assert all(
            row.is_done == (records[name].status == "done") for name, row in rows.items()
        )
        return rows

    def fates(self, summary: Summary) -> Fates:
        found = {
            record.path: kind
            for kind in ("done", "failed", "held")
            for record in getattr(summary, kind)
        }
        found |= {
            path: f"copy of {self.name(original.path)}"
            for path, original in summary.duplicates
        }
        return {self.name(path): fate for path, fate in found.items()}

    def name(self, path: str) -> str:
        return str(Path(path).relative_to(self.folder))

    @rule(name=names_of_files, content=st.none() | numbers)
    def write(self, name: str, content: int | None) -> None:
        self.delete(name)
        file = self.folder / name
        file.symlink_to("nowhere") if content is None else file.write_bytes(
            contents()[content]
        )
        self.files[name] = content

    @rule(name=names_of_files)
    def delete(self, name: str) -> None:
        (self.folder / name).unlink(missing_ok=True)
        self.files.pop(name, None)

    @rule(old=names_of_files, new=names_of_files)
    def rename(self, old: str, new: str) -> None:
        if old in self.files:
            (self.folder / old).replace(self.folder / new)
            self.files[new] = self.files.pop(old)

    @rule(
        way=st.sampled_from(("folder", "file", "watch", "retry")),
        name=names_of_files,
        labels=classes,
        retries=st.booleans(),
        second=st.sampled_from((None, "removes", "ingests")),
    )
    def add(
        self,
        way: str,
        name: str,
        labels: dict[str, str],
        retries: bool,
        second: str | None,
    ) -> None:
        """While the first scan is processed, a second process may write; readers see each state."""
        readable = sorted(
            one for one, content in self.files.items() if content is not None
        )
        failed = sorted(
            (row.id, one) for one, row in self.table.items() if not row.is_done
        )
        names = {
            "folder": sorted(self.files),
            "file": [one for one in readable if one == name],
            "watch": readable,
            "retry": [one for _, one in failed],
        }[way]
        if way in ("retry", "watch"):
            labels, retries = {}, way == "retry"
        before = self.table
        for location, reader in (
            zip(self.locations, self.readers, strict=True) if names else ()
        ):
            table = self.table = dict(before)
            fates: Fates = {}
            turns: list[int] = []
            steps = ingest(table, self.files, names, fates, labels, retries)

            def meanwhile() -> None:
                while not next(steps):  # noqa: B023
                    pass
                assert self.seen(reader) == table  # noqa: B023
                rows = sorted((row.id, name) for name, row in table.items())  # noqa: B023
                first = rows[0][1] if rows else None
                if not turns and second == "removes" and first:  # noqa: B023
                    with Catalogue(location) as other:  # noqa: B023
                        other.remove(table.pop(first).id)  # noqa: B023
                if not turns and second == "ingests" and name in readable:  # noqa: B023
                    done = pr.ingest(self.folder / name, location, executor=remembered)  # noqa: B023
                    assert self.fates(done) == ingested(table, self.files, [name])  # noqa: B023
                turns.append(1)  # noqa: B023

            how = partial(remembered, meanwhile=meanwhile)
            given = {str(self.folder / name): label for name, label in labels.items()}
            if way == "retry":
                found = pr.retry(location, executor=how)
            elif way == "watch":
                found = next(
                    iter(pr.watch(self.folder, location, interval=0.001, executor=how))
                )
            else:
                scans = self.folder if way == "folder" else self.folder / name
                named: dict[str, Any] = {"labels": given, "retry_failed": retries}
                planned = pr.ingest(scans, location, dry_run=True, **named)
                found = pr.ingest(scans, location, executor=how, **named)
            for _ in steps:
                pass
            assert self.fates(found) == fates
            if way in ("folder", "file"):
                processed = {self.name(record.path) for record in planned.planned}
                assert (
                    self.fates(planned) | {name: fates[name] for name in processed}
                    == fates
                )
            assert found.unknown_labels == [
                path for path in given if self.name(path) not in names
            ]
            for record in found.failed if second != "removes" else ():
                is_kept = "; the catalogue keeps what was made of this" in str(
                    record.message
                )
                assert is_kept == table[self.name(record.path)].is_done

    @rule(transaction=st.integers(1, 5))
    def kill(self, transaction: int) -> None:
        """What an ingest had stored before it was killed is there, and nothing of what it was storing."""
        if self.files:
            running = [started(one, self.folder, transaction) for one in self.locations]
            ended = exit_codes(running)
            steps = ingest(self.table, self.files, sorted(self.files), {})
            n_steps = sum(1 for _ in zip(range(transaction), steps, strict=False))
            assert ended == {-signal.SIGKILL if n_steps >= transaction - 1 else 0}
            self.check()

    @rule()
    def backup_during_an_ingest(self) -> None:
        """A copy of a file is one of its states, though it is made page by page."""
        if self.files:
            states = [dict(self.table)]
            for _ in ingest(self.table, self.files, sorted(self.files), {}):
                states.append(dict(self.table))
            states.append(self.table)
            for location in self.locations:
                process = started(location, self.folder)
                while process.is_alive():
                    copy = self.root / f"{uuid4().hex}.sqlite"
                    pr.backup(location, copy)
                    assert "?" in location or self.seen(copy) in states
                assert process.exitcode == 0

    @rule()
    def ingest_twice_at_once(self) -> None:
        """Another ingest after that ends with what one after the other ends with; both make another."""
        if self.files:
            new = self.root / f"{uuid4().hex}.sqlite"
            assert exit_codes(
                [started(one, self.folder) for one in [*self.locations, str(new)] * 2]
            ) == {0}
            table: Table = {}
            ingested(table, self.files, sorted(self.files))
            assert self.seen(new) == table
            for location in self.locations:
                pr.ingest(self.folder, location, executor=remembered)
            for _ in range(2):
                ingested(self.table, self.files, sorted(self.files))

    @rule(number=st.integers(0, 3))
    def remove(self, number: int) -> None:
        name = dict(enumerate(sorted(self.table))).get(number)
        for location in self.locations:
            with Catalogue(location) as catalogue:
                if name is None:
                    with pytest.raises(InputError, match="holds no shape"):
                        catalogue.remove(
                            *(row.id for row in self.table.values()), "nobody"
                        )
                else:
                    catalogue.remove(self.table[name].id)
        self.table = {one: row for one, row in self.table.items() if one != name}

    @rule(
        shape_id=st.sampled_from("abx"),
        content=numbers,
        label=st.sampled_from((None, "cat")),
    )
    def keep(self, shape_id: str, content: int, label: str | None) -> None:
        """The search page keeps a scan under a name, unless that or the scan is there, or the scan fails."""
        scan, name = self.root / "scan.off", f"one/{shape_id}.off"
        scan.write_bytes(contents()[content])
        files, before = {**self.files, name: content}, self.table
        is_free = name not in self.files and shape_id not in {
            row.id for row in before.values()
        }
        for location in self.locations:
            self.table = dict(before)
            labels = {name: label} if label else {}
            fate = (
                ingested(self.table, files, [name], labels)[name]
                if is_free
                else "refused"
            )
            if fate == "failed" and not self.table[name].is_done:
                del self.table[name]
            with pytest.MonkeyPatch.context() as patch, suppress(InputError):
                patch.setattr(pr, "ingest", partial(pr.ingest, executor=remembered))
                keeping.Collection(location, self.folder / "one", 60, 1).add(
                    scan, shape_id, label
                )
                assert fate in ("done", "held")
                (self.folder / name).unlink()
            assert (name in self.files) == os.path.lexists(self.folder / name)
        if fate in ("done", "held"):
            self.write(name, content)

    @rule()
    def backup(self) -> None:
        for location in self.locations:
            copy = self.root / f"{uuid4().hex}.sqlite"
            pr.backup(location, copy)
            assert self.seen(copy) == self.table
        self.backups.append((copy, dict(self.table)))

    @rule(data=st.data(), in_place=st.booleans())
    def restore(self, data: st.DataObject, in_place: bool) -> None:
        if self.backups:
            copy, table = data.draw(st.sampled_from(self.backups))
            self.table = dict(table)
            if in_place and not self.server:
                self.close()
                shutil.copy(copy, self.locations[0])
                self.readers = [Catalogue(self.locations[0])]
            else:
                self.open([copy])

    @rule(data=st.data())
    def merge(self, data: st.DataObject) -> None:
        if self.backups:
            copy, other = data.draw(st.sampled_from(self.backups))
            whole = merged(self.table, other)
            n_added = sum(
                row.is_done > self.table.get(name, row).is_done
                for name, row in other.items()
            )
            n_added += len(other.keys() - self.table.keys())
            for location in self.locations:
                if isinstance(whole, str):
                    with pytest.raises(
                        CatalogueError,
                        match=f"with conflicts cannot be merged: .*({whole})",
                    ):
                        pr.merge_catalogues([copy], location)
                else:
                    found = pr.merge_catalogues([copy, copy], location)
                    assert found == MergedCatalogues(n_added, len(whole) - n_added)
            self.table = self.table if isinstance(whole, str) else whole

    @rule(n_shards=st.integers(1, 3))
    def shards(self, n_shards: int) -> None:
        """The shards of the files, merged in one order and in the other, are one ingest of all files."""
        if self.files:
            expected: Table = {}
            ingested(expected, self.files, sorted(self.files))
            parts = [self.root / f"{uuid4().hex}.sqlite" for _ in range(n_shards)]
            how: dict[str, Any] = {"options": OPTIONS, "executor": remembered}
            for number, part in enumerate(parts, 1):
                pr.ingest(self.folder, part, shard=f"{number}/{n_shards}", **how)
            for order in (parts, parts[::-1]):
                whole = self.root / f"{uuid4().hex}.sqlite"
                pr.merge_catalogues(order, whole)
                assert self.seen(whole) == expected

    @rule()
    def check(self) -> None:
        for location in self.locations:
            found = pr.check(location, sample=0)
            assert (found.defects, found.n_shapes + found.n_failed) == (
                (),
                len(self.table),
            )

    @invariant()
    def readers_agree(self) -> None:
        """Those that have been open from the start, and whatever they are asked."""
        done = {row.id: row for row in self.table.values() if row.is_done}
        ids = tuple(sorted(done))
        for reader in self.readers:
            assert self.seen(reader) == self.table
            table = pr.signatures(reader)
            assert (len(reader), table.ids, table.labels) == (
                len(ids),
                ids,
                tuple(done[i].label for i in ids),
            )
            assert reader.rows.labelled(["cat"]) == [
                one for one in ids if done[one].label == "cat"
            ]
            for one, values in zip(ids, table.values, strict=True):
                whole = MADE[contents()[done[one].content or 0]]
                assert (values == whole.signature).all()
                assert (reader.signature(one) == whole.signature).all()
                assert (reader.mesh(one).vertices == whole.shape.mesh.vertices).all()
            if ids:
                nearest = pr.index(reader).nearest(ids[0], k=len(ids))
                assert (sorted(nearest.ids), nearest.distances[0]) == ([*ids], 0)


def run(machine: type[Orders], n_orders: int) -> None:
    given = os.environ.get("PCRETRIEVE_SEED")
    chosen = settings(
        max_examples=int(os.environ.get("PCRETRIEVE_ORDERS", n_orders)),
        stateful_step_count=20,
        deadline=None,
        database=None,
        derandomize=given is None,
        suppress_health_check=[*HealthCheck],
    )
    run_state_machine_as_test(
        seed(int(given))(machine) if given else machine, settings=chosen
    )


def test_every_order_of_events() -> None:
    run(Orders, 12)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_every_order_of_events_in_a_file_and_in_a_database(postgresql: str) -> None:
    run(type("OrdersOfBoth", (Orders,), {"server": postgresql}), 200)
