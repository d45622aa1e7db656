"""The stages from a scan to its surfaces: crop, clean, orient, surface, remesh.

This is the only module that imports all stages. A mesh that is used without reconstruction (`surface.mode`)
passes through none of them. Stages that work in single precision get coordinates near the origin, because
far from it they lose the shape.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TypeVar

from pcretrieve.errors import DegenerateMeshError, ReconstructionError, Stage, in_stage
from pcretrieve.formats import as_scan
from pcretrieve.options import PipelineOptions, SurfaceOptions
from pcretrieve.points import clean, crop, oriented_normals
from pcretrieve.spectral import ELEMENTS
from pcretrieve.surface import SurfaceMarks, defects, reduced, remesh, sampled, sound_mesh, surfaces, tetwild
from pcretrieve.values import FloatArray, PointCloud, Step, TriangleMesh

_LOGGER = logging.getLogger("pcretrieve.pipeline")


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The results of the stages of a scan, up to some stage; lengths are in the unit of the scan."""

    scan: PointCloud | None = None
    cloud: PointCloud | None = None
    mesh: TriangleMesh | None = None
    marks: SurfaceMarks | None = None
    others: tuple[TriangleMesh, ...] = ()

    @property
    def surface(self) -> TriangleMesh:
        """The first surface; TypeError if there is none yet."""
        if self.mesh is None:
            raise TypeError("there must be a surface after the last stage, there is none")
        return self.mesh

    @property
    def steps(self) -> tuple[Step, ...]:
        """The steps of all stages so far, in order."""
        cloud = self.cloud if self.cloud is not None else self.scan
        before = () if cloud is None else cloud.provenance
        first = before if self.mesh is None else self.mesh.provenance
        further = (mesh.provenance[len(before) :] for mesh in self.others)
        return (*first, *(step for steps in further for step in steps))


V = TypeVar("V", PointCloud, TriangleMesh)


def moved(value: V, by: FloatArray) -> V:
    """Translate points or a surface.

    by: (3,) float64, the translation.
    """
    if isinstance(value, TriangleMesh):
        return replace(value, vertices=value.vertices + by)
    viewpoints = None if value.viewpoints is None else value.viewpoints + by
    return replace(value, points=value.points + by, viewpoints=viewpoints)


def stages(scan: object, options: PipelineOptions) -> Iterator[Seen]:
    """Run the stages before the stage ``spectrum``, and log each of them when it has ended."""
    _announce_compilation()
    name, logged = scan_name(scan), 0
    for seen in _stages(scan, options):
        steps = seen.steps
        log_steps(name, steps[logged:])
        logged = len(steps)
        yield seen


def _stages(scan: object, options: PipelineOptions) -> Iterator[Seen]:
    of_points = ELEMENTS[options.spectral.element].needs == "points"
    with in_stage(Stage.READ):
        value = as_scan(scan, options.scan.unit)
    if isinstance(value, TriangleMesh):
        yield Seen(scan=PointCloud(value.vertices, provenance=value.provenance))
        with in_stage(Stage.SURFACE):
            kept = None if of_points else sound_mesh(value, options.surface)
            used = sampled(value, options.surface) if kept is None else _with_few_faces(kept, options.surface)
        if isinstance(used, TriangleMesh):
            yield Seen(mesh=used)
            return
        value = used
    if options.remesh.method == "tetwild":
        tetwild.start()
    yield (seen := Seen(scan=value))
    # Normals of a file are not passed on before they are oriented, because they need not point outwards.
    with in_stage(Stage.CROP):
        cloud = crop(value, options.scan)
    yield (seen := replace(seen, cloud=replace(cloud, normals=None)))
    with in_stage(Stage.CLEAN):
        cloud = clean(cloud, options.scan)
    yield (seen := replace(seen, cloud=replace(cloud, normals=None)))
    with in_stage(Stage.ORIENT):
        origin = cloud.points.mean(axis=0)
        cloud = oriented_normals(moved(cloud, -origin), options.scan)
    yield (seen := replace(seen, cloud=moved(cloud, origin)))
    if not of_points:
        yield from _of_surfaces(seen, cloud, origin, options)


def _of_surfaces(
    seen: Seen, cloud: PointCloud, origin: FloatArray, options: PipelineOptions
) -> Iterator[Seen]:
    """Yield the surfaces of points near the origin; the first before and after it is remeshed.

    origin: (3,) float64, that of the points in the frame of the scan.
    """
    with in_stage(Stage.SURFACE):
        made = surfaces(cloud, options.surface)
        mesh, marks = next(made)
    if unused := options.surface.unused:
        ignored = f"surface.method = {options.surface.method!r} does not use {', '.join(unused)}"
        mesh = mesh.after(Step("surface", 0.0, notes=(ignored,)))
    seen = replace(seen, mesh=moved(mesh, origin), marks=None if marks is None else marks.moved(origin))
    yield seen
    yield (seen := replace(seen, mesh=moved(_remeshed(mesh, options), origin)))
    try:
        with in_stage(Stage.SURFACE):
            for mesh, _ in made:
                further = moved(_remeshed(mesh, options), origin)
                yield (seen := replace(seen, others=(*seen.others, further)))
    except ReconstructionError as error:
        # One surface suffices for a signature; only the error bar needs two.
        note = Step("surface", 0.0, notes=(f"no further surface could be made: {error.message}",))
        yield replace(seen, mesh=seen.surface.after(note))


def _remeshed(mesh: TriangleMesh, options: PipelineOptions) -> TriangleMesh:
    with in_stage(Stage.REMESH):
        result = remesh(mesh, options.remesh)
    if wrong := defects(result):
        raise DegenerateMeshError(f"the surface must be a closed manifold, it has defects: {wrong}")
    return result


def _with_few_faces(mesh: TriangleMesh, options: SurfaceOptions) -> TriangleMesh:
    """A mesh that is used without reconstruction, with at most `max_faces` faces."""
    if len(mesh.faces) <= options.max_faces:
        return mesh
    origin = mesh.vertices.mean(axis=0)
    return moved(reduced(moved(mesh, -origin), options), origin)


def scan_name(scan: object) -> str | None:
    """The name of a scan in messages."""
    return Path(scan).name if isinstance(scan, (str, Path)) else None


def log_steps(name: str | None, steps: Iterable[Step]) -> None:
    """Log steps: each at the level INFO, and its notes on repairs and fallbacks at the level WARNING."""
    scan = name or "scan"
    for step in steps:
        sizes = ", ".join(f"{what} {size:.6g}" for what, size in step.sizes.items())
        _LOGGER.info("%s: %s in %.2f s%s", scan, step.stage, step.seconds, f": {sizes}" if sizes else "")
        for note in step.notes:
            _LOGGER.warning("%s: %s: %s", scan, step.stage, note)


@cache
def _announce_compilation() -> None:
    """Log at the level INFO, once in a process, that numba compiles functions which it has not cached."""
    from numba.core import event

    class First(event.Listener):
        announced = False

        def on_start(self, event: object) -> None:
            if not self.announced:
                self.announced = True
                logging.getLogger("pcretrieve.compilation").info(
                    "compiling, once: later processes load the compiled functions from the cache of numba"
                )

        def on_end(self, event: object) -> None: ...

    event.register("numba:compile", First())  # type: ignore[no-untyped-call]
