"""The stages from a scan to its surfaces, in the order of the option `pipeline.stages`.

This is the only module that imports all stages. A mesh that is used without reconstruction (`surface.mode`)
enters the chain after the stage ``surface``. The stages of the default chain check their results and add
their steps to the provenance; this module does the same for filters that options add to the chain.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from pcretrieve.errors import DegenerateMeshError, ReconstructionError, ShapeError, Stage, in_stage
from pcretrieve.formats import as_scan
from pcretrieve.options import DEFAULT_STAGES, PipelineOptions, check_chain, link_of
from pcretrieve.pipeline.frames import Framed
from pcretrieve.pipeline.progress import announce_compilation, log_steps, scan_name
from pcretrieve.pipeline.seen import Seen
from pcretrieve.plugins import Registry
from pcretrieve.points import POINT_FILTERS, check_extent
from pcretrieve.spectral import ELEMENTS
from pcretrieve.surface import SURFACE_FILTERS, defects, reduced, sampled, sound_mesh, surfaces, tetwild
from pcretrieve.values import PointCloud, Step, TriangleMesh

__all__ = ["stages"]

V = TypeVar("V", PointCloud, TriangleMesh)


def stages(scan: object, options: PipelineOptions) -> Iterator[Seen]:
    """Run the stages before the stage ``spectrum``, and log each of them when it has ended."""
    announce_compilation()
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
) -> Iterator[Framed[PointCloud]]:
    """The points after each filter."""
    if filters[0] not in ("crop", "clean"):
        check_extent(scan.points, Stage.READ)
    cloud, oriented = Framed(scan), False
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
    seen: Seen, cloud: Framed[PointCloud], filters: Sequence[str], options: PipelineOptions
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
    for surface in _filtered_surfaces(Framed(mesh, cloud.origin), filters, options):
        yield (seen := replace(seen, mesh=surface.in_scan(), marks=marks))
    _check_closed(surface.value)
    try:
        with in_stage(Stage.SURFACE):
            for mesh, _ in made:
                *_, surface = _filtered_surfaces(Framed(mesh, cloud.origin), filters, options)
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
    framed = Framed(mesh)
    if len(mesh.faces) > options.surface.max_faces:
        framed = framed.near_origin()
        with in_stage(Stage.SURFACE):
            framed = replace(framed, value=reduced(framed.value, options.surface))
    for surface in _filtered_surfaces(framed, filters, options):
        yield Seen(mesh=surface.in_scan())


def _filtered_surfaces(
    surface: Framed[TriangleMesh], filters: Sequence[str], options: PipelineOptions
) -> Iterator[Framed[TriangleMesh]]:
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


def _filtered(framed: Framed[V], filters: Registry[Any], name: str, options: PipelineOptions) -> Framed[V]:
    """The result of one filter, with a step in its provenance."""
    started = time.perf_counter()
    with in_stage(name):
        record = filters[name]
        framed = framed.near_origin() if record.near_origin else Framed(framed.in_scan())
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
