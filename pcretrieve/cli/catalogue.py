"""Commands that look after a catalogue: list, show, mark, remove, and the group `catalogue`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from datetime import datetime, timedelta
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Literal, get_args

import click

import pcretrieve as pr
from pcretrieve.cli.messages import Progress, may, say, shown_path, without_password
from pcretrieve.cli.options import (
    CATALOGUE,
    COMPARISON,
    COUNT,
    NUMBER,
    Comparison,
    argument,
    catalogue_option,
    command,
    complete_ids,
    opened,
    option,
    rare_option,
    refuse,
)
from pcretrieve.cli.output import (
    EXIT_ERROR,
    Columns,
    Result,
    check_one_form,
    print_text,
    write_csv,
    write_lines,
    write_steps,
    write_table,
    write_words,
)
from pcretrieve.errors import InputError
from pcretrieve.values import Decision

MIB = 1 << 20

START = {"ID": "text", "GRADE": "text", "CLASS": "text", "ERROR": "number"}
END = {"FILE": "path", "REASON": "words"}
FAILED = {"ID": "text", "STAGE": "text", "CLASS": "text"} | END
# Those of --csv, whose last one has the whole path.
CSV = (*START, "MARK", "NOTE", "STAGE", "REASON", "PATH")

# What `pr.stored_measures` returns.
MEASURES = ("height", "chest", "waist", "hip", "thigh", "volume")
NO_MEASURES = "none: they hold for people who stand with hanging arms, in a known unit"
COMPARED = ("FIRST", "SECOND", "DIFFERENCE", "USUAL FOR ONE PERSON", "ISO 20685 ALLOWS")
VERSUS = {"m, m³": "text"} | dict.fromkeys(COMPARED, "number")


@command("list")
def list_command(
    *,
    catalogue: str = catalogue_option,
    failed: bool = option("--failed", "Only shapes that failed, with the reason."),
    incomplete: bool = option(
        "--incomplete", "Only poor and incomplete scans, with all reasons."
    ),
    label: str | None = option("--class NAME", "Only shapes of this class."),
    marked: Literal[Decision, "any"] | None = option(
        "--marked", "Only shapes that `pcretrieve mark` has marked."
    ),
    worst: int | None = option(
        "--worst N", "The N worst: failed ones, then the largest errors.", COUNT
    ),
    as_csv: bool = option("--csv", "Print a CSV file."),
    measures: bool = rare_option(
        "--measures",
        "Add to --csv height, girths (m) and volume of people who stand, each with its error.",
    ),
    sort: Literal["id", "class", "added", "error"] = rare_option(
        "--sort", "By error, failed scans and large errors come first.", default="id"
    ),
    limit: int | None = rare_option("--limit N", "List at most N shapes.", COUNT),
    offset: int = rare_option("--offset N", "Skip N shapes.", NUMBER, default=0),
) -> Result:
    """List shapes: id, grade, class, expected error, path, and the first reason of the grade.

    The grade is good, poor, incomplete or failed; done means that it is not known. The error is that of the
    signature: two poses of a body are about .1 apart, two similar bodies .5.

    \b
    pcretrieve list --catalogue bodies.sqlite --worst 20
    pcretrieve list --catalogue bodies.sqlite --class p1 --csv
    """
    check_one_form(as_csv=as_csv)
    store = opened(catalogue, any_numbers=True)
    by_error = bool(worst) or sort == "error"
    _, ids = store.rows.wanted(
        label=label or "",
        state="failed" if failed else "incomplete" if incomplete else "",
        marked=marked or "",
        order="error" if by_error else "label" if sort == "class" else sort,
        descending=by_error,
        limit=worst or limit,
        offset=offset,
    )
    records = chain.from_iterable(store.rows.pages(ids))
    which = "failed" if failed else "incomplete" if incomplete else "stored"

    def show() -> None:
        if as_csv:
            _write_csv(store, records, measures)
            return
        columns = FAILED if failed else START | END
        if store.rows.wanted(marked="any", limit=1)[0]:
            columns = {"ID": "text", "MARK": "text"} | columns
        row = partial(_row, columns=columns, is_whole=which == "incomplete")
        if not write_table(columns, map(row, records)):
            after = f" after the first {offset}" if offset else ""
            such = "of this kind" if label or marked else which
            say(f"no shape is {such} in {catalogue}{after}")

    return Result(map(_facts, records), show=show)


def _facts(record: pr.Record) -> dict[str, object]:
    return asdict(record) | {"seconds": round(record.seconds, 3)}


def cells_of(record: pr.Record) -> dict[str, str]:
    """The cells of a shape, by heading; empty where nothing is known."""
    grade = record.grade
    reasons = [record.message] if record.message else grade.reasons if grade else ()
    return {
        "ID": record.id,
        "MARK": record.mark or "",
        "NOTE": record.note or "",
        "GRADE": grade.name if grade else record.status,
        "STAGE": record.stage or "",
        "CLASS": record.label or "",
        "ERROR": "" if grade is None else f"{grade.error:.2f}",
        "REASON": "".join(reasons[:1]).removeprefix(f"{record.path}: "),
        "FILE": shown_path(record.path),
        "PATH": record.path,
    }


def _write_csv(store: pr.Catalogue, records: Iterable[pr.Record], measures: bool) -> None:
    from pcretrieve.values.files import csv_text

    names = (
        [f"{name}{end}" for name in MEASURES for end in ("", " ±")] if measures else []
    )

    def row(record: pr.Record) -> list[object]:
        cells = cells_of(record)
        found = pr.stored_measures(store, record.id) if measures else {}
        numbers = [f"{one:.4f}" for pair in found.values() for one in pair]
        return [*map(cells.__getitem__, CSV), *numbers]

    write_csv(csv_text([*map(str.lower, CSV), *names], map(row, records)))


def _row(record: pr.Record, columns: Columns, *, is_whole: bool) -> list[str]:
    """The cells of a shape, with all reasons of its grade or with the first one."""
    cells = cells_of(record)
    if is_whole:
        cells["REASON"] = str(record.grade)
    cells["REASON"] = "; ".join(filter(None, (record.note, cells["REASON"])))
    # Before the last cell, an empty one would be taken for the next column.
    return [cells[name] or ("" if name == "REASON" else "-") for name in columns]


@command("show")
def show_command(
    shape_id: str = argument("ID", shell_complete=complete_ids),
    catalogue: str = catalogue_option,
    other: str | None = option(
        "--versus ID",
        "Compare its measures with those of this shape.",
        shell_complete=complete_ids,
    ),
) -> Result:
    """Show how a shape was made: its file, each step, and the size of what is stored.

    \b
    pcretrieve show cat0 --catalogue bodies.sqlite
    pcretrieve show anna-1 --versus anna-2 --catalogue people.sqlite
    """
    store = opened(catalogue, any_numbers=True)
    if other is not None:
        compared = pr.compare_measures(store, shape_id, other)
        shown = {name: one._asdict() for name, one in compared.items()}
        rows = [(name, *map(_number, one)) for name, one in compared.items()]
        return Result(shown, show=lambda: _show_versus(rows))
    record, stored = store.record(shape_id), store.rows.stored_bytes(shape_id)
    measures = pr.stored_measures(store, shape_id)
    return Result(
        _facts(record) | {"stored_bytes": stored, "measures": measures},
        show=lambda: _show(record, stored, measures),
    )


def _show_versus(rows: list[tuple[str, ...]]) -> None:
    if not write_table(VERSUS, rows):
        say(NO_MEASURES)


def _number(value: float | tuple[float, float] | None) -> str:
    """A measure with its ±, a difference, or what it is beside."""
    if isinstance(value, tuple):
        return " ± ".join(f"{one:.3f}" for one in value)
    return "" if value is None else f"{value:.3f}"


def _show(
    record: pr.Record,
    stored: dict[str, int],
    measures: dict[str, tuple[float, float]],
) -> None:
    shown = asdict(record) | {
        "path": shown_path(record.path),
        "versions": ", ".join(
            f"{package} {version}" for package, version in record.versions.items()
        ),
        "grade": None if record.status == "failed" else str(record.grade or "not known"),
        "steps": None,
    }
    rows = [(name, str(value)) for name, value in shown.items() if value is not None]
    if record.metres_per_unit:
        text = ", ".join(f"{name} {_number(pair)}" for name, pair in measures.items())
        rows.append(("measures", f"{text} (m, m³)" if text else NO_MEASURES))
    parts = ", ".join(
        f"{name} {size / 1000:.1f}" for name, size in stored.items() if size
    )
    rows.append(
        (
            "stored",
            f"{sum(stored.values()) / 1000:.1f} kB" + (f": {parts}" if parts else ""),
        )
    )
    write_table({"": "text", " ": "words"}, rows)
    print_text("")
    write_steps(record.steps)


@command("mark")
def mark_command(
    words: tuple[str, ...] = argument(
        "ID... [rescan|accept|note] [TEXT]", shell_complete=complete_ids, required=True
    ),
    catalogue: str = catalogue_option,
    clear: bool = option("--clear", "Forget what was decided."),
) -> Result:
    """Keep what you decide about scans: to scan again, to accept, or a note.

    `list --marked rescan` shows what is to be scanned again. A decision stays when scans are processed again,
    merged or backed up, until the file has another content.

    \b
    pcretrieve mark cat0 rescan "the left foot is missing" -c bodies.sqlite
    pcretrieve mark cat0 cat1 accept -c bodies.sqlite
    pcretrieve mark cat0 --clear -c bodies.sqlite
    """
    ids, decision, note = (words, None, None) if clear else _decision(words)
    ids = tuple(dict.fromkeys(ids))
    pr.mark(catalogue, ids, decision, note)
    done = "cleared" if decision is None else f"marked ({decision})"
    say(f"{done}: {', '.join(ids)}")
    return Result({"ids": ids, "mark": decision, "note": note})


def _decision(
    words: tuple[str, ...],
) -> tuple[tuple[str, ...], str, str | None]:
    """The ids, the decision and the text in the words of a command."""
    known = get_args(Decision)
    if len(words) > 2 and words[-2] in known:
        return words[:-2], words[-2], words[-1]
    if len(words) > 1 and words[-1] in known:
        return words[:-1], words[-1], None
    raise click.UsageError(
        "after the ids, write rescan, accept or note, and then, in quotes, why; or give --clear"
    )


@command("remove")
def remove_command(
    shape_ids: tuple[str, ...] = argument("[ID]...", shell_complete=complete_ids),
    catalogue: str = catalogue_option,
    before: datetime | None = option(
        "--before DATE",
        "Remove the shapes that were stored before this day, such as 2026-01-31 (UTC).",
        click.DateTime(("%Y-%m-%d",)),
    ),
    dry_run: bool = option(
        "--dry-run", "Show what would be removed, and remove nothing."
    ),
    yes: bool = option("--yes", "Remove several shapes without a question."),
) -> Result:
    """Remove shapes from a catalogue, and their bytes from its file. The scans stay where they are.

    On a terminal, several shapes are removed after a question only.

    \b
    pcretrieve remove cat0 cat1 --catalogue bodies.sqlite
    pcretrieve remove --before 2026-01-31 --catalogue bodies.sqlite
    """
    if bool(shape_ids) == (before is not None):
        raise click.UsageError("give the ids of shapes, or --before, and not both")
    chosen = dict.fromkeys(shape_ids)
    with pr.Catalogue(catalogue) as store:
        if before is not None:
            last = (before.date() - timedelta(1)).isoformat()
            chosen = dict.fromkeys(store.rows.wanted(days=("0", last))[1])
        paths = {record.id: record.path for record in store.rows.several(chosen)}
        for shape_id in chosen:
            if shape_id not in paths:
                raise store.rows.unknown(shape_id)
        question = f"Remove {len(chosen)} shapes from {catalogue}?"
        if dry_run:
            say(
                f"would remove {len(chosen)} from {catalogue}: {', '.join(chosen) or 'none'}"
            )
            return Result({"chosen": [*chosen], "removed": []})
        if len(chosen) > 1 and not yes and not may(question, otherwise=True):
            raise InputError("nothing was removed; --yes removes without a question")
        if chosen:
            store.remove(*chosen)
        is_file = store.rows.database.is_file
    say(f"removed {len(chosen)} from {catalogue}")
    files = [path for path in paths.values() if Path(path).exists()]
    if chosen:
        scans = f"their {len(files)} scans, and copies" if files else "copies"
        server = "" if is_file else ", and PostgreSQL keeps the bytes until VACUUM"
        say(f"not removed: {scans} elsewhere, such as backups, exports and pages{server}")
    return Result({"chosen": [*chosen], "removed": [*chosen], "files": files})


@command("merge")
def merge_command(
    parts: tuple[str, ...] = argument("PART...", CATALOGUE, required=True),
    output: str = option(
        "--output -o FILE|URL",
        "Store the shapes in this catalogue, which may have shapes already.",
        CATALOGUE,
    ),
) -> Result:
    """Store the shapes of several catalogues in one.

    PART is a file or a URL, such as the catalogue of one task of a job array (`ingest --shard`). All parts
    need the same settings. If parts share a file, its first finished shape is kept. If a file has two
    contents or two classes, or an id belongs to two files, the command names it and stores nothing.

    \b
    pcretrieve catalogue merge part-*.sqlite -o all.sqlite
    """
    merged = pr.merge_catalogues(parts, output)
    say(f"{merged.n_added} added, {merged.n_held} known already: {output}")
    return Result(asdict(merged))


@command("check")
def check_command(
    catalogue: str = catalogue_option,
    sample: int = option(
        "--sample N",
        "Compute N signatures again, from stored surfaces or unchanged files.",
        NUMBER,
        default=10,
    ),
    repair: bool = option(
        "--repair",
        "Remove damaged shapes, to be ingested again, damaged indexes, and rows without a shape.",
    ),
    remote: bool = option(
        "--remote",
        "Fetch scans at URLs that the catalogue names, without a question.",
    ),
) -> Result:
    """Check a catalogue for damage: its file, each record, all arrays, and some signatures.

    The exit code is 1 if damage is left.

    \b
    pcretrieve catalogue check -c bodies.sqlite --repair
    """
    with pr.Catalogue(catalogue) as store, Progress("check", "bar") as shown:
        shown.start(len(store) + sum(store.rows.failures().values()))
        allowed = remote or _may_fetch
        result = pr.check(
            store,
            sample=sample,
            repair=repair,
            remote=allowed,
            on_shapes=lambda _: shown.advance({}),  # one at a time
        )
        options = store.options
    document = {
        "catalogue": without_password(catalogue),
        "is_whole": result.is_whole,
    } | asdict(result)
    show = partial(_write_check, catalogue, result)
    return Result(
        document, options, show, failed=not result.is_whole, exit_code=EXIT_ERROR
    )


def _may_fetch(hosts: Sequence[str]) -> bool:
    question = f"The catalogue names scans at {', '.join(hosts)}. Fetch them?"
    return may(question, otherwise=False)


def _write_check(catalogue: str, result: pr.Check) -> None:
    write_table(
        {"SHAPE": "text", "REPAIR": "text", "DEFECT": "words"},
        (
            (one.shape_id or "-", one.repair or "not repaired", one.message)
            for one in result.defects
        ),
    )
    if any(defect.kind == "database" and not defect.repair for defect in result.defects):
        say(
            "the file is damaged, and cannot be repaired: restore a backup, or ingest into a new one"
        )
    n_defects, n_left = (
        len(result.defects),
        sum(defect.repair is None for defect in result.defects),
    )
    write_words(
        f"{catalogue}: {result.n_shapes} shapes, {result.n_failed} failed, {result.n_recomputed} signatures "
        f"computed again, {n_defects} defects"
        + (f", {n_left} not repaired" if n_left else "")
        + f"; SQLite {result.sqlite_version}"
    )


@command("backup")
def backup_command(
    catalogue: str = argument("CATALOGUE", CATALOGUE),
    file: Path = argument("FILE", click.Path(dir_okay=False, path_type=Path)),
    without_names: bool = option(
        "--without-names",
        "To give the catalogue away: ids are numbers; no paths, classes, times, notes or failures.",
    ),
) -> Result:
    """Copy a catalogue to one file, while others may use it.

    The copy is a catalogue itself, in SQLite. For large databases `pg_dump` is faster.

    \b
    pcretrieve catalogue backup bodies.sqlite bodies-monday.sqlite
    """
    say(f"copying {catalogue}")
    size = pr.backup(catalogue, file, names=not without_names)
    say(f"{size / MIB:.1f} MiB: {file}")
    return Result({"file": str(file), "bytes": size})


@command("export")
def export_command(
    *,
    shape_ids: tuple[str, ...] = argument("[ID]..."),
    catalogue: str = catalogue_option,
    output: Path = option(
        "--output -o PATH",
        "Write a mesh of one shape (.ply .obj .off .stl .glb), a folder of meshes, or a file of "
        "signatures (.npz .parquet .csv).",
    ),
    signatures: bool = option(
        "--signatures", "Write signatures, ids and classes, not meshes."
    ),
    comparison: Comparison,
) -> Result:
    """Write meshes or signatures of a catalogue to files.

    \b
    pcretrieve catalogue export cat0 -c bodies.sqlite -o cat0.obj
    pcretrieve catalogue export -c bodies.sqlite -o meshes/
    pcretrieve catalogue export --signatures -c bodies.sqlite -o bodies.parquet
    """
    if not signatures:
        refuse("meshes have no such options, which are for --signatures", *COMPARISON)
    store = opened(catalogue, any_numbers=not signatures)
    options = comparison.options(store.options) if signatures else None
    if options is not None:
        table = pr.signatures(store, options=options)
        pr.write_signatures(table.select(shape_ids) if shape_ids else table, output)
        files = [output]
    else:
        files = _export_meshes(store, shape_ids, output)
        if output.is_dir():
            say(f"wrote {len(files)} meshes to {output}")
    show = partial(write_lines, *map(str, files))
    return Result({"files": files}, options, show)


def _export_meshes(
    store: pr.Catalogue, shape_ids: tuple[str, ...], output: Path
) -> list[Path]:
    """Write a mesh of one shape, or a folder of meshes; nothing, if one of the meshes is missing."""
    from pcretrieve.values.files import check_no_links, make_folder

    if len(shape_ids) == 1 and output.suffix and not output.is_dir():
        pr.write_mesh(store.mesh(shape_ids[0]), output)
        return [output]
    for shape_id in shape_ids:
        store.mesh(shape_id)
    chosen = shape_ids or [record.id for record in store.records(status="done")]
    # Ids are names of files, but a catalogue from elsewhere may have any.
    names = {one: one.replace("/", "%2F").replace("\0", "%00") + ".ply" for one in chosen}
    files = {shape_id: output / name for shape_id, name in names.items()}
    check_no_links(files.values())
    make_folder(output)
    for shape_id, file in files.items():
        pr.write_mesh(store.mesh(shape_id), file)
    return list(files.values())
