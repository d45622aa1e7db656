"""Many scans → catalogue, over isolated workers."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, TimeoutError, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from multiprocessing import resource_tracker
from pathlib import Path

from pcretrieve.catalogue import Catalogue, Content, Record
from pcretrieve.errors import PcretrieveError, ShapeError, StageTimeout, WorkerDied
from pcretrieve.ingest import work
from pcretrieve.ingest.plan import failed, plan

__all__ = ["Summary", "ingest"]

# Shapes handed to the pool ahead of each worker: enough that none waits, few enough that Ctrl-C is prompt.
AHEAD = 2


@dataclass(slots=True)
class Summary:
    """What an ingest did.

    Attributes
    ----------
    done : list of Record
        Processed now.
    failed : list of Record
        Failed now. A shape that finished in an earlier run keeps its place in the catalogue.
    held : list of Record
        Skipped: the catalogue has the same content already, done or failed, under that path, or under one
        that is gone since.
    duplicates : list of (Path, Record)
        Skipped: the same content under another path.
    unknown_labels : list of str
        Names in the label file that stand for none of the scans.
    """

    done: list[Record] = field(default_factory=list)
    failed: list[Record] = field(default_factory=list)
    held: list[Record] = field(default_factory=list)
    duplicates: list[tuple[Path, Record]] = field(default_factory=list)
    unknown_labels: list[str] = field(default_factory=list)


def ingest(
    paths: Sequence[Path],
    catalogue: Catalogue,
    *,
    labels: Mapping[str, str] | None = None,
    workers: int = 1,
    timeout: float = 600.0,
    memory: float | None = None,
    retry_failed: bool = False,
    on_shape: Callable[[Record], None] = lambda record: None,
) -> Summary:
    """Process scans and store them, failures included.

    Shapes are processed in worker processes, so that one that hangs, crashes or fills the memory takes no
    other with it; what is finished is stored at once, so that an interrupted run can be started again and
    goes on.

    Parameters
    ----------
    paths : sequence of Path
        As from `discover`.
    catalogue : Catalogue
    labels : mapping of name to class, optional
        As from `read_labels`. Also applied to scans that the catalogue holds already.
    workers : int, default 1
        Processes.
    timeout : float, default 600
        Longest time for one shape; seconds.
    memory : float, optional
        Largest heap of one worker; GiB.
    retry_failed : bool, default False
        Process scans again that failed before, with the same content and options.
    on_shape : callable, optional
        Called with each record once it is stored, and with those skipped.
    """
    todo = plan(paths, catalogue.records(), labels or {}, retry_failed=retry_failed)
    catalogue.revise(moved=todo.moved, removed=todo.removed, labels=todo.labels)
    summary = Summary(
        held=list(todo.held), duplicates=list(todo.duplicates), unknown_labels=list(todo.unknown_labels)
    )
    for record in (*todo.held, *(twin for _, twin in todo.duplicates)):
        on_shape(record)

    def store(record: Record, content: Content | None) -> None:
        stored = catalogue.put(record, content)
        if content is None:
            stored = _reported(record, stored)
        (summary.failed if content is None else summary.done).append(stored)
        on_shape(stored)

    for record in todo.unreadable:
        store(record, None)
    if not todo.process:
        return summary
    for record, outcome in _outcomes(
        todo.process, catalogue, min(workers, len(todo.process)), timeout, memory
    ):
        if isinstance(outcome, ShapeError):
            store(failed(record, outcome), None)
        else:
            store(replace(record, steps=outcome.shape.provenance), outcome)
    return summary


def _reported(failure: Record, stored: Record) -> Record:
    """A failure as it is reported, which says where the catalogue keeps an earlier result instead."""
    if stored.status == "failed":
        return stored
    kept = f"{failure.message}; the catalogue keeps what was made of this file on {stored.added}"
    return replace(failure, id=stored.id, message=kept)


def _outcomes(
    queue: Sequence[tuple[Path, Record]],
    catalogue: Catalogue,
    workers: int,
    timeout: float,
    memory: float | None,
) -> Iterator[tuple[Record, Content | ShapeError]]:
    """Each record with what came of it, in the order that they finish."""
    from pebble import ProcessPool

    # Open3D has threads, so workers must be spawned, not forked.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPool(max_workers=workers, context=context, initializer=work.prepare, initargs=(memory,))
    waiting = iter(queue)
    running: dict[Future[Content], Record] = {}
    try:
        while True:
            while len(running) < workers * (1 + AHEAD) and (scan := next(waiting, None)) is not None:
                path, record = scan
                with _interrupts_blocked():
                    future = pool.schedule(work.content, args=(path, catalogue.options), timeout=timeout)
                running[future] = record
            if not running:
                break
            finished, _ = wait(running, return_when=FIRST_COMPLETED)
            for ended in finished:
                error = ended.exception()
                yield running.pop(ended), ended.result() if error is None else _cause(error, timeout)
        pool.close()
    except BaseException:
        pool.stop()
        raise
    finally:
        pool.join()


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Threads and processes started in here never see Ctrl-C, not even while they still import.

    The terminal sends it to all of them; the process that holds the catalogue decides what it means.
    """
    # It is started with the first worker, and would lift the block.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _cause(error: BaseException, timeout: float) -> ShapeError:
    """What became of a shape that brought no answer; raises what is not that shape's fault."""
    from pebble import ProcessExpired

    if isinstance(error, ShapeError):
        return error
    if isinstance(error, TimeoutError):
        return StageTimeout(f"not finished within {timeout:g} s: raise --timeout and give --retry-failed")
    if isinstance(error, ProcessExpired):
        return WorkerDied(
            f"the process that worked on it ended with {_exit_text(error.exitcode)}, perhaps for want of "
            "memory: raise --memory if you gave it, or lower --workers, and give --retry-failed"
        )
    if isinstance(error, BrokenProcessPool):
        raise PcretrieveError(
            "the worker processes ended before they could take a shape, perhaps for want of memory: raise "
            "--memory if you gave it, or lower --workers"
        ) from error
    raise error


def _exit_text(code: int) -> str:
    """How a process ended, in words: ``exit code 1``, ``SIGKILL``."""
    return f"exit code {code}" if code >= 0 else signal.Signals(-code).name
