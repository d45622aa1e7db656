"""A function of one scan → what it returns for each of many scans, computed by worker processes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar

from pcretrieve.errors import InputError, PcretrieveError, ShapeError, Stage
from pcretrieve.formats import ScanPath
from pcretrieve.formats.files import check_output
from pcretrieve.formats.identity import printable
from pcretrieve.ingestion.discover import discover, shape_ids
from pcretrieve.ingestion.pool import in_processes
from pcretrieve.values.files import check_no_links, make_folder

Found = TypeVar("Found")


class _Task(NamedTuple):
    """A scan, and the file that is written for it."""

    path: ScanPath
    file: Path | None


def map_scans(
    function: Callable[..., Found],
    paths: str | Path | Sequence[str | Path],
    *,
    output: str | Path | None = None,
    suffix: str = "",
    kind: Literal["point", "mesh"] | None = None,
    workers: int | None = None,
    timeout: float = 600.0,
    memory: float | None = None,
    on_start: Callable[[int], None] = lambda number: None,
    on_scan: Callable[[str, Any], None] = lambda name, outcome: None,
) -> Iterator[tuple[str, Found | ShapeError]]:
    """Apply a function to each of many scans, in worker processes, which may crash, hang or fill the memory.

    A script that calls this function needs the guard ``if __name__ == "__main__":``, because worker processes
    are spawned.

    Parameters
    ----------
    function : function of a Path, or of two
        Such as `reconstruct` or `signature`; it and its result must be picklable. With an `output`, its
        second argument is the file to write.
    paths : str, Path, or a sequence of them
        Files, folders, globs or manifests, as for `ingest`.
    output : str or Path, optional
        The file that is written for the one scan; for scans in a folder, a folder of files named like them.
    suffix : str, optional
        The suffix of the files in the folder.
    kind : {"point", "mesh"}, optional
        Whether the function writes a cloud or a mesh, to check the suffix of `output` before the work.
    workers, timeout, memory : object, optional
        As for `ingest`.
    on_start : function, optional
        Called with the number of scans.
    on_scan : function, optional
        Called with the name of each scan and its outcome as soon as it is known.

    Yields
    ------
    name : str
        The path of the scan; the scans are in their order.
    outcome : object or ShapeError
        What the function returns, or the error of a scan that cannot be processed.

    Raises
    ------
    InputError
        If a path does not exist or names no scans, or the output cannot be written or is among the scans.
    """
    limits: dict[str, Any] = {"workers": workers, "timeout": timeout, "memory": memory}
    given = [paths] if isinstance(paths, (str, Path)) else paths
    scans = discover(given, limits=limits)
    if output is None:
        tasks = [_Task(scan, None) for scan in scans]
    else:
        tasks = _writing([*map(Path, given)], scans, Path(output), suffix, kind)
    on_start(len(tasks))
    finished: dict[_Task, Found | ShapeError] = {}
    remaining = iter(tasks)
    upcoming = next(remaining, None)
    with closing(in_processes(_Applied(function), tasks, **limits)) as running:
        for task, outcome in running:
            if isinstance(outcome, PcretrieveError):
                if not isinstance(outcome, ShapeError):
                    raise outcome
                outcome.stage = str(outcome.stage or Stage.WORKER)
                outcome.message = printable(outcome.message)
            finished[task] = outcome
            on_scan(printable(task.path), outcome)
            while upcoming in finished:
                yield printable(upcoming.path), finished.pop(upcoming)
                upcoming = next(remaining, None)


@dataclass(frozen=True, slots=True)
class _Applied:
    """What a worker does with a scan."""

    function: Callable[..., Any]

    def prepare(self) -> None:
        from pcretrieve.pipeline.process import compile_stages

        compile_stages()

    def __call__(self, task: _Task) -> Any:
        path = Path(str(task.path))
        return (
            self.function(path) if task.file is None else self.function(path, task.file)
        )


def _writing(
    paths: Sequence[Path],
    scans: Sequence[ScanPath],
    output: Path,
    suffix: str,
    kind: Any,
) -> list[_Task]:
    """Each scan with its file, in a folder that is made, or the only one with the file."""
    folders = [path for path in paths if path.is_dir()]
    if not folders and len(scans) > 1:
        raise InputError(
            f"{paths[0]} names {len(scans)} scans: name one of them, such as {scans[0]}"
        )
    if not folders:
        check_output(output, [scan.file for scan in scans], kind)
        return [_Task(scans[0], output)]
    for folder in folders:
        if output.resolve().is_relative_to(folder.resolve()):
            raise InputError(
                f"{output} is in {folder}, whose files are read: name another folder with -o"
            )
    make_folder(output)
    names = shape_ids({printable(scan): scan for scan in scans}, {}).values()
    files = [output / f"{name}{suffix}" for name in names]
    check_no_links(files)
    return list(map(_Task, scans, files))
