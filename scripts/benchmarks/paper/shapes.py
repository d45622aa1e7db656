"""Figures 1, 4 and 5 and section 4.4: pictures of meshes, silhouettes, and perturbed meshes."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from benchmarks.measuring import all_in_workers, evaluate_table, in_workers, png
from benchmarks.paper.spectra import unit_area_spectrum
from benchmarks.sets import read_mesh, spread
from benchmarks.strip import TILE, captioned
from pcretrieve.arrays import vertex_normals
from pcretrieve.descriptors import describe
from pcretrieve.draw.pictures import thumbnail
from pcretrieve.errors import BenchmarkError, PcretrieveError
from pcretrieve.evaluation.measures import evaluate_rankings
from pcretrieve.evaluation.rankings import Subset, rank_subsets
from pcretrieve.ingestion.discover import discover
from pcretrieve.ingestion.labels import read_labels
from pcretrieve.options import RemeshOptions, RetrievalOptions, Scale, SignatureOptions
from pcretrieve.retrieval import DistanceBlock
from pcretrieve.retrieval.distances import coordinates, pairwise
from pcretrieve.surface.tetwild import remesh
from pcretrieve.values import (
    FloatArray,
    IntArray,
    Mask,
    ModalSpectrum,
    Shape,
    SignatureTable,
    Surface,
    TriangleMesh,
)
from pcretrieve.values.files import write_file
from pcretrieve.values.repair import largest_component
from pcretrieve.values.simplify import simplified
from pcretrieve.values.topology import compact

# Standard deviation of the Gaussian filter that smooths the staircase of the pixels, relative to the square
# root of the area; the smallest in pixels. The outline is where the filtered picture is 1/2.
SMOOTHING = 0.01
LEAST_SMOOTHING = 0.7

# Distances of points of the lattice from the outline, relative to the edge of the triangles: the smallest,
# with which every step of the outline is an edge of the triangulation, and the largest outside the shape.
# Without points outside, the circumscribed circles of flat triangles along the outline would be empty.
CLEARANCE = 0.6
BAND = 2.0

# Smallest area of a triangle, relative to the square of the edge.
LEAST_AREA = 1e-3


def read_silhouette(path: Path) -> FloatArray:
    """A silhouette (h, w): 1 in the shape and 0 outside."""
    with Image.open(path) as picture:
        values = np.asarray(picture.convert("L"), dtype=np.float64)
    return np.asarray(values > (values.min() + values.max()) / 2, dtype=np.float64)


def planar_mesh(silhouette: FloatArray, n_vertices: int = 6000) -> TriangleMesh:
    """Triangulate a silhouette.

    The outline is sampled at equal steps, and the rest by a lattice of equilateral triangles of the same
    edge. The mesh has the triangles of the Delaunay triangulation of all these points that lie inside. Only
    the largest component of the shape is kept; its holes stay. The mesh lies in the plane z = 0, oriented to
    +z; unit: pixel.
    """
    from contourpy import contour_generator
    from scipy.ndimage import gaussian_filter, map_coordinates
    from scipy.spatial import Delaunay, KDTree

    area = float(silhouette.sum())
    blur = max(LEAST_SMOOTHING, SMOOTHING * area**0.5)
    smooth = gaussian_filter(np.pad(silhouette, int(np.ceil(4 * blur)) + 1), blur)
    # The area for each vertex of a lattice of equilateral triangles is √3/2 of the square of an edge.
    edge = (area / (n_vertices * 3**0.5 / 2)) ** 0.5
    contours = contour_generator(z=smooth.T).lines(0.5)  # of rows and columns
    outlines = (
        _resampled(np.asarray(contour, dtype=np.float64), edge) for contour in contours
    )
    outline = np.concatenate([np.empty((0, 2)), *outlines])
    lattice = _lattice(smooth.shape, edge)
    distance = KDTree(outline).query(lattice)[0] / edge
    is_inside = map_coordinates(smooth, lattice.T, order=1) > 0.5
    lattice = lattice[(distance > CLEARANCE) & (is_inside | (distance < BAND))]
    points = np.concatenate([outline, lattice])  # (n, 2), row and column of the picture
    triangles = Delaunay(points)
    corners = points[triangles.simplices]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    # Positive for normals along +z.
    areas = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2
    kept = map_coordinates(smooth, corners.mean(axis=1).T, order=1) > 0.5
    kept &= np.abs(areas) > LEAST_AREA * edge**2
    kept = _largest_component(triangles.neighbors, kept, np.abs(areas))
    faces = np.where(
        areas[:, None] < 0, triangles.simplices[:, ::-1], triangles.simplices
    )[kept]
    return compact(
        np.column_stack([points[:, 1], -points[:, 0], np.zeros(len(points))]), faces
    )


def _largest_component(neighbors: IntArray, kept: Mask, areas: FloatArray) -> Mask:
    """Of the kept triangles, the largest component by area; triangles with a common edge are connected."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    here, side = np.nonzero(kept[:, None] & (neighbors >= 0) & kept[neighbors])
    links = coo_array(
        (np.ones(len(here)), (here, neighbors[here, side])), shape=2 * (len(kept),)
    )
    _, component = connected_components(links, directed=False)
    largest = np.bincount(component[kept], weights=areas[kept]).argmax()
    return np.asarray(kept & (component == largest))


def _resampled(contour: FloatArray, step: float) -> FloatArray:
    """Points of a closed polygon at equal steps along it; none if it is shorter than three steps."""
    along = np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(contour, axis=0), axis=1))]
    )
    n = round(along[-1] / step)
    if n < 3:
        return np.empty((0, 2))
    at = np.arange(n) * along[-1] / n
    return np.column_stack([np.interp(at, along, contour[:, axis]) for axis in (0, 1)])


def _lattice(shape: tuple[int, ...], edge: float) -> FloatArray:
    """(n, 2) points of a lattice of equilateral triangles that covers a picture."""
    height = edge * 3**0.5 / 2
    rows, columns = np.meshgrid(
        np.arange(0, shape[0] - 1, height),
        np.arange(0, shape[1] - 1 - edge / 2, edge),
        indexing="ij",
    )
    columns[1::2] += edge / 2
    return np.column_stack([rows.ravel(), columns.ravel()])


N_MODES = 60
LENGTHS = (5, 10, 15, 23)

# Descriptors, and the scales of their values. The values of Shape-DNA are the same by area and relative.
VARIANTS: tuple[tuple[str, Scale], ...] = (
    ("r-bihdm", "relative"),
    ("r-bihdm", "area"),
    ("shape-dna", "relative"),
)
SHOWN = VARIANTS[1:]

# The strips: number of queries and of shapes in each, length of the signatures; side of a picture, pixels.
N_STRIPS, N_SHOWN, STRIP_LENGTH, SIDE, MARGIN = 6, 12, 10, 72, 6

# Longest time for one silhouette; seconds.
TIMEOUT = 60.0

Spectra = Mapping[Path, ModalSpectrum]


def figure_4(
    folder: Path, strips: Path | None, limit: int | None = None
) -> Iterator[str]:
    """Retrieval measures of the silhouettes by each descriptor and length; and a picture of ranked lists."""
    paths = sorted(path for path in folder.iterdir() if path.suffix in {".gif", ".png"})
    if not paths:
        raise BenchmarkError(f"{folder} must have silhouettes, .gif or .png, got none")
    spectra, failed = _spectra([path for _, path in spread(paths, limit)])
    classes = {_class(path) for path in spectra}
    yield f"Figure 4: {len(spectra)} silhouettes of {len(classes)} classes, scaled to unit area, distance log"
    yield from (f"{path.name} failed: {error}" for path, error in failed.items())
    yield from silhouette_rows(spectra)
    if strips is not None:
        write_file(strips, ranked_strips(spectra))
        rows = ", and a row by ".join(f"{method} ({scale})" for method, scale in SHOWN)
        yield f"wrote {strips}: for each query a row by {rows}, L = {STRIP_LENGTH}"


def silhouette_rows(spectra: Spectra) -> Iterator[str]:
    """A row of retrieval measures for each descriptor, scale and length."""
    yield f"{'method':<12}{'scale':<10}{'L':<4}{'NN':<7}{'FT':<7}mAP"
    for (method, scale), n_values in product(VARIANTS, LENGTHS):
        values = _values(spectra, method, scale, n_values)
        names, labels = zip(*((path.stem, _class(path)) for path in spectra), strict=True)
        found = evaluate_table(
            SignatureTable(names, values, method, labels=labels),
            RetrievalOptions(whitening="none"),
        )
        yield f"{method:<12}{scale:<10}{n_values:<4}{found.nn:<7.3f}{found.ft:<7.3f}{found.map:.3f}"


def ranked_strips(spectra: Spectra) -> bytes:
    """Draw the nearest silhouettes of some queries, one row for each descriptor of `SHOWN`."""
    paths = tuple(spectra)
    tables = [coordinates(_values(spectra, *shown, STRIP_LENGTH)) for shown in SHOWN]
    queries = spread(paths, N_STRIPS)
    step = SIDE + MARGIN
    height = len(queries) * len(SHOWN) * step + MARGIN * (len(queries) + 1)
    sheet = Image.new("RGB", (N_SHOWN * step + 2 * MARGIN, height), "white")
    pen = ImageDraw.Draw(sheet)
    y = MARGIN
    for query, path in queries:
        for table in tables:
            distances = pairwise("log", table[query : query + 1], table)[0]
            for column, position in enumerate(
                np.argsort(distances, kind="stable")[:N_SHOWN]
            ):
                ink = (
                    (20, 24, 30)
                    if _class(paths[position]) == _class(path)
                    else (170, 175, 182)
                )
                sheet.paste(
                    _thumbnail(paths[position], ink), (2 * MARGIN + column * step, y)
                )
            y += step
        pen.line((MARGIN, y, sheet.width - MARGIN, y), (210, 214, 220))
        y += MARGIN
    return png(sheet)


def _spectra(paths: Sequence[Path]) -> tuple[Spectra, Mapping[Path, PcretrieveError]]:
    """The spectra of silhouettes, and the errors of others, in the order of the files."""
    outcomes = in_workers(_spectrum, paths, "silhouettes", timeout=TIMEOUT)
    failed = {
        path: answer
        for path, answer in outcomes.items()
        if isinstance(answer, PcretrieveError)
    }
    return {
        path: one for path, one in outcomes.items() if isinstance(one, ModalSpectrum)
    }, failed


def _spectrum(path: Path) -> ModalSpectrum:
    return unit_area_spectrum(planar_mesh(read_silhouette(path)), N_MODES)


def _values(spectra: Spectra, method: str, scale: Scale, n_values: int) -> FloatArray:
    """(N, n_values) signatures."""
    options = SignatureOptions(
        method=method, n_values=n_values, n_modes=N_MODES, scale=scale
    )
    shapes = (Shape((Surface(1.0, spectrum),)) for spectrum in spectra.values())
    return np.array([describe(shape, options).values for shape in shapes])


def _class(path: Path) -> str:
    """The class of a file such as ``bird-12.gif``."""
    return path.stem.rpartition("-")[0]


def _thumbnail(path: Path, ink: tuple[int, int, int]) -> Image.Image:
    """A silhouette in one colour on white."""
    shape = Image.fromarray(np.asarray(255 * read_silhouette(path), dtype=np.uint8))
    shape.thumbnail((SIDE, SIDE))
    tile = Image.new("RGB", (SIDE, SIDE), "white")
    corner = ((SIDE - shape.width) // 2, (SIDE - shape.height) // 2)
    tile.paste(Image.new("RGB", shape.size, ink), corner, shape)
    return tile


# Pictures in a row.
N_COLUMNS = 6

# Meshes of SHREC'11, one of each class, that the camera of thumbnails shows upright: chosen by eye, because
# that camera knows principal axes and not what is up.
UPRIGHT = {
    *("T18", "T141", "T138", "T41", "T100", "T242", "T488", "T326", "T84", "T368"),
    *("T305", "T467", "T389", "T299", "T42", "T312", "T402", "T396", "T17", "T426"),
    *("T224", "T28", "T32", "T463", "T271", "T111", "T0", "T535", "T180", "T238"),
}


def figure_1(folder: Path, sheet: Path | None) -> Iterator[str]:
    """Draw one mesh of each class: that of `UPRIGHT`, or the first one."""
    classes = read_labels(folder / "labels.csv")
    scans = discover([folder])
    paths = [scan.file for scan in scans if scan.name in classes]
    shown: dict[str, Path] = {}
    for path in sorted(paths, key=lambda path: path.stem not in UPRIGHT):
        shown.setdefault(classes[path.name], path)
    yield f"Figure 1: {len(paths)} meshes of {folder.name}, of {len(shown)} classes"
    if sheet is not None:
        tiles = [(label, _tile(path)) for label, path in sorted(shown.items())]
        write_file(sheet, png(captioned(tiles, N_COLUMNS)))
        yield f"wrote {sheet}: one mesh of each class"


def _tile(path: Path) -> Image.Image:
    mesh = read_mesh(path)
    drawn = thumbnail(mesh.vertices, mesh.faces, size=TILE)
    return Image.open(io.BytesIO(b"" if drawn is None else drawn.png)).convert("RGBA")


N_VALUES = 23

# Standard deviations of the noise in mean edge lengths, and shares of faces that are removed.
NOISE = (0.1, 0.3, 0.5)
REMOVED = (0.01, 0.02, 0.03)
PERTURBATIONS = (
    *(f"noise {size}" for size in NOISE),
    *(f"holes {share:.0%}" for share in REMOVED),
)

# With optimisation of the tetrahedra: without it, the surface has three times as many faces as the input, and
# many handles.
REMESHING = RemeshOptions(method="tetwild", timeout=600)
METHODS = ("r-bihdm", "bihdm", "shape-dna", "wks", "hks-bow")

Poses = Mapping[str, tuple[TriangleMesh, TriangleMesh]]


def section_4_4(poses: Poses, *, remeshed: bool = True) -> Iterator[str]:
    """Median and largest drift of each descriptor."""
    unit = "1 is the distance to the nearest other class"
    yield f"Section 4.4: drift of log-signatures, L = {N_VALUES}; {unit}"
    yield f"median/largest of {', '.join(poses)}; pose: the second mesh of each class"
    table = drifts(poses, remeshed=remeshed)
    yield f"{'method':<11}" + "".join(f"{name:<12}" for name in table).rstrip()
    for column, method in enumerate(METHODS):
        cells = (
            f"{np.median(rows[:, column]):.2f}/{rows[:, column].max():.2f}"
            for rows in table.values()
        )
        yield f"{method:<11}" + "".join(f"{cell:<12}" for cell in cells).rstrip()


def drifts(
    poses: Poses, methods: tuple[str, ...] = METHODS, *, remeshed: bool = True
) -> dict[str, FloatArray]:
    """How far signatures move under each perturbation and, to compare, from one pose to another.

    Returns dict of str to (shapes, methods) float64: by the name of the perturbation. The unit is the
        distance of log-signatures from the first mesh of a class to the nearest first mesh of another class:
        beyond 1, a query may find the wrong class.
    """
    clean = [_signatures(first, methods) for first, _ in poses.values()]
    # (shapes, L) for each method.
    stacked = [np.array(column) for column in zip(*clean, strict=True)]
    apart = np.array(
        [np.sort(pairwise("log", table, table), axis=1)[:, 1] for table in stacked]
    )
    moved: dict[str, list[FloatArray]] = {}
    for number, (mesh, other_pose) in enumerate(poses.values()):
        changed = [
            *perturbed(mesh, np.random.default_rng(number), remeshed=remeshed),
            ("pose", other_pose),
        ]
        for name, variant in changed:
            after = _signatures(variant, methods)
            distance = [
                np.linalg.norm(b - a) for a, b in zip(clean[number], after, strict=True)
            ]
            moved.setdefault(name, []).append(np.array(distance) / apart[:, number])
    return {name: np.array(rows) for name, rows in moved.items()}


def perturbed(
    mesh: TriangleMesh, rng: np.random.Generator, *, remeshed: bool = True
) -> Iterator[tuple[str, TriangleMesh]]:
    """The perturbations of section 4.4 and two remeshings."""
    yield from zip(PERTURBATIONS, noisy_and_incomplete(mesh, rng), strict=True)
    yield "half faces", simplified(mesh, len(mesh.faces) // 2)
    if not remeshed:
        return
    surface = remesh(mesh, REMESHING, optimize=True)
    if np.array_equal(surface.faces, mesh.faces):
        raise BenchmarkError(
            f"fTetWild's surface could not be used: {surface.provenance[-1].notes}"
        )
    yield "fTetWild", surface


def noisy_and_incomplete(
    mesh: TriangleMesh, rng: np.random.Generator
) -> list[TriangleMesh]:
    """A mesh with each of `PERTURBATIONS`."""
    made = [noisy(mesh, size, rng) for size in NOISE]
    return made + [without_faces(mesh, share, rng) for share in REMOVED]


def noisy(mesh: TriangleMesh, size: float, rng: np.random.Generator) -> TriangleMesh:
    """A mesh with white noise along the normals of its vertices."""
    corners = mesh.vertices[mesh.faces]  # (m, 3, 3)
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean()
    offsets = size * edge * rng.standard_normal(len(mesh.vertices))
    normals = vertex_normals(mesh.vertices, mesh.faces)
    return TriangleMesh(mesh.vertices + offsets[:, None] * normals, mesh.faces)


def without_faces(
    mesh: TriangleMesh, share: float, rng: np.random.Generator
) -> TriangleMesh:
    """A mesh of which random faces were removed."""
    kept = np.sort(rng.permutation(len(mesh.faces))[round(share * len(mesh.faces)) :])
    return largest_component(compact(mesh.vertices, mesh.faces[kept]))[0]


def _signatures(mesh: TriangleMesh, methods: tuple[str, ...]) -> list[FloatArray]:
    """Log-signatures of a mesh, one by each method."""
    shape = Shape((Surface(mesh.area, unit_area_spectrum(mesh, N_MODES), mesh),))
    lengths = {"n_values": N_VALUES, "n_modes": N_MODES}
    options = (
        SignatureOptions(method=method, scale="relative", **lengths) for method in methods
    )
    return [coordinates(describe(shape, each).values) for each in options]


PERTURBED_VARIANTS: tuple[tuple[str, Scale], ...] = (
    ("r-bihdm", "relative"),
    ("r-bihdm", "area"),
    ("shape-dna", "relative"),
    ("wks", "relative"),
    ("csd", "relative"),
)

OPTIONS = tuple(
    SignatureOptions(method=method, n_values=N_VALUES, n_modes=N_MODES, scale=scale)
    for method, scale in PERTURBED_VARIANTS
)

# Longest time for one mesh; seconds.
PERTURBED_TIMEOUT = 300.0


def figure_5(folder: Path, limit: int | None) -> Iterator[str]:
    """NN and mAP of perturbed queries, for each descriptor."""
    paths = [scan.file for _, scan in spread(discover([folder]), limit)]
    tasks = list(enumerate(paths))
    found = all_in_workers(_perturbed, tasks, "perturbed", timeout=PERTURBED_TIMEOUT)
    classes = read_labels(folder / "labels.csv")
    labels = [classes[path.name] for path in paths]
    yield (
        f"Figure 5: {len(paths)} meshes of {folder.name}, each perturbed, as queries, and the others, clean, "
        "as the gallery"
    )
    yield f"NN and mAP, distance log, L = {N_VALUES}; noise in mean edge lengths, holes in shares of faces"
    names = ("clean", *PERTURBATIONS)
    yield (
        f"{'method':<12}{'scale':<10}" + "".join(f"{name:<12}" for name in names).rstrip()
    )
    for row, (method, scale) in enumerate(PERTURBED_VARIANTS):
        tables = np.stack([one[row] for one in found], axis=1)  # (1 + P, N, L)
        cells = []
        for table in tables:
            # A ranking leaves out the query, here its own clean mesh.
            rows = np.arange(len(paths))
            subset = Subset(
                rows, [DistanceBlock(rows, pairwise("log", table, tables[0]))]
            )
            measured = evaluate_rankings(
                rank_subsets([subset], [path.stem for path in paths], labels)[0]
            )
            cells.append(f"{measured.nn:.2f} {measured.map:.2f}")
        yield (
            f"{method:<12}{scale:<10}" + "".join(f"{cell:<12}" for cell in cells).rstrip()
        )


def _perturbed(task: tuple[int, Path]) -> list[FloatArray]:
    """(1 + P, L) log-signatures of a mesh, clean and with P perturbations, by each of `OPTIONS`."""
    seed, path = task
    mesh, rng = read_mesh(path), np.random.default_rng(seed)
    meshes = [mesh, *noisy_and_incomplete(mesh, rng)]
    shapes = [
        Shape((Surface(each.area, unit_area_spectrum(each, N_MODES), each),))
        for each in meshes
    ]
    return [
        coordinates(np.array([describe(shape, options).values for shape in shapes]))
        for options in OPTIONS
    ]
