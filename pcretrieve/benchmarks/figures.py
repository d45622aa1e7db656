"""Print the figures of retrieval, surfaces, time and memory that the README states.

    .venv/bin/python scripts/benchmark_figures --data FOLDER

needs the sets `shrec11`, `tosca` and `stanford_dragon` in the folder, and the sample scans; parts whose set
is missing are left out, with a line of output. One core, one worker. About 15 minutes on a 2.5 GHz Xeon.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from pcretrieve.benchmarks.arguments import add_data, argument_parser
from pcretrieve.benchmarks.commands import run_command
from pcretrieve.benchmarks.sets import ingested, left_out, read_mesh
from pcretrieve.benchmarks.tables import MEASURES, Column, Table, measure_values, print_lines
from pcretrieve.benchmarks.timing import use_one_core
from pcretrieve.errors import PcretrieveError
from pcretrieve.evaluation import RetrievalMeasures, evaluate_rankings, evaluate_table, rank_catalogue
from pcretrieve.ingestion.discover import discover
from pcretrieve.ingestion.labels import read_labels
from pcretrieve.options import PipelineOptions, RetrievalOptions
from pcretrieve.simulation import UniformOptions, scan_uniformly, write_ply
from pcretrieve.values import SignatureTable

__all__ = ["main"]

SHORT = PipelineOptions().changed(signature={"method": "r-bihdm", "n_values": 23})
KEEP = SHORT.changed(surface={"mode": "keep"})

# Relative values, as equation (10) of the paper has them; the default is by area.
RELATIVE = {"scale": "relative"}
N_REPEATS = 5

# The part for which no data set is needed.
SAMPLES = "samples"

# Every mesh of TOSCA and every sample scan is a sphere once its holes are closed.
SPHERE = 2

TABLE = Table(Column("figure", 58, align="<"), Column("measured", 8, align="<"))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table.

    Parameters
    ----------
    arguments : sequence of str, optional
        By default the arguments of the command line.
    """
    parser = argument_parser(__doc__)
    add_data(parser)
    parser.add_argument("--only", choices=PARTS, help="one set only")
    parser.add_argument("--samples", type=Path, default=Path("scans"), help="folder of the sample scans")
    given = parser.parse_args(arguments)
    use_one_core()
    try:
        print_lines(_lines(given.data, given.samples, given.only))
    except PcretrieveError as error:
        sys.exit(str(error))


def _lines(data: Path, samples: Path, only: str | None) -> Iterator[str]:
    yield TABLE.head
    times = [run_command("--help")[0] for _ in range(N_REPEATS)]
    yield TABLE.row("pcretrieve --help", f"median {statistics.median(times):.2f} s")
    for name, part in PARTS.items():
        if only not in (None, name):
            continue
        source = samples if name == SAMPLES else data / name
        if missing := left_out(name, source):
            yield missing
            continue
        with tempfile.TemporaryDirectory() as folder:
            yield from part(source, Path(folder))


def _dragon(data: Path, _: Path) -> Iterator[str]:
    """The Stanford dragon, 15 range scans."""
    seconds, peak = run_command("signature", str(data / "dragonStandRight.conf"))
    what = "dragon, 15 range scans -> signature, whole command"
    yield TABLE.row(what, f"{seconds:.1f} s, peak {peak:.0f} MiB")


def _shrec11(data: Path, folder: Path) -> Iterator[str]:
    """SHREC'11, 600 meshes of 500 faces, kept as they are."""
    longer = KEEP.changed(signature={"n_values": 45})
    pca = longer.changed(retrieval={"whitening": "pca"})
    with ingested(data, folder / "shrec11.sqlite", KEEP) as (catalogue, _):
        relative = catalogue.signatures(KEEP.changed(signature=RELATIVE))
        plain = evaluate_table(relative, RetrievalOptions(distance="d2", whitening="none"))
        whitened = evaluate_table(catalogue.signatures(pca), pca.retrieval)
        within = evaluate_table(catalogue.signatures(longer), RetrievalOptions(whitening="within-class"))
    yield TABLE.row("SHREC'11 L=23 relative D2 no whitening", _words(plain))
    yield TABLE.row("SHREC'11 L=45 relative log PCA-whitened", _words(whitened))
    yield TABLE.row("SHREC'11 L=45 area log within-class, grouped folds", _words(within))


def _tosca(data: Path, folder: Path) -> Iterator[str]:
    """TOSCA, 76 meshes, kept as they are and as noisy scans that are rebuilt."""
    plain = RetrievalOptions(whitening="none")
    with ingested(data, folder / "clean.sqlite", KEEP) as (catalogue, _):
        truth = catalogue.signatures(KEEP.changed(signature=RELATIVE))
        clean = evaluate_table(catalogue.signatures(), plain)
    scans = folder / "tosca"
    n = _write_scans(data, scans)
    labels = {Path(name).stem: label for name, label in read_labels(data / "labels.csv").items()}
    with ingested(scans, folder / "scans.sqlite", SHORT, labels) as (catalogue, summary):
        failed = {record.id: record.label for record in summary.failed}
        found = catalogue.signatures(catalogue.options.changed(signature=RELATIVE))
        rebuilt = evaluate_table(catalogue.signatures(), plain, failed=failed)
    done = summary.done
    yield TABLE.row("TOSCA scans with a closed manifold surface", f"{len(done) / n:.1%} of {n}")
    yield TABLE.row("TOSCA clean meshes", _words(clean))
    yield TABLE.row("TOSCA rebuilt from noisy scans", _words(rebuilt))
    error = f"median {statistics.median(_log_errors(found, truth)):.2f}"
    yield TABLE.row("  log-signature error against the clean mesh, relative", error)
    right = sum(record.euler == SPHERE for record in done)
    yield TABLE.row("  Euler characteristic 2", f"{right / n:.0%}")
    seconds = statistics.median(record.seconds for record in done)
    yield TABLE.row("30k points -> signature, in a batch, one core", f"median {seconds:.2f} s")
    stages: dict[str, list[float]] = {}
    for record in done:
        for step in record.steps:
            stages.setdefault(step.stage, []).append(step.seconds)
    for stage, times in stages.items():
        yield TABLE.row(f"  {stage}", f"median {statistics.median(times):.2f} s")
    paths = sorted(scans.iterdir())[:: max(1, n // N_REPEATS)][:N_REPEATS]
    alone = [run_command("signature", str(path)) for path in paths]
    seconds, peak = statistics.median(s for s, _ in alone), max(m for _, m in alone)
    yield TABLE.row(
        "30k points -> signature, whole command, one core", f"median {seconds:.2f} s, peak {peak:.0f} MiB"
    )


def _samples(data: Path, folder: Path) -> Iterator[str]:
    """The sample scans by the default chain and by the textbook chain."""
    for name, options in {
        "defaults": PipelineOptions(),
        "classic": PipelineOptions.preset("classic"),
    }.items():
        with ingested(data, folder / f"{name}.sqlite", options) as (catalogue, summary):
            measures = evaluate_rankings(rank_catalogue(catalogue).rankings)
        yield TABLE.row(f"sample scans, {name}", _words(measures))
        wrong = sum(record.euler != SPHERE for record in summary.done)
        yield TABLE.row(
            "  surfaces that are no topological sphere, failures", f"{wrong}, {len(summary.failed)}"
        )
        seconds = statistics.median(record.seconds for record in summary.done)
        yield TABLE.row("  scan -> signature, in a batch, one core", f"median {seconds:.2f} s")


def _write_scans(data: Path, folder: Path) -> int:
    """A noisy scan of each mesh, by the number of the mesh as seed; how many there are."""
    folder.mkdir()
    meshes = discover([data])
    for number, path in enumerate(meshes):
        cloud = scan_uniformly(read_mesh(path), UniformOptions(), np.random.default_rng(number))
        write_ply(folder / f"{path.stem}.ply", cloud.points)
    return len(meshes)


def _log_errors(found: SignatureTable, truth: SignatureTable) -> list[float]:
    """Distance of the log-signature of each shape from that of the clean mesh."""
    row = {shape_id: k for k, shape_id in enumerate(truth.ids)}
    return [
        float(np.linalg.norm(np.log(values / truth.values[row[shape_id]])))
        for shape_id, values in zip(found.ids, found.values, strict=True)
    ]


def _words(measures: RetrievalMeasures) -> str:
    return " ".join(
        f"{name} {value:.4f}" for name, value in zip(MEASURES, measure_values(measures), strict=True)
    )


PARTS: dict[str, Callable[[Path, Path], Iterator[str]]] = {
    "stanford_dragon": _dragon,
    "shrec11": _shrec11,
    "tosca": _tosca,
    SAMPLES: _samples,
}
