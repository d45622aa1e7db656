"""Print the retrieval measures of every descriptor for clean meshes, by scale, distance and whitening.

    .venv/bin/python scripts/benchmark_descriptors --data FOLDER

needs the sets `shrec11` and `tosca` in the folder; a set that is missing is left out, with a line of output.
Seconds are the median time of the descriptor for one shape, from the stored spectrum and surface, on one
core. Shapes without a signature count as misses. With `--n-values 23 45 --scale relative` it takes 15 minutes
on a 2.5 GHz Xeon.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcretrieve.benchmarks.arguments import add_data, argument_parser
from pcretrieve.benchmarks.sets import ingested, left_out
from pcretrieve.benchmarks.tables import MEASURES, Column, Table, measure_values, print_lines
from pcretrieve.benchmarks.timing import timed, use_one_core
from pcretrieve.catalogue import Catalogue
from pcretrieve.descriptors import DESCRIPTORS, describe
from pcretrieve.errors import OptionError, ShapeError
from pcretrieve.evaluation import evaluate_table
from pcretrieve.names import METHODS, NAMES
from pcretrieve.options import (
    PipelineOptions,
    RetrievalOptions,
    SignatureOptions,
)
from pcretrieve.retrieval import (
    DISTANCES,
    WHITENINGS,
    resolution_covariance,
    resolution_whitening,
    table_whitening,
)
from pcretrieve.retrieval.resolution import is_measured
from pcretrieve.types import FloatArray, Signature, SignatureTable

__all__ = ["main"]

DATA_SETS = ("shrec11", "tosca")

# Descriptors whose values are the same by area and relative.
SAME_BY_AREA = {name for name, has_size in METHODS.items() if not has_size} | {"shape-dna"}

COLUMNS = (
    Column("set", 8, align="<"),
    Column("method", 19, align="<"),
    Column("L", 3),
    Column("scale", 8, align="<"),
)
TABLE = Table(
    *COLUMNS,
    Column("distance", 8, align="<"),
    Column("whitening", 12, align="<"),
    *(Column(name, 6, ".4f") for name in MEASURES),
    Column("s a shape", 9, ".4f"),
    Column("failed", 6),
)


class Described(NamedTuple):
    """The signatures of a catalogue's shapes by one descriptor.

    Attributes
    ----------
    table : SignatureTable
        The signatures.
    failed : dict of str to (str or None)
        Classes of the shapes without such a signature.
    seconds : float
        Median time of a signature.
    """

    table: SignatureTable
    failed: dict[str, str | None]
    seconds: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table.

    Parameters
    ----------
    arguments : sequence of str, optional
        By default the arguments of the command line.
    """
    parser = argument_parser(__doc__)
    add_data(parser)
    parser.add_argument("--only", choices=DATA_SETS, help="one set only")
    parser.add_argument(
        "--methods", nargs="+", default=NAMES["descriptor"].all(), help="some descriptors only"
    )
    parser.add_argument("--n-values", type=int, nargs="+", default=[23, 45, 60], help="lengths")
    parser.add_argument(
        "--scale",
        nargs="+",
        choices=["relative", "area", "absolute"],
        default=["relative", "area"],
        help="normalisation of the values; area is left out if it gives the same values as relative",
    )
    parser.add_argument("--element", default="linear", help="finite element of the spectra")
    given = parser.parse_args(arguments)
    use_one_core()
    print_lines(_lines(given))


def _lines(given: argparse.Namespace) -> Iterator[str]:
    options = PipelineOptions().changed(surface={"mode": "keep"}, spectral={"element": given.element})
    yield TABLE.head
    for name in (given.only,) if given.only else DATA_SETS:
        folder: Path = given.data / name
        if missing := left_out(name, folder):
            yield missing
            continue
        with (
            tempfile.TemporaryDirectory() as temporary,
            ingested(folder, Path(temporary) / "shapes.sqlite", options) as (catalogue, _),
        ):
            for method, n_values, scale in product(given.methods, given.n_values, given.scale):
                if scale == "area" and "relative" in given.scale and method in SAME_BY_AREA:
                    continue
                try:
                    chosen = SignatureOptions(method=method, n_values=n_values, scale=scale)
                    yield from _rows(name, catalogue, chosen)
                except OptionError as error:
                    yield f"{Table(*COLUMNS).row(name, method, n_values, scale)} left out: {error}"


def _rows(name: str, catalogue: Catalogue, options: SignatureOptions) -> Iterator[str]:
    """One line for each distance and whitening."""
    described = _described(catalogue, options)
    for whitening in WHITENINGS:
        if whitening == "resolution" and not is_measured(options):
            continue
        made = resolution_whitening(options) if whitening == "resolution" else None
        if whitening == "neighbours":
            neighbours = RetrievalOptions(whitening=whitening)
            made = table_whitening(described.table, neighbours, prior=resolution_covariance(options))
        for distance in DISTANCES.own:
            retrieval = RetrievalOptions(distance=distance, whitening=whitening)
            measures = evaluate_table(described.table, retrieval, whitening=made, failed=described.failed)
            yield TABLE.row(
                name,
                options.method,
                options.n_values,
                options.scale,
                distance,
                whitening,
                *measure_values(measures),
                described.seconds,
                len(described.failed),
            )


def _described(catalogue: Catalogue, options: SignatureOptions) -> Described:
    values: dict[str, FloatArray] = {}
    times = []
    labels = {record.id: record.label for record in catalogue.records()}

    def described(shape_id: str) -> Signature:
        return describe(catalogue.shape(shape_id, DESCRIPTORS[options.method].needs), options)

    for shape_id in catalogue.signatures().ids:
        try:
            seconds, signature = timed(partial(described, shape_id))
        except ShapeError:
            continue  # counts as a miss
        values[shape_id] = signature.values
        times.append(seconds)
    classes = tuple(labels[shape_id] for shape_id in values)
    table = SignatureTable(tuple(values), np.array(list(values.values())), options.method, labels=classes)
    failed = {shape_id: label for shape_id, label in labels.items() if shape_id not in values}
    return Described(table, failed, statistics.median(times))
