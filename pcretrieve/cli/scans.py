"""Commands on scans without a catalogue: merge, reconstruct, signature."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import click

import pcretrieve as pr
from pcretrieve.cli.messages import Progress, escaped, failure_line, say, shown_path
from pcretrieve.cli.options import (
    CATALOGUE,
    Limits,
    Processes,
    ScanSettings,
    Settings,
    SignatureSettings,
    SurfaceSettings,
    argument,
    command,
    opened,
    option,
    refuse,
)
from pcretrieve.cli.output import (
    Result,
    failure_facts,
    print_text,
    prints_json,
    write_lines,
    write_steps,
    write_table,
)
from pcretrieve.errors import ShapeError

VIEWS = {"VIEW": "text", "OVERLAP": "number", "RMS": "number", "FILE": "text"}

MESH_SUFFIXES = (".ply", ".obj", ".off", ".stl", ".glb")


def each_scan(
    command: str,
    function: Callable[..., dict[str, Any]],
    paths: Path | Sequence[str],
    run: Processes,
    *,
    output: Path | None = None,
    suffix: str = "",
    kind: Literal["mesh"] | None = None,
    is_alone: bool = False,
) -> Iterator[dict[str, Any]]:
    """`map_scans` with progress, if there are several scans; the error of a scan alone is raised.

    Yields for JSON the path of each scan, and what the function returns of it, or its failure.
    """
    with Progress(command, run.progress) as shown:

        def start(total: int) -> None:
            if total > 1:
                shown.start(total)

        def advance(name: str, outcome: object) -> None:
            if not isinstance(outcome, ShapeError):
                shown.advance({"path": name, "status": "done"})
            elif not is_alone:
                stem = Path(name).stem
                facts = {"status": "failed", "seconds": 0.0, "id": stem, "path": name}
                shown.advance(
                    facts | failure_facts(outcome), failure_line(stem, outcome, name)
                )

        for name, outcome in pr.map_scans(
            function,
            paths,
            output=output,
            suffix=suffix,
            kind=kind,
            workers=run.workers,
            timeout=run.timeout,
            memory=run.memory,
            on_start=start,
            on_scan=advance,
        ):
            if is_alone and isinstance(outcome, ShapeError):
                raise outcome
            yield {"path": name} | (
                failure_facts(outcome) if isinstance(outcome, ShapeError) else outcome
            )


# --- merge ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Merging(Settings):
    """How views are merged."""

    refine: bool | None = option("--refine/--no-refine", sets="merge.refine")
    sensor: Literal["front", "origin"] | None = option(
        "--sensor WHERE", sets="merge.sensor"
    )
    background: Literal["none", "planes", "room"] | None = option(
        "--background WHAT", sets="merge.background"
    )
    keep_largest: bool | None = option("--keep-largest", sets="merge.keep_largest")
    max_range: float | None = option("--max-range LENGTH", sets="scan.max_range")


@command("merge")
def merge_command(
    *,
    paths: tuple[str, ...] = argument("VIEWS..."),
    output: Path = option(
        "--output -o CLOUD",
        "Write this point cloud: .ply, .pcd or .xyzn.",
    ),
    merging: Merging,
    limits: Limits,
) -> Result:
    """Merge views of one body, taken from different sides, into one scan.

    VIEWS are files, folders, glob patterns, a Stanford .conf file, or a folder of the TUM RGB-D benchmark.
    Views may come in any order and any pose. A view that fits no other is left out, and the exit code is 3.
    Lengths are in the unit of the files.

    \b
    pcretrieve merge bunny/*.ply -o bunny.ply
    pcretrieve merge frames/ --config depth-camera -o body.ply
    pcretrieve merge frames/ --sensor origin --max-range 1.5 -o body.ply
    """
    if not paths:
        raise click.UsageError("name at least two views, or one .conf")
    from pcretrieve.values.files import in_order

    if list(paths) == sorted(paths):  # as a shell names them: frame_1, frame_10, frame_2
        paths = tuple(map(str, in_order(map(Path, paths))))
    options = merging.options()
    merged = pr.merge_views(
        paths, options, output=output, timeout=limits.timeout, memory=limits.memory
    )
    (step,) = merged.cloud.provenance
    views: list[dict[str, object]] = []
    rows = []
    for number, name in enumerate(merged.names):
        overlap, rms = float(merged.shares[number]), merged.rms(number)
        view = {"path": name, "placed": False, "pose": None}
        row = ("left out", "-", "-", name)
        if number not in merged.left_out:
            view |= {"placed": True, "pose": merged.poses[number]}
            row = ("placed", f"{overlap:.1%}", f"{rms:.3g}", name)
        views.append(view | {"overlap": overlap, "rms": _number(rms)})
        rows.append(row)
    write_table(VIEWS, rows, err=True)
    for note in step.notes:
        say(note)
    say(
        f"placed {len(views) - len(merged.left_out)} of {len(views)} views, rms {merged.rms():.3g} "
        f"({merged.rms() / merged.scale:.2%} of a view's diagonal), {len(merged.cloud.points)} points, "
        f"{step.seconds:.1f} s: {output}"
    )
    document = {
        "cloud": output,
        "points": len(merged.cloud.points),
        "diagonal": merged.scale,
        "rms": _number(merged.rms()),
        "views": views,
        "overlaps": [asdict(overlap) for overlap in merged.overlaps],
        "notes": step.notes,
        "seconds": round(step.seconds, 3),
    }
    return Result(document, options, failed=merged.left_out)


def _number(value: float) -> float | None:
    """A number of JSON, which has no NaN."""
    return value if math.isfinite(value) else None


# --- reconstruct ---------------------------------------------------------------------------------------


@command("reconstruct")
def reconstruct_command(
    *,
    scan: Path = argument("SCAN|FOLDER"),
    output: Path = option(
        "--output -o MESH|FOLDER",
        f"Write this mesh ({' '.join(MESH_SUFFIXES)}); for a folder of scans, a folder.",
    ),
    suffix: str | None = option(
        "--suffix SUFFIX",
        "Format of the meshes of a folder of scans.  [default: .ply]",
        click.Choice(MESH_SUFFIXES),
    ),
    report: bool = option("--report", "Print each step, with what was repaired."),
    settings: SurfaceSettings,
    run: Processes,
) -> Result:
    """Turn a raw scan into a watertight surface, and write it to a mesh file.

    The surface is closed, manifold and oriented. Each scan of a folder gets a mesh of the same name.

    \b
    pcretrieve reconstruct scan.ply -o body.ply
    pcretrieve reconstruct scans/ -o meshes/ --workers 2
    """
    options, is_alone = settings.options(), not scan.is_dir()
    if is_alone and suffix is not None:
        raise click.UsageError(
            "--suffix is for folders: give the suffix of the mesh with -o"
        )
    # Printed at the end, because they would break a bar.
    found = list(
        each_scan(
            "reconstruct",
            partial(_reconstructed, options=options),
            scan,
            run,
            output=output,
            suffix=suffix or ".ply",
            kind="mesh",
            is_alone=is_alone,
        )
    )
    made = [facts for facts in found if "mesh" in facts]
    if not is_alone:
        say(
            f"{len(made)} surfaces are in {output}, {len(found) - len(made)} scans failed"
        )

    def show() -> None:
        for facts in made if report else ():
            if not is_alone:
                write_lines(shown_path(facts["path"]))
            write_steps(facts["steps"])
        if is_alone:
            words = (
                f"{name} {value:.6g}" if isinstance(value, float) else f"{name} {value}"
                for name, value in found[0].items()
                if name not in ("path", "steps")
            )
            say("  ".join(words))

    return Result(found[0] if is_alone else found, options, show, len(found) - len(made))


def _reconstructed(scan: Path, file: Path, options: pr.PipelineOptions) -> dict[str, Any]:
    """Write the surface of a scan, in a worker process, and measure it."""
    # A file has the first surface alone.
    mesh = pr.reconstruct(scan, options.changed(surface={"reconstructions": 1}))
    pr.write_mesh(mesh, file)
    return {
        "mesh": str(file),
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "euler": mesh.euler_characteristic,
        "area": mesh.area,
        "volume": mesh.volume,
        "steps": mesh.provenance,
    }


# --- signature -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Described(SignatureSettings, ScanSettings):
    """The signatures that are printed."""

    n_modes: int | None = option("--n-modes M", sets="signature.n_modes")


@command("signature")
def signature_command(
    *,
    paths: tuple[str, ...] = argument("[PATH|ID]..."),
    catalogue: str | None = option(
        "--from-catalogue FILE|URL",
        "Take shapes of a catalogue by id, or all of them, not scans.",
        CATALOGUE,
    ),
    described: Described,
    run: Processes,
) -> Result:
    """Print the signatures of scans, one line each: path, then values.

    With --from-catalogue, the lines begin with the id, and nothing is reconstructed again.

    \b
    pcretrieve lab signature body.obj
    pcretrieve lab signature scans/ --method shape-dna --json
    pcretrieve lab signature --from-catalogue bodies.sqlite T12 T17 --method wks
    """
    if catalogue is not None:
        own = ("config", "surface", "unit", "workers", "memory")
        refuse("a catalogue has options of its own", *own)
        store = opened(catalogue)
        options = described.options(store.options)
        rows = _of_catalogue(store, paths, options)
    else:
        if not paths:
            raise click.UsageError("name at least one scan")
        options = described.options()
        # On a terminal, the signatures themselves show the progress, and would break a bar.
        if run.progress == "bar" and not prints_json() and sys.stdout.isatty():
            run = replace(run, progress="none")
        rows = each_scan("signature", partial(_described, options=options), paths, run)
    failures: list[str] = []

    def counted() -> Iterator[dict[str, Any]]:
        for facts in rows:
            if "values" not in facts:
                failures.append(facts["path"])
            yield facts

    def show() -> None:
        for facts in counted():
            if "values" in facts:
                name = escaped(shown_path(facts.get("id") or facts["path"]))
                print_text(
                    "\t".join([name, *(f"{value:.9g}" for value in facts["values"])])
                )

    return Result(counted(), options, show, failures)


def _described(path: Path, options: pr.PipelineOptions) -> dict[str, Any]:
    """A signature and its seconds, in a worker process."""
    started = time.perf_counter()
    signature = pr.signature(path, options)
    return {"seconds": round(time.perf_counter() - started, 3)} | _facts(signature)


def _facts(signature: pr.Signature) -> dict[str, Any]:
    """What JSON has of a signature."""
    facts = {
        "kind": signature.kind,
        "unit": signature.unit,
        "values": signature.values.tolist(),
    }
    return (
        facts
        if signature.errors is None
        else facts | {"errors": signature.errors.tolist()}
    )


def _of_catalogue(
    store: pr.Catalogue, ids: tuple[str, ...], options: pr.PipelineOptions
) -> Iterator[dict[str, Any]]:
    """Id, path, and signature or failure of each shape of a catalogue."""
    for record in [store.record(shape_id) for shape_id in ids] or store.records(
        status="done"
    ):
        failure: pr.Record | ShapeError | None = (
            record if record.status == "failed" else None
        )
        facts: dict[str, Any] = {"id": record.id, "path": record.path}
        if failure is None:
            try:
                facts |= _facts(pr.stored_signature(store, record.id, options=options))
            except ShapeError as error:
                failure = error
        if failure is not None:
            say(failure_line(record.id, failure, record.path))
            facts |= failure_facts(failure)
        yield facts
