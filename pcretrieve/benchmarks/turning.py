"""Frames of a person who turns before a depth camera, registered without poses, against the truth."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from pcretrieve.benchmarks.tables import print_lines
from pcretrieve.interface import merge_views
from pcretrieve.points.register import Merged
from pcretrieve.simulation import POSES, TurningOptions, body, make_subject, turning_frames, write_frames
from pcretrieve.values import FloatArray, TriangleMesh

__all__ = ["main", "turning_lines"]

HEADER = ("pose", "frames", "points", "placed", "rotation", "point", "rms", "seconds", "CPU")


def main(arguments: Sequence[str] | None = None) -> None:
    """Simulate and register the frames of people who turn before a depth camera.

    Parameters
    ----------
    arguments : sequence of str, optional
        By default the arguments of the command line.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=100, help="frames of one turn (default: %(default)s)")
    parser.add_argument(
        "--poses",
        nargs="+",
        choices=sorted(POSES["person"]),
        default=["stand", "hands_on_hips", "sit"],
        metavar="POSE",
        help="poses of the person (default: stand hands_on_hips sit)",
    )
    given = parser.parse_args(arguments)
    print_lines(turning_lines(given.poses, TurningOptions(n_frames=given.frames)))


def turning_lines(poses: Sequence[str], options: TurningOptions) -> list[str]:
    """Register the frames of turning people, by the preset ``depth-camera`` and no other option.

    Parameters
    ----------
    poses : sequence of str
        Poses of people.
    options : TurningOptions
        The camera, and how the people turn.

    Returns
    -------
    list of str
        A table in Markdown, with a row for each pose: the largest error of the rotation of a frame (degrees)
        and of the place of a vertex of the body in a frame, and the residual of the overlaps, both relative
        to the diagonal of the body; the time to read and to register the frames.
    """
    rows = ["| " + " | ".join(HEADER) + " |", "|---" * len(HEADER) + "|"]
    for seed, pose in enumerate(poses):
        rng = np.random.default_rng(seed)
        person = body(make_subject("person", rng), POSES["person"][pose], rng)
        images, motions = turning_frames(person, options, rng)
        with TemporaryDirectory() as folder:
            write_frames(Path(folder), images, options)
            started, busy = time.perf_counter(), time.process_time()
            merged = merge_views(folder, "depth-camera")
            seconds, busy = time.perf_counter() - started, time.process_time() - busy
        angle, shift = _errors(merged, motions, person)
        values = (
            pose,
            f"{len(images)}",
            f"{round((images > 0).sum() / len(images))}",
            f"{len(images) - len(merged.left_out)}",
            f"{angle:.2f}°",
            f"{shift:.2%}",
            f"{merged.rms() / person.diagonal:.2%}",
            f"{seconds:.0f} s",
            f"{busy:.0f} s",
        )
        rows.append("| " + " | ".join(values) + " |")
    return rows


def _errors(merged: Merged, motions: FloatArray, person: TriangleMesh) -> tuple[float, float]:
    """Largest error of a rotation, degrees, and of the place of a vertex, diagonals, of the placed frames."""
    placed = ~np.isnan(merged.poses[:, 0, 0])
    first = int(placed.argmax())
    root = np.linalg.inv(merged.poses[first] @ motions[first])
    off = root @ merged.poses[placed] @ motions[placed]  # the identity, without errors
    cosine = (np.trace(off[:, :3, :3], axis1=1, axis2=2) - 1) / 2
    there = person.vertices @ off[:, :3, :3].transpose(0, 2, 1) + off[:, None, :3, 3]  # (v, n, 3)
    shift = np.linalg.norm(there - person.vertices, axis=2).max() / person.diagonal
    return float(np.degrees(np.arccos(np.clip(cosine.min(), -1, 1)))), float(shift)
