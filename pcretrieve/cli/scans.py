"""Commands on scans without a catalogue: merge, reconstruct, signature."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

import pcretrieve as pr
from pcretrieve.cli import options as opt
from pcretrieve.cli import output as out
from pcretrieve.cli.messages import Progress, bar, failure_line, say, shown_path, stop_waiting
from pcretrieve.errors import PcretrieveError, ShapeError, Stage

if TYPE_CHECKING:
    from pcretrieve.points.register import Merged
    from pcretrieve.values import Failure

Answer = TypeVar("Answer")


def scans_options(command: opt.Decorated) -> opt.Decorated:
    """Options of commands that work on many scans in processes, which `each_scan` takes."""
    return opt.workers_option(opt.limit_options(opt.progress_option(command)))


def alone(function: Callable[..., Answer], *arguments: Any, timeout: float, memory: float | None) -> Answer:
    """Call a function in a process of its own, which may crash, hang or fill the memory."""
    from pcretrieve.ingestion import alone as call_alone

    return call_alone(function, *arguments, timeout=timeout, memory=memory)


def each_scan(
    command: str,
    function: Callable[[Path], Answer],
    scans: Sequence[Path],
    *,
    workers: int | None,
    progress: str | None,
    **limits: Any,
) -> Iterator[tuple[Path, Answer | Failure]]:
    """Apply a function to scans in processes, in their order, and show progress if there are several."""
    from pcretrieve.ingestion import in_processes
    from pcretrieve.ingestion.discover import printable

    finished: dict[Path, Answer | Failure] = {}
    n_yielded = 0
    shown = Progress(command, (progress if len(scans) > 1 else None) or "none")
    shown.start(len(scans))
    running = in_processes(function, scans, workers=workers, **limits)
    with closing(running), shown:
        for path, outcome in running:
            name = printable(path)
            if isinstance(outcome, PcretrieveError):
                finished[path] = failure = failure_of(Path(name).stem, outcome)
                facts: dict[str, object] = {"status": "failed", "seconds": 0.0, "id": failure.shape_id}
                facts |= {"path": name, "stage": failure.stage, "error": failure.error}
                shown.advance(facts | {"message": failure.message}, failure_line(failure, name))
            else:
                finished[path] = outcome
                shown.advance({"path": name, "status": "done"})
            while n_yielded < len(scans) and scans[n_yielded] in finished:
                yield scans[n_yielded], finished.pop(scans[n_yielded])
                n_yielded += 1


def failure_of(shape_id: str, error: PcretrieveError) -> Failure:
    """What is known of a scan that failed; errors that are not failures of a scan are raised."""
    from pcretrieve.ingestion.discover import printable
    from pcretrieve.values import Failure

    if not isinstance(error, ShapeError):
        raise error
    stage = str(error.stage or Stage.WORKER)
    return Failure(shape_id, stage, type(error).__name__, printable(error.message))


def failure_document(failure: Failure) -> dict[str, object]:
    """The JSON document of a failure, in place of that of a result."""
    return {"error": failure.error, "stage": failure.stage, "message": failure.message}


def output_files(folder: Path, scans: Sequence[Path], source: Path, suffix: str) -> dict[Path, Path]:
    """Name a file for each scan of a folder, and make the folder in which the files are written."""
    from pcretrieve.errors import InputError
    from pcretrieve.ingestion.discover import printable, shape_ids

    if folder.resolve().is_relative_to(source.resolve()):
        raise InputError(f"{folder} is in {source}, whose files are read: name another folder with -o")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder {folder}: {error.strerror}; name another") from error
    ids = shape_ids([printable(scan) for scan in scans], {})
    return {scan: folder / f"{ids[printable(scan)]}{suffix}" for scan in scans}


# --- merge ---------------------------------------------------------------------------------------------


@opt.command("merge")
@click.argument("paths", nargs=-1, metavar="VIEWS...")
@opt.option("--output -o CLOUD", "Write this point cloud: .ply, .pcd or .xyzn.", opt.PATH, required=True)
@opt.option("--refine/--no-refine", "Refine known poses, or use them as they are.", default=None)
@opt.option(
    "--sensor",
    "Where the sensor is, if files do not say: far away in front, as of range scanners, or at "
    "the origin, as of depth cameras.  [default: front]",
    ("front", "origin"),
)
@opt.option("--max-range LENGTH", "Remove points farther from the sensor.", float)
@opt.option("--background", "Remove floors and walls (planes).  [default: none]", ("none", "planes"))
@opt.option("--keep-largest", "Keep the largest piece of each view.", default=None)
@opt.config_option
@partial(opt.limit_options, unit="view")
@opt.json_option
def merge_command(
    paths: tuple[str, ...],
    output: Path,
    config: Path | None,
    timeout: float,
    memory: float | None,
    as_json: bool,
    **chosen: Any,
) -> None:
    """Merge views of one body, taken from different sides, into one scan.

    VIEWS are files, folders, glob patterns, a Stanford .conf file, or a folder of the TUM RGB-D benchmark.
    Views may come in any order and any pose. A view that fits no other is left out, and the exit code is 3.
    Lengths are in the unit of the files.

    \b
    pcretrieve merge bunny/*.ply -o bunny.ply
    pcretrieve merge frames/ --config depth-camera -o body.ply
    pcretrieve merge frames/ --sensor origin --max-range 1.5 -o body.ply
    """
    from pcretrieve.formats import check_output
    from pcretrieve.ingestion.discover import printable
    from pcretrieve.ingestion.views import view_files

    if not paths:
        raise click.UsageError("name at least two views, or one .conf")
    given = {name: value for name, value in chosen.items() if value is not None}
    options = opt.load_options(config).changed(merge=given)
    files, _ = view_files(paths)
    check_output(output, files, "point")
    stop_waiting()  # the process of the registration shows a bar
    merged = alone(_merged, paths, options.merge, timeout=timeout * len(files), memory=memory)
    pr.write_cloud(merged.cloud, output)
    names = [printable(file) for file in files]
    _say_residuals(merged, names, output)
    if as_json:
        out.write_document(_merge_document(merged, names, output), options=options)
    opt.exit_if(merged.left_out)


def _merged(paths: Sequence[str], options: pr.MergeOptions) -> Merged:
    """Merge views in a worker process, which imports Open3D, and shows its progress on standard error."""
    with bar(unit="pair", desc="merge", disable=None) as shown:

        def on_pair(done: int, total: int) -> None:
            shown.total = total
            shown.update(done - shown.n)

        return pr.merge_views(paths, options, on_pair=on_pair)


def _say_residuals(merged: Merged, names: Sequence[str], output: Path) -> None:
    """Print a table of the views, with their overlaps and residuals."""
    say(f"{'view':<8}  {'overlap':>7}  {'rms':>10}  file")
    for number, name in enumerate(names):
        if number in merged.left_out:
            say(f"{'left out':<8}  {'-':>7}  {'-':>10}  {name}")
        else:
            say(f"{'placed':<8}  {merged.shares[number]:7.1%}  {merged.rms(number):10.3g}  {name}")
    (step,) = merged.cloud.provenance
    for note in step.notes:
        say(note)
    say(
        f"placed {len(names) - len(merged.left_out)} of {len(names)} views, rms {merged.rms():.3g} "
        f"({merged.rms() / merged.scale:.2%} of a view's diagonal), {len(merged.cloud.points)} points, "
        f"{step.seconds:.1f} s: {output}"
    )


def _merge_document(merged: Merged, names: Sequence[str], output: Path) -> dict[str, object]:
    """The JSON document of merged views, with null for NaN, which JSON does not have."""

    def number_or_none(value: float) -> float | None:
        return value if math.isfinite(value) else None

    (step,) = merged.cloud.provenance
    return {
        "cloud": str(output),
        "points": len(merged.cloud.points),
        "diagonal": merged.scale,
        "rms": number_or_none(merged.rms()),
        "views": [
            {
                "path": name,
                "placed": number not in merged.left_out,
                "pose": None if number in merged.left_out else merged.poses[number].tolist(),
                "overlap": float(merged.shares[number]),
                "rms": number_or_none(merged.rms(number)),
            }
            for number, name in enumerate(names)
        ],
        "overlaps": [asdict(overlap) for overlap in merged.overlaps],
        "notes": list(step.notes),
        "seconds": round(step.seconds, 3),
    }


# --- reconstruct ---------------------------------------------------------------------------------------


@opt.command("reconstruct")
@click.argument("scan", type=click.Path(path_type=Path), metavar="SCAN|FOLDER")
@opt.option(
    "--output -o MESH|FOLDER",
    "Write this mesh (.ply .obj .off .stl .glb); for a folder of scans, a folder.",
    opt.PATH,
    required=True,
)
@opt.option(
    "--suffix SUFFIX",
    "Format of the meshes of a folder of scans.  [default: .ply]",
    (".ply", ".obj", ".off", ".stl", ".glb"),
)
@opt.option("--report", "Print each step, with what was repaired.")
@opt.config_option
@opt.surface_option
@scans_options
@opt.json_option
def reconstruct_command(
    scan: Path,
    output: Path,
    suffix: str | None,
    report: bool,
    config: Path | None,
    surface: str | None,
    as_json: bool,
    **run: Any,
) -> None:
    """Turn a scan into a closed surface, and write it to a mesh file.

    The surface is oriented and manifold. Each scan of a folder gets a mesh of the same name.

    \b
    pcretrieve reconstruct scan.ply -o body.obj --report
    pcretrieve reconstruct scans/ -o meshes/ --workers 2
    """
    from pcretrieve.formats import check_output

    options = opt.load_options(config, surface)
    if scan.is_dir():
        _reconstruct_folder(scan, output, suffix or ".ply", report, options, as_json, **run)
        return
    if suffix is not None:
        raise click.UsageError("--suffix is for folders: give the suffix of the mesh with -o")
    check_output(output, [scan], "mesh")
    limits = {"timeout": run["timeout"], "memory": run["memory"]}
    facts, steps = alone(_reconstructed, options, {scan: output}, scan, **limits)
    if as_json:
        out.write_document(facts | {"steps": [asdict(step) for step in steps]}, options=options)
        return
    if report:
        out.write_steps(steps)
    values = (f"{value:.6g}" if isinstance(value, float) else str(value) for value in facts.values())
    say("  ".join(f"{name} {value}" for name, value in zip(facts, values, strict=True)))


def _reconstruct_folder(
    folder: Path,
    output: Path,
    suffix: str,
    report: bool,
    options: pr.PipelineOptions,
    as_json: bool,
    **run: Any,
) -> None:
    """Write the surface of each scan of a folder."""
    from pcretrieve.ingestion.discover import discover, printable
    from pcretrieve.values import Failure

    scans = discover([folder])
    files = output_files(output, scans, folder, suffix)
    documents: list[dict[str, object]] = []
    made: list[tuple[str, tuple[pr.Step, ...]]] = []  # printed at the end, because they would break a bar
    for path, outcome in each_scan("reconstruct", partial(_reconstructed, options, files), scans, **run):
        name = printable(path)
        if isinstance(outcome, Failure):
            documents.append({"scan": name} | failure_document(outcome))
            continue
        facts, steps = outcome
        documents.append({"scan": name} | facts | {"steps": [asdict(step) for step in steps]})
        made.append((name, steps))
    if as_json:
        out.write_document(documents, options=options)
    elif report:
        for name, steps in made:
            out.write_line(shown_path(name))
            out.write_steps(steps)
    n_failed = len(scans) - len(made)
    say(f"{len(made)} surfaces are in {output}, {n_failed} scans failed")
    opt.exit_if(n_failed)


def _reconstructed(
    options: pr.PipelineOptions, files: dict[Path, Path], scan: Path
) -> tuple[dict[str, object], tuple[pr.Step, ...]]:
    """Write the surface of a scan, in a worker process, which imports the stages."""
    mesh = pr.reconstruct(scan, options)
    pr.write_mesh(mesh, files[scan])
    facts: dict[str, object] = {
        "mesh": str(files[scan]),
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "euler": mesh.euler_characteristic,
        "area": mesh.area,
        "volume": mesh.volume,
    }
    return facts, mesh.provenance


# --- signature -----------------------------------------------------------------------------------------


@opt.command("signature")
@click.argument("paths", nargs=-1, metavar="[PATH|ID]...")
@opt.option(
    "--from-catalogue FILE|URL", "Take shapes of a catalogue by id, or all of them, not scans.", opt.CATALOGUE
)
@opt.method_option
@opt.n_values_option
@opt.option("--n-modes M", "Number of modes of the surface.  [default: 60]", click.IntRange(min=2), rare=True)
@opt.scale_option
@opt.size_weight_option
@opt.config_option
@opt.surface_option
@opt.unit_option
@scans_options
@opt.json_option
def signature_command(
    paths: tuple[str, ...],
    from_catalogue: str | None,
    config: Path | None,
    surface: str | None,
    unit: str | None,
    as_json: bool,
    workers: int | None,
    progress: str,
    timeout: float,
    memory: float | None,
    **chosen: Any,
) -> None:
    """Print the signatures of scans, one line each: path, then values.

    With --from-catalogue, the lines begin with the id, and nothing is reconstructed again.

    \b
    pcretrieve signature body.obj
    pcretrieve signature scans/ --method shape-dna --json
    pcretrieve signature --from-catalogue bodies.sqlite T12 T17 --method wks
    """
    given = {name: value for name, value in chosen.items() if value is not None}
    if from_catalogue is not None:
        if config or surface or unit:
            raise click.UsageError(
                "a catalogue has options of its own: leave out --config, --surface and --unit"
            )
        with pr.Catalogue(from_catalogue) as store:
            options = store.options.changed(signature=given)
            n_failed = _write_signatures(_of_catalogue(store, paths, options), options, as_json)
    else:
        if not paths:
            raise click.UsageError("name at least one scan")
        options = opt.load_options(config, surface, unit).changed(signature=given)
        # On a terminal, the signatures themselves show the progress, and would break a bar.
        is_shown = progress != "bar" or as_json or not sys.stdout.isatty()
        limits = {"workers": workers, "timeout": timeout, "memory": memory}
        rows = _of_scans(paths, options, progress=progress if is_shown else None, **limits)
        n_failed = _write_signatures(rows, options, as_json)
    opt.exit_if(n_failed)


def _write_signatures(
    rows: Iterator[tuple[str, pr.Signature | Failure, dict[str, object]]],
    options: pr.PipelineOptions,
    as_json: bool,
) -> int:
    """Print signatures as they come, or one document. Returns the number of failures."""
    from pcretrieve.values import Failure

    found: list[dict[str, object]] = []
    n_failed = 0
    for name, outcome, facts in rows:
        if isinstance(outcome, Failure):
            n_failed += 1
            found.append(facts | failure_document(outcome))
            continue
        facts |= {"kind": outcome.kind, "unit": outcome.unit, "values": outcome.values.tolist()}
        if outcome.deviation is not None:
            facts |= {"deviation": outcome.deviation.tolist()}
        found.append(facts)
        if not as_json:
            out.write_row([shown_path(name), *(f"{value:.9g}" for value in outcome.values)])
    if as_json:
        out.write_document(found, options=options)
    return n_failed


def _of_scans(
    paths: tuple[str, ...], options: pr.PipelineOptions, **run: Any
) -> Iterator[tuple[str, pr.Signature | Failure, dict[str, object]]]:
    """Name, and signature or failure of each scan, and what else is known of it."""
    from pcretrieve.ingestion.discover import discover, printable

    for path, outcome in each_scan("signature", partial(_described, options), discover(paths), **run):
        name = printable(path)
        if isinstance(outcome, tuple):
            signature, seconds = outcome
            yield name, signature, {"path": name, "seconds": round(seconds, 3)}
        else:
            yield name, outcome, {"path": name}


def _described(options: pr.PipelineOptions, path: Path) -> tuple[pr.Signature, float]:
    """A signature and its seconds, in a worker process, which imports the stages."""
    from pcretrieve.errors import in_stage

    shape = pr.process(path, options)
    with in_stage(Stage.SIGNATURE):
        signature = pr.describe(shape, options.signature)
    return signature, sum(step.seconds for step in shape.provenance)


def _of_catalogue(
    store: pr.Catalogue, ids: tuple[str, ...], options: pr.PipelineOptions
) -> Iterator[tuple[str, pr.Signature | Failure, dict[str, object]]]:
    """Id, and signature or failure of each shape of a catalogue, and what else is known of it."""
    from pcretrieve.descriptors import DESCRIPTORS
    from pcretrieve.values import Failure

    needs = DESCRIPTORS[options.signature.method].needs
    for record in [store.record(shape_id) for shape_id in ids] or store.records(status="done"):
        outcome: pr.Signature | Failure
        if record.status == "failed":
            outcome = Failure(record.id, str(record.stage), str(record.error), str(record.message))
        else:
            try:
                outcome = pr.describe(store.shape(record.id, needs), options.signature)
            except ShapeError as error:
                outcome = failure_of(record.id, error)
        if isinstance(outcome, Failure):
            say(failure_line(outcome, record.path))
        yield record.id, outcome, {"id": record.id, "path": record.path}
