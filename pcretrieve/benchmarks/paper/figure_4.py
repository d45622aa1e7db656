"""Figure 4: retrieval of silhouettes, as planar meshes, by R-BiHDM and by Shape-DNA."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np
from PIL import Image, ImageDraw

from pcretrieve.atomic import write_file
from pcretrieve.benchmarks.paper.silhouettes import planar_mesh, read_silhouette
from pcretrieve.benchmarks.paper.spectra import unit_area_spectrum
from pcretrieve.benchmarks.progress import progress
from pcretrieve.benchmarks.sets import spread
from pcretrieve.descriptors import describe
from pcretrieve.errors import BenchmarkError, PcretrieveError
from pcretrieve.evaluation import evaluate_table
from pcretrieve.ingestion.isolation import in_processes
from pcretrieve.options import RetrievalOptions, SignatureOptions
from pcretrieve.retrieval.distances import log_signatures, pairwise
from pcretrieve.values import FloatArray, ModalSpectrum, Shape, SignatureTable, Surface

__all__ = ["figure_4", "ranked_strips", "silhouette_rows"]

Scale = Literal["relative", "area"]

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


def figure_4(folder: Path, strips: Path | None, limit: int | None = None) -> Iterator[str]:
    """Retrieval measures of the silhouettes by each descriptor and length; and a picture of ranked lists.

    Parameters
    ----------
    folder : Path
        The silhouettes of MPEG-7 CE Shape-1 Part B: pictures named like their class, a hyphen and a number.
    strips : Path or None
        The PNG file of ranked lists to write; None for no picture.
    limit : int, optional
        Number of silhouettes, evenly spread over the folder; by default all.

    Yields
    ------
    str
        A line of the table.

    Raises
    ------
    BenchmarkError
        If the folder has no pictures.
    """
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
    """A row of retrieval measures for each descriptor, scale and length.

    Parameters
    ----------
    spectra : mapping of Path to ModalSpectrum
        The spectra of the silhouettes, scaled to unit area, by file.

    Yields
    ------
    str
        A line of the table.
    """
    yield f"{'method':<12}{'scale':<10}{'L':<4}{'NN':<7}{'FT':<7}mAP"
    for (method, scale), n_values in product(VARIANTS, LENGTHS):
        values = _values(spectra, method, scale, n_values)
        names, labels = zip(*((path.stem, _class(path)) for path in spectra), strict=True)
        found = evaluate_table(
            SignatureTable(names, values, method, labels=labels), RetrievalOptions(whitening="none")
        )
        yield f"{method:<12}{scale:<10}{n_values:<4}{found.nn:<7.3f}{found.ft:<7.3f}{found.map:.3f}"


def ranked_strips(spectra: Spectra) -> bytes:
    """Draw the nearest silhouettes of some queries, one row for each descriptor of `SHOWN`.

    Parameters
    ----------
    spectra : mapping of Path to ModalSpectrum
        The spectra of the silhouettes, scaled to unit area, by file. The queries are spread over them.

    Returns
    -------
    bytes
        A PNG file. Each row begins with its query; shapes of the class of the query are black, others grey.
    """
    paths = tuple(spectra)
    tables = [log_signatures(_values(spectra, *shown, STRIP_LENGTH)) for shown in SHOWN]
    queries = spread(paths, N_STRIPS)
    step = SIDE + MARGIN
    height = len(queries) * len(SHOWN) * step + MARGIN * (len(queries) + 1)
    sheet = Image.new("RGB", (N_SHOWN * step + 2 * MARGIN, height), "white")
    pen = ImageDraw.Draw(sheet)
    y = MARGIN
    for query, path in queries:
        for table in tables:
            distances = pairwise("log", table[query : query + 1], table)[0]
            for column, position in enumerate(np.argsort(distances, kind="stable")[:N_SHOWN]):
                ink = (20, 24, 30) if _class(paths[position]) == _class(path) else (170, 175, 182)
                sheet.paste(_thumbnail(paths[position], ink), (2 * MARGIN + column * step, y))
            y += step
        pen.line((MARGIN, y, sheet.width - MARGIN, y), (210, 214, 220))
        y += MARGIN
    data = io.BytesIO()
    sheet.save(data, "PNG", optimize=True)
    return data.getvalue()


def _spectra(paths: Sequence[Path]) -> tuple[Spectra, Mapping[Path, PcretrieveError]]:
    """The spectra of silhouettes, and the errors of others, in the order of the files."""
    answers = in_processes(
        _spectrum, progress(paths, "silhouettes"), workers=None, timeout=TIMEOUT, memory=None
    )
    outcomes = dict(answers)
    failed = {path: answer for path, answer in outcomes.items() if isinstance(answer, PcretrieveError)}
    made = {path: outcomes[path] for path in paths if path not in failed}
    return {path: answer for path, answer in made.items() if isinstance(answer, ModalSpectrum)}, failed


def _spectrum(path: Path) -> ModalSpectrum:
    return unit_area_spectrum(planar_mesh(read_silhouette(path)), N_MODES)


def _values(spectra: Spectra, method: str, scale: Scale, n_values: int) -> FloatArray:
    """(N, n_values) signatures."""
    options = SignatureOptions(method=method, n_values=n_values, n_modes=N_MODES, scale=scale)
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
