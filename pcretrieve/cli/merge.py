"""The command that registers several range scans and merges them into one point cloud: merge."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pcretrieve.cli.commands import command, option
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import say
from pcretrieve.cli.parts import EXIT_SOME_FAILED, config_option, json_option, limit_options, load_options
from pcretrieve.cli.patience import stop_waiting

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pcretrieve.options import MergeOptions
    from pcretrieve.points.register import Merged

__all__ = ["merge_command"]


@command("merge")
@click.argument("paths", nargs=-1, metavar="VIEWS...")
@option(
    "--output",
    "-o",
    type=click.Path(path_type=Path),
    required=True,
    metavar="CLOUD",
    help="The point cloud: .ply, .pcd or .xyzn.",
    details=".ply and .pcd have the sensor position of each point, .xyzn has normals only.",
)
@option("--refine/--no-refine", default=None, help="Refine given poses, or use them as they are.")
@option(
    "--sensor",
    type=click.Choice(["front", "origin"]),
    help="Where the sensor is, if files do not say.  [default: front]",
    details="Far away in the direction +z (front), as of range scanners, or at the origin, as of frames of a "
    "depth camera.",
)
@option("--max-range", type=float, metavar="LENGTH", help="Remove points farther from the sensor.")
@option(
    "--background",
    type=click.Choice(["none", "planes"]),
    help="Remove floors and walls (planes).  [default: none]",
)
@option("--keep-largest", is_flag=True, default=None, help="Keep the largest piece of each view.")
@option(
    "--voxel",
    type=float,
    metavar="SHARE",
    rare=True,
    help="Average the points in each voxel of this size, 0 to keep all points.  [default: 0]",
)
@option(
    "--reach",
    type=float,
    metavar="SHARE",
    rare=True,
    help="Largest distance of corresponding points.  [default: 0.01]",
)
@option(
    "--min-overlap",
    type=float,
    metavar="SHARE",
    rare=True,
    help="Smallest fraction of the points of a view that another view must have measured too.  "
    "[default: 0.1]",
)
@config_option
@limit_options("view, all of them together")
@json_option
def merge_command(
    paths: tuple[str, ...],
    output: Path,
    refine: bool | None,
    sensor: str | None,
    max_range: float | None,
    background: str | None,
    keep_largest: bool | None,
    voxel: float | None,
    reach: float | None,
    min_overlap: float | None,
    config: Path | None,
    timeout: float,
    memory: float | None,
    as_json: bool,
) -> None:
    """Register range scans (views) of one body, and merge them into one point cloud.

    VIEWS are files, folders, glob patterns, a Stanford .conf file, or a folder of the TUM RGB-D benchmark,
    whose poses are the initial ones. Views without poses may be in any order and pose. Views that cannot be
    registered are left out, and the exit code is 3. Voxel and reach are relative to the median diagonal of
    the views; the range is in the unit of the files.

    \b
    pcretrieve merge bunny/*.ply -o bunny.ply
    pcretrieve merge frames/ --config depth-camera -o body.ply
    pcretrieve merge frames/ --sensor origin --max-range 1.5 -o body.ply
    """
    from pcretrieve.formats import check_output, write_cloud
    from pcretrieve.ingestion.discover import printable
    from pcretrieve.ingestion.isolation import Isolation
    from pcretrieve.ingestion.views import view_files

    if not paths:
        raise click.UsageError("name at least two views, or one .conf")
    chosen = {
        "refine": refine,
        "sensor": sensor,
        "max_range": max_range,
        "background": background,
        "keep_largest": keep_largest,
        "voxel": voxel,
        "reach": reach,
        "min_overlap": min_overlap,
    }
    given = {name: value for name, value in chosen.items() if value is not None}
    options = load_options(config).changed(merge=given)
    files, _ = view_files(paths)
    check_output(output, files, "point")
    stop_waiting()  # the process of the registration shows a bar
    merged = Isolation(timeout * len(files), memory).call(_merged, paths, options.merge)
    write_cloud(merged.cloud, output)
    names = [printable(file) for file in files]
    _say_residuals(merged, names, output)
    if as_json:
        write_document(_document(merged, names, output), options=options)
    if merged.left_out:
        click.get_current_context().exit(EXIT_SOME_FAILED)


def _merged(paths: Sequence[str], options: MergeOptions) -> Merged:
    """Merged views, in a worker process, which imports Open3D, and shows its progress on standard error."""
    from tqdm import tqdm

    from pcretrieve.ingestion.views import read_views
    from pcretrieve.points.register import merge_views

    views = read_views(paths)
    with tqdm(total=math.comb(len(views.clouds), 2), unit="pair", desc="merge", disable=None) as bar:

        def on_pair(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        return merge_views(views.clouds, options, poses=views.poses, on_pair=on_pair)


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


def _document(merged: Merged, names: Sequence[str], output: Path) -> dict[str, object]:
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
