"""Commands on scans without a catalogue: merge, reconstruct, signature."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import click

import pcretrieve as pr
from pcretrieve.cli import options as opt, output as out
from pcretrieve.cli.messages import Progress, escaped, failure_line, say, shown_path
from pcretrieve.errors import ShapeError
from pcretrieve.values.files import in_order

MESH_SUFFIXES = (".ply", ".obj", ".off", ".stl", ".glb")


def each_scan(
    command: str,
    function: Callable[..., dict[str, Any]],
    paths: Path | Sequence[str],
    *,
    progress: str | None,
    is_alone: bool = False,
    **run: Any,
) -> Iterator[dict[str, Any]]:
    """`map_scans` with progress, if there are several scans; the error of a scan alone is raised.

    Yields for JSON the path of each scan, and what the function returns of it, or its failure.
    """
    with Progress(command, progress or "none") as shown:

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
                    facts | out.failure_facts(outcome), failure_line(stem, outcome, name)
                )

        for name, outcome in pr.map_scans(
            function, paths, on_start=start, on_scan=advance, **run
        ):
            if is_alone and isinstance(outcome, ShapeError):
                raise outcome
            yield {"path": name} | (
                out.failure_facts(outcome) if isinstance(outcome, ShapeError) else outcome
            )


# --- merge ---------------------------------------------------------------------------------------------


@opt.command("merge")
@click.argument("paths", nargs=-1, metavar="VIEWS...")
@opt.option(
    "--output -o CLOUD",
    "Write this point cloud: .ply, .pcd or .xyzn.",
    opt.PATH,
    required=True,
)
@opt.option(
    "--refine/--no-refine", "Refine known poses, or use them as they are.", default=None
)
@opt.option(
    "--sensor",
    "Where the sensor is, if files do not say: far away in front, as of range scanners, or at "
    "the origin, as of depth cameras.  [default: front]",
    ("front", "origin"),
)
@opt.option("--max-range LENGTH", "Remove points farther from the sensor.", float)
@opt.option(
    "--background",
    "Remove floors and walls (planes), and what is farther than the body (room).  [default: none]",
    ("none", "planes", "room"),
)
@opt.option("--keep-largest", "Keep the largest piece of each view.", default=None)
@opt.config_option
@partial(opt.limit_options, unit="view")
def merge_command(paths: tuple[str, ...], output: Path, **values: Any) -> out.Result:
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
    if list(paths) == sorted(paths):  # as a shell names them: frame_1, frame_10, frame_2
        paths = tuple(map(str, in_order(map(Path, paths))))
    scan = opt.taken(values, "max_range")
    merge = opt.taken(values, "refine", "sensor", "background", "keep_largest")
    options = opt.load_options(values).changed(scan=scan, merge=merge)
    merged = pr.merge_views(paths, options, output=output, **values)
    (step,) = merged.cloud.provenance
    views: list[dict[str, object]] = []
    say(f"{'view':<8}  {'overlap':>7}  {'rms':>10}  file")
    for number, name in enumerate(merged.names):
        view: dict[str, object] = {"path": name, "placed": False, "pose": None}
        overlap, rms = float(merged.shares[number]), merged.rms(number)
        line = f"{'left out':<8}  {'-':>7}  {'-':>10}  {name}"
        if number not in merged.left_out:
            view |= {"placed": True, "pose": merged.poses[number]}
            line = f"{'placed':<8}  {overlap:>7.1%}  {rms:>10.3g}  {name}"
        views.append(view | {"overlap": overlap, "rms": _number(rms)})
        say(line)
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
    return out.Result(document, options, failed=merged.left_out)


def _number(value: float) -> float | None:
    """A number of JSON, which has no NaN."""
    return value if math.isfinite(value) else None


# --- reconstruct ---------------------------------------------------------------------------------------


@opt.command("reconstruct")
@click.argument("scan", type=opt.PATH, metavar="SCAN|FOLDER")
@opt.option(
    "--output -o MESH|FOLDER",
    f"Write this mesh ({' '.join(MESH_SUFFIXES)}); for a folder of scans, a folder.",
    opt.PATH,
    required=True,
)
@opt.option(
    "--suffix SUFFIX",
    "Format of the meshes of a folder of scans.  [default: .ply]",
    MESH_SUFFIXES,
)
@opt.option("--report", "Print each step, with what was repaired.")
@opt.config_option
@opt.surface_option
@opt.process_options
def reconstruct_command(
    scan: Path, output: Path, suffix: str | None, report: bool, **run: Any
) -> out.Result:
    """Turn a scan into a closed surface, and write it to a mesh file.

    The surface is oriented and manifold. Each scan of a folder gets a mesh of the same name.

    \b
    pcretrieve lab reconstruct scan.ply -o body.obj --report
    pcretrieve lab reconstruct scans/ -o meshes/ --workers 2
    """
    options, is_alone = opt.load_options(run), not scan.is_dir()
    if is_alone and suffix is not None:
        raise click.UsageError(
            "--suffix is for folders: give the suffix of the mesh with -o"
        )
    run |= {
        "output": output,
        "suffix": suffix or ".ply",
        "kind": "mesh",
        "is_alone": is_alone,
    }
    # Printed at the end, because they would break a bar.
    found = list(
        each_scan("reconstruct", partial(_reconstructed, options=options), scan, **run)
    )
    made = [facts for facts in found if "mesh" in facts]
    if not is_alone:
        say(
            f"{len(made)} surfaces are in {output}, {len(found) - len(made)} scans failed"
        )

    def show() -> None:
        for facts in made if report else ():
            if not is_alone:
                out.write_lines(shown_path(facts["path"]))
            out.write_steps(facts["steps"])
        if is_alone:
            facts = {
                name: value
                for name, value in found[0].items()
                if name not in ("path", "steps")
            }
            texts = (
                f"{value:.6g}" if isinstance(value, float) else str(value)
                for value in facts.values()
            )
            say(
                "  ".join(
                    f"{name} {text}" for name, text in zip(facts, texts, strict=True)
                )
            )

    return out.Result(
        found[0] if is_alone else found, options, show, len(found) - len(made)
    )


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


@opt.command("signature")
@click.argument("paths", nargs=-1, metavar="[PATH|ID]...")
@opt.option(
    "--from-catalogue FILE|URL",
    "Take shapes of a catalogue by id, or all of them, not scans.",
    opt.CATALOGUE,
)
@opt.method_option
@opt.n_values_option
@opt.rare_option(
    "--n-modes M", "Number of modes of the surface.  [default: 60]", click.IntRange(min=2)
)
@opt.scale_option
@opt.size_weight_option
@opt.settings_options
@opt.process_options
def signature_command(
    paths: tuple[str, ...],
    from_catalogue: str | None,
    progress: str | None,
    **values: Any,
) -> out.Result:
    """Print the signatures of scans, one line each: path, then values.

    With --from-catalogue, the lines begin with the id, and nothing is reconstructed again.

    \b
    pcretrieve lab signature body.obj
    pcretrieve lab signature scans/ --method shape-dna --json
    pcretrieve lab signature --from-catalogue bodies.sqlite T12 T17 --method wks
    """
    changes = {"signature": opt.taken(values, "n_modes", *opt.SIGNATURE_FLAGS)}
    if from_catalogue is not None:
        opt.refuse(
            "a catalogue has options of its own",
            "config",
            "surface",
            "unit",
            "workers",
            "memory",
        )
        store = opt.opened(from_catalogue)
        options = store.options.changed(**changes)
        rows = _of_catalogue(store, paths, options)
    else:
        if not paths:
            raise click.UsageError("name at least one scan")
        options = opt.load_options(values).changed(**changes)
        # On a terminal, the signatures themselves show the progress, and would break a bar.
        if progress == "bar" and not out.prints_json() and sys.stdout.isatty():
            progress = None
        rows = each_scan(
            "signature",
            partial(_described, options=options),
            paths,
            progress=progress,
            **values,
        )
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
                out.print_text(
                    "\t".join([name, *(f"{value:.9g}" for value in facts["values"])])
                )

    return out.Result(counted(), options, show, failures)


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
            facts |= out.failure_facts(failure)
        yield facts
