"""Print the retrieval measures of every descriptor and matcher for clean meshes.

    .venv/bin/python scripts/benchmark_descriptors --data FOLDER

needs the sets `shrec11` and `tosca` in the folder; a set that is missing is left out, with a line of output.
A descriptor has a row for each scale, distance and whitening; a matcher, which compares pairs of shapes, has
one row. Seconds are the median time of one shape, from the stored spectrum and surface, on one core; a
matcher also has the mean time of a pair. Shapes without a signature count as misses; those that a matcher
fails on are printed with the reason. With `--n-values 23 45 --scale relative` it takes an hour on a 2.5 GHz
Xeon; without the matchers 15 minutes.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

from pcretrieve.benchmarks.arguments import add_data, argument_parser
from pcretrieve.benchmarks.described import described
from pcretrieve.benchmarks.sets import ingested, left_out
from pcretrieve.benchmarks.tables import MEASURES, Column, Table, measure_values, print_lines
from pcretrieve.benchmarks.timing import timed, use_one_core
from pcretrieve.catalogue import Catalogue
from pcretrieve.errors import OptionError
from pcretrieve.evaluation import evaluate_rankings, evaluate_table, rank
from pcretrieve.matching import MATCHERS, Matcher, PairwiseIndex, distance_matrix
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
from pcretrieve.values import Shape

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
    Column("ms a pair", 9, ".3f"),
    Column("failed", 6),
)


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
        "--methods",
        nargs="+",
        default=[*NAMES["descriptor"].all(), "hapt+r-bihdm", *NAMES["matcher"].all()],
        help="some descriptors and matchers only",
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
            matchers = [method for method in given.methods if method in NAMES["matcher"].all()]
            descriptors = [method for method in given.methods if method not in matchers]
            for matcher in matchers:
                yield from _matched(name, catalogue, MATCHERS[matcher])
            for method, n_values, scale in product(descriptors, given.n_values, given.scale):
                if scale == "area" and "relative" in given.scale and method in SAME_BY_AREA:
                    continue
                try:
                    chosen = SignatureOptions(method=method, n_values=n_values, scale=scale)
                    yield from _rows(name, catalogue, chosen)
                except OptionError as error:
                    yield f"{Table(*COLUMNS).row(name, method, n_values, scale)} left out: {error}"


def _rows(name: str, catalogue: Catalogue, options: SignatureOptions) -> Iterator[str]:
    """One line for each distance and whitening."""
    shapes = described(catalogue, options)
    for whitening in WHITENINGS:
        if whitening == "resolution" and not is_measured(options):
            continue
        made = resolution_whitening(options) if whitening == "resolution" else None
        if whitening == "neighbours":
            neighbours = RetrievalOptions(whitening=whitening)
            made = table_whitening(shapes.table, neighbours, prior=resolution_covariance(options))
        for distance, record in DISTANCES.own.items():
            if shapes.table.metric not in record.metrics:
                continue
            retrieval = RetrievalOptions(distance=distance, whitening=whitening)
            measures = evaluate_table(shapes.table, retrieval, whitening=made, failed=shapes.failed)
            yield TABLE.row(
                name,
                options.method,
                options.n_values,
                options.scale,
                distance,
                whitening,
                *measure_values(measures),
                shapes.seconds,
                None,
                len(shapes.failed),
            )


def _matched(name: str, catalogue: Catalogue, matcher: Matcher) -> Iterator[str]:
    """The line of a matcher, and one for each shape that it fails on."""
    times = []

    def prepared(shape: Shape) -> Any:
        seconds, features = timed(partial(matcher.prepare, shape))
        times.append(seconds)
        return features

    classes = {record.id: record.label for record in catalogue.records()}
    index = PairwiseIndex(
        replace(matcher, prepare=prepared),
        catalogue.signatures().ids,
        lambda shape_id: catalogue.shape(shape_id, matcher.needs),
    )
    seconds, matrix = timed(partial(distance_matrix, index))
    labels = [classes.pop(shape_id) for shape_id in matrix.ids]
    measures = evaluate_rankings(rank(matrix, labels, failed=classes))
    n = len(matrix)
    n_pairs = n * (n + 1) / 2 if matcher.symmetric else n**2
    yield TABLE.row(
        *(name, matcher.name, None, None, None, None, *measure_values(measures)),
        *(statistics.median(times), 1000 * seconds / n_pairs, len(classes)),
    )
    for failure in index.failures:
        yield f"{name} {matcher.name} failed: {failure}"
