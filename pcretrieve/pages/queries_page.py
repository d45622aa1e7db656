"""The page of one search: each query with its picture, its verdict and its nearest shapes.

It is one self-contained HTML file: pictures are inlined, and the page makes no requests.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import Any

from pcretrieve import Answer, Catalogue, DistanceMatrix, PipelineOptions, Signature, __version__
from pcretrieve.catalogue import CatalogueLike, opened
from pcretrieve.errors import ShapeError
from pcretrieve.formats import check_output
from pcretrieve.options import OptionsLike
from pcretrieve.pages.html import write_page
from pcretrieve.pages.thumbnails import Thumbnails
from pcretrieve.query import Described, Question, answers
from pcretrieve.retrieval.votes import swapping_ranks

DISTANCES = {
    "log": "log, the Euclidean distance of the logarithms of the values",
    "d1": "d1, the dissimilarity D1 of Ye and Yu",
    "d2": "d2, the dissimilarity D2 of Ye and Yu",
}


def query_page(
    catalogue: CatalogueLike,
    queries: str | Path | Iterable[str | Path | Signature],
    path: str | Path,
    *,
    k: int = 10,
    options: OptionsLike = None,
    matrix: DistanceMatrix | None = None,
    unit: str | None = None,
    labels: Collection[str] | None = None,
    exclude_self: bool = False,
    min_score: float | None = None,
    timeout: float | None = None,
    memory: float | None = None,
    up: str | None = None,
    on_answer: Callable[[str, Answer | ShapeError], None] = lambda name, answer: None,
) -> Path:
    """Answer one or more queries on an HTML page, with pictures.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue that is searched.
    queries : str, Path, or iterable of str, Path or Signature
        As for `search_many`. Scans that fail are listed on the page, with the reasons.
    path : str or Path
        The HTML file. It needs no other file.
    k : int, default 10
        This and the following parameters up to `memory` are those of `search_many`.
    options : OptionsLike, optional
    matrix : DistanceMatrix, optional
    unit : str, optional
    labels : collection of str, optional
    exclude_self : bool, default False
    min_score : float, optional
    timeout : float, optional
    memory : float, optional
    up : {"x", "-x", "y", "-y", "z", "-z"}, optional
        The axis of the files that points upwards on pictures; by default found for each shape.
    on_answer : function, optional
        Called with the name and the answer or the error of each query, when the page is written.

    Returns
    -------
    Path
        Absolute path of the page.

    Raises
    ------
    CatalogueError
        If the options require other spectra than the catalogue has.
    InputError
        As by `search`, or if the page cannot be written.
    """
    with opened(catalogue) as store:
        chosen = PipelineOptions.of(options, store.options)
        how = (matrix, timeout, memory, True, up)
        question = Question(chosen, k, labels, exclude_self, min_score, unit, *how)
        many = [queries] if isinstance(queries, (str, Path)) else [*queries]
        files = [Path(one) for one in (store.location, *many) if isinstance(one, (str, Path))]
        check_output(Path(path), files)
        outcomes = list(answers(store, many, question))
        written = write_query_page(path, store, outcomes, question, up=up)
        for name, outcome in outcomes:
            on_answer(name, outcome)
        return written


def write_query_page(
    path: str | Path,
    catalogue: Catalogue,
    outcomes: Iterable[tuple[str, Answer | ShapeError]],
    question: Question,
    *,
    up: str | None = None,
) -> Path:
    """Write answers that are known already on a page; those that failed are listed at the end."""
    panels, failures, thumbnails = [], [], Thumbnails(up)
    for name, outcome in outcomes:
        if isinstance(outcome, ShapeError):
            failures.append((name, outcome))
        else:
            panels.append({"name": name} | _panel(catalogue, outcome, thumbnails))
    names = [panel["name"] for panel in panels] + [name for name, _ in failures]
    return write_page(
        path,
        "query.html",
        title=Path(names[0]).name if len(names) == 1 else f"{len(names)} queries",
        catalogue=Path(catalogue.location).name,
        panels=panels,
        failures=failures,
        min_score=question.min_score,
        settings=settings_in_words(catalogue, question),
        version=__version__,
    )


def settings_in_words(catalogue: Catalogue, question: Question) -> dict[str, str]:
    """How shapes are compared, in words."""
    classes = f"the class {' or '.join(sorted(question.labels))} of " if question.labels else ""
    least = {} if question.min_score is None else {"least score": f"{question.min_score:g}"}
    if question.matrix is not None:
        n_shapes = len(question.matrix)
        return {"searched": f"{classes}{n_shapes} shapes", "distance": "that of a matrix"} | least
    index = catalogue.index(question.options)
    compared, retrieval = question.options.compared, question.options.retrieval
    size = compared.size_weight
    return {
        "searched": f"{classes}{len(index)} shapes",
        "signature": f"{compared.method}, {len(index.whitening.mean)} values, "
        + (f"with the size, weighted by {size:g}" if size else "of the form alone"),
        "distance": DISTANCES.get(retrieval.distance, retrieval.distance),
        "whitening": catalogue.whitening(question.options).reason,
        "re-ranking": "none" if retrieval.rerank == "none" else f"by {retrieval.rerank} neighbours",
        "score": index.scores.reason if index.scores else "none, because labels and shapes are too few",
    } | least


def _panel(catalogue: Catalogue, answer: Answer, thumbnails: Thumbnails) -> dict[str, Any]:
    """One query as the template shows it; `swaps`: first and last of each run of ranks that could swap."""
    query, record, picture, verdict = answer.query, None, None, None
    if isinstance(query, str):
        record = catalogue.record(query)
        picture, verdict = thumbnails.of(catalogue, record), record.verdict
    elif isinstance(query, Described):
        picture, verdict = query.picture, query.verdict
    results = [
        row | {"picture": thumbnails.of(catalogue, found)}
        for row, found in zip(answer.rows(), answer.records, strict=True)
    ]
    swaps = [] if answer.rank_ranges is None else swapping_ranks(answer.rank_ranges)
    shown = {"answer": answer, "results": results, "swaps": swaps}
    return shown | {"record": record, "picture": picture, "verdict": verdict}
