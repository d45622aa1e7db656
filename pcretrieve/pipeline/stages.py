"""The stages from a scan to its surfaces, in the order of the option `pipeline.stages`.

This is the only module that imports all stages. A mesh that is used without reconstruction (`surface.mode`)
enters the chain after the stage ``surface``. The stages of the default chain check their results and add
their steps to the provenance; this module does the same for filters that options add to the chain.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Generic, TypeVar

from pcretrieve.errors import DegenerateMeshError, ReconstructionError, ShapeError, Stage, in_stage
from pcretrieve.formats import as_scan
from pcretrieve.options import DEFAULT_STAGES, PipelineOptions, check_chain, link_of
from pcretrieve.plugins import Registry
from pcretrieve.points import POINT_FILTERS, check_extent
from pcretrieve.spectral import ELEMENTS
from pcretrieve.surface import (
    SURFACE_FILTERS,
    SurfaceMarks,
    defects,
    reduced,
    sampled,
    sound_mesh,
    surfaces,
    tetwild,
)
from pcretrieve.values import FloatArray, PointCloud, Step, TriangleMesh

V = TypeVar("V", PointCloud, TriangleMesh)

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


@dataclass(frozen=True, slots=True, eq=False)
class _Framed(Generic[V]):
    """Points or a surface, and the origin of their coordinates.

    value: the points or the surface; unit of the scan.
    origin: (3,) float64 or None, the origin of the coordinates, in the frame of the scan; None if the
        coordinates are in this frame.
    """

    value: V
    origin: FloatArray | None = None

    def near_origin(self) -> _Framed[V]:
        """The value with the mean of its points at the origin; unchanged if it has been moved already."""
        if self.origin is not None:
            return self
        points = self.value.points if isinstance(self.value, PointCloud) else self.value.vertices
        origin = points.mean(axis=0)
        return _Framed(moved(self.value, -origin), origin)

    def in_scan(self) -> V:
        """The value in the frame of the scan."""
        return self.value if self.origin is None else moved(self.value, self.origin)


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
    chain = options.pipeline.stages
    of_points = ELEMENTS[options.spectral.element].needs == "points"
    check_chain(chain, of_points=of_points)
    links = {stage: link_of(stage) for stage in chain}
    point_filters = [stage for stage, link in links.items() if link.gives in ("points", "normals")]
    surface_filters = [stage for stage, link in links.items() if link.takes == "surface" == link.gives]
    with in_stage(Stage.READ):
        value = as_scan(scan, options.scan.unit)
    if isinstance(value, TriangleMesh):
        yield Seen(scan=PointCloud(value.vertices, provenance=value.provenance))
        with in_stage(Stage.SURFACE):
            kept = None if of_points else sound_mesh(value, options.surface)
        if kept is not None:
            yield from _of_kept(kept, point_filters, surface_filters, options)
            return
        with in_stage(Stage.SURFACE):
            value = sampled(value, options.surface)
    if "remesh" in surface_filters and options.remesh.method == "tetwild":
        tetwild.start()
    seen = Seen(scan=value)
    yield seen
    for cloud in _of_points(value, point_filters, options):
        seen = replace(seen, cloud=cloud.in_scan())
        yield seen
    if not of_points:
        yield from _of_surfaces(seen, cloud.near_origin(), surface_filters, options)


def _of_points(
    scan: PointCloud, filters: Sequence[str], options: PipelineOptions
) -> Iterator[_Framed[PointCloud]]:
    """The points after each filter."""
    if filters[0] not in ("crop", "clean"):
        check_extent(scan.points, Stage.READ)
    cloud, oriented = _Framed(scan), False
    for name in filters:
        cloud = _filtered(cloud, POINT_FILTERS, name, options)
        oriented = oriented or POINT_FILTERS[name].gives == "normals"
        if name not in DEFAULT_STAGES:
            check_extent(cloud.value.points, name)
            if oriented and cloud.value.normals is None:
                raise ShapeError(f"{POINT_FILTERS.called(name)} must keep normals, it gave none", stage=name)
        # Normals of a file are not passed on before they are oriented, because they need not point outwards.
        yield cloud if oriented else replace(cloud, value=replace(cloud.value, normals=None))


def _of_surfaces(
    seen: Seen, cloud: _Framed[PointCloud], filters: Sequence[str], options: PipelineOptions
) -> Iterator[Seen]:
    """Yield the surfaces of points; of the first surface, the result of each filter."""
    with in_stage(Stage.SURFACE):
        made = surfaces(cloud.value, options.surface)
        mesh, marks = next(made)
    if unused := options.surface.unused:
        ignored = f"surface.method = {options.surface.method!r} does not use {', '.join(unused)}"
        mesh = mesh.after(Step("surface", 0.0, notes=(ignored,)))
    if marks is not None and cloud.origin is not None:
        marks = marks.moved(cloud.origin)
    for surface in _filtered_surfaces(_Framed(mesh, cloud.origin), filters, options):
        yield (seen := replace(seen, mesh=surface.in_scan(), marks=marks))
    _check_closed(surface.value)
    try:
        with in_stage(Stage.SURFACE):
            for mesh, _ in made:
                *_, surface = _filtered_surfaces(_Framed(mesh, cloud.origin), filters, options)
                _check_closed(surface.value)
                yield (seen := replace(seen, others=(*seen.others, surface.in_scan())))
    except ReconstructionError as error:
        # One surface suffices for a signature; only the error bar needs two.
        note = Step("surface", 0.0, notes=(f"no further surface could be made: {error.message}",))
        yield replace(seen, mesh=seen.surface.after(note))


def _of_kept(
    mesh: TriangleMesh, point_filters: Sequence[str], filters: Sequence[str], options: PipelineOptions
) -> Iterator[Seen]:
    """Yield a mesh that is used without reconstruction, after each filter that applies to such meshes."""
    for name in point_filters:
        if name not in DEFAULT_STAGES:
            note = "not applied to a mesh that is used without reconstruction (surface.mode)"
            mesh = mesh.after(Step(name, 0.0, notes=(note,)))
    filters = [name for name in filters if SURFACE_FILTERS[name].of_kept]
    framed = _Framed(mesh)
    if len(mesh.faces) > options.surface.max_faces:
        framed = framed.near_origin()
        with in_stage(Stage.SURFACE):
            framed = replace(framed, value=reduced(framed.value, options.surface))
    for surface in _filtered_surfaces(framed, filters, options):
        yield Seen(mesh=surface.in_scan())


def _filtered_surfaces(
    surface: _Framed[TriangleMesh], filters: Sequence[str], options: PipelineOptions
) -> Iterator[_Framed[TriangleMesh]]:
    """Yield a surface, and the result of each filter."""
    yield surface
    for name in filters:
        filtered = _filtered(surface, SURFACE_FILTERS, name, options)
        if name not in DEFAULT_STAGES and not defects(surface.value):
            _check_closed(filtered.value, stage=name)
        surface = filtered
        yield surface


def _check_closed(mesh: TriangleMesh, stage: str | None = None) -> None:
    if wrong := defects(mesh):
        raise DegenerateMeshError(
            f"the surface must be a closed manifold, it has defects: {wrong}", stage=stage
        )


def _filtered(framed: _Framed[V], filters: Registry[Any], name: str, options: PipelineOptions) -> _Framed[V]:
    """The result of one filter, with a step in its provenance."""
    started = time.perf_counter()
    with in_stage(name):
        record = filters[name]
        framed = framed.near_origin() if record.near_origin else _Framed(framed.in_scan())
        value: V = framed.value
        with filters.blamed(name, name):
            result: V = record.apply(value, options.of_stage(name))
            if not isinstance(result, type(value)):
                raise TypeError(f"a filter must give a {type(value).__name__}, got {result!r}")
    n = len(value.provenance)
    has_step = len(result.provenance) > n and result.provenance[:n] == value.provenance
    if name not in DEFAULT_STAGES and not has_step:
        step = Step(name, time.perf_counter() - started, {**_size(value, "_in"), **_size(result)})
        result = replace(result, provenance=(*value.provenance, step))
    return replace(framed, value=result)


def _size(value: PointCloud | TriangleMesh, when: str = "") -> dict[str, float]:
    if isinstance(value, PointCloud):
        return {f"points{when}": len(value.points)}
    return {f"faces{when}": len(value.faces)}


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
