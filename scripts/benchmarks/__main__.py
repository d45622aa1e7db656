"""Run a benchmark by its name: `python -m benchmarks NAME`, or scripts/benchmark NAME."""

from __future__ import annotations

import sys
from importlib import import_module

# The module of each benchmark, and what it prints or writes.
BENCHMARKS = {
    "batch": (
        "batch",
        "rates of an ingest: in one process, isolated, by two workers and by Dask",
    ),
    "catalogue": ("catalogue", "times, memory and disk space of large catalogues"),
    "fidelity": (
        "fidelity",
        "what scans and changes of clean meshes do to surfaces and rankings",
    ),
    "formats": (
        "formats",
        "what each format of meshes keeps of bodies whose parts touch",
    ),
    "grades": ("grades", "what scans of many kinds and sensors are called"),
    "holes": ("holes", "what one hole does to the signature of a scan of a person"),
    "layers": ("layers", "how many badly registered scans are found"),
    "learn": ("learning", "the metric that ships, from bodies to its file: two hours"),
    "paper": ("paper.main", "the experiments of Ye and Yu on their descriptor"),
    "people": (
        "recognition",
        "how often the right person is found, by the number of people",
    ),
    "retrieval": ("retrieval", "every whitening and re-ranking, on all labelled sets"),
    "serve": ("serve", "how many requests the search page of a large catalogue answers"),
    "spectral": ("spectral", "time, memory and error of eigenpairs, beside LaPy"),
    "speed": (
        "speed",
        "scans, eigenpairs and searches, beside the textbook's chain, LaPy and faiss",
    ),
    "transfer": ("transfer", "the metric of people on a sensor that taught it nothing"),
    # Not of speed or quality: what these make or count is part of the repository.
    "house": ("house", "the size of the house; as scripts/house"),
    "make_people": ("people", "raw scans of simulated people; as scripts/make_people"),
    "make_scans": ("samples", "the sample scans; as scripts/make_scans"),
    "sample": (
        "shipped",
        "the arrays and scans that the package ships; as scripts/sample",
    ),
    "strip": (
        "strip",
        "the picture of docs/method.md, from the catalogue of scripts/demo",
    ),
}


def main(words: list[str]) -> None:
    """Run the benchmark of the first word with the others, or print what there is."""
    name, *others = words or [""]
    if name not in BENCHMARKS:
        lines = [f"  {known:<12} {text}" for known, (_, text) in BENCHMARKS.items()]
        told = "usage: scripts/benchmark NAME [--help]"
        wrong = (
            f"there is no benchmark {name!r}\n"
            if name not in ("", "-h", "--help")
            else ""
        )
        print(
            "\n".join([wrong + told, "", *lines]),
            file=sys.stderr if wrong else sys.stdout,
        )
        sys.exit(2 if wrong else 0)
    # What the help of the benchmark calls it.
    sys.argv = [f"scripts/benchmark {name}", *others]
    import_module(f"benchmarks.{BENCHMARKS[name][0]}").main(others)


# Worker processes, whose memory is measured, import this module, and nothing of a benchmark.
if __name__ == "__main__":
    main(sys.argv[1:])
