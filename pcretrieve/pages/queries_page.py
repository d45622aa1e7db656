"""The page of one search: each query with its picture, its grade and its nearest shapes.

It is one self-contained HTML file: pictures are inlined, and the page makes no requests.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import pcretrieve as pr
from pcretrieve.options import OptionsLike
from pcretrieve.pages.html import write_page
from pcretrieve.pages.thumbnails import Thumbnails
from pcretrieve.values.files import check_target

# Two near shapes, their distance and its limit.
Pair = tuple[str, str, float, float]


def query_page(
    catalogue: pr.Catalogue | str | Path,
    queries: str | Path | Iterable[str | Path | pr.Signature | Pair],
    path: str | Path,
    *,
    options: OptionsLike = None,
    up: str | None = None,
    on_answer: Callable[[str, pr.Answer | pr.ShapeError], None] = lambda name, answer: (
        None
    ),
    **asked: Any,
) -> Path:
    """Answer one or more queries on an HTML page, with pictures.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue that is searched.
    queries : str, Path, or iterable of str, Path or Signature
        As for `search_many`. Scans that fail are listed on the page, with the reasons. Or the pairs that
        `duplicates` has found, which are shown side by side.
    path : str or Path
        The HTML file. It needs no other file.
    options : OptionsLike, optional
        Signature, distance and whitening. By default the options of the catalogue.
    up : {"x", "-x", "y", "-y", "z", "-z"}, optional
        The axis of the files that points upwards on pictures; by default found for each shape.
    on_answer : function, optional
        Called with the name and the answer or the error of each query, when the page is written.
    asked : object
        The other arguments of `search_many` by name: `k`, `matrix`, `unit`, `labels`, `exclude_self`,
        `min_score`, `timeout` and `memory`.

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
    with pr.Catalogue.opened(catalogue) as store:
        chosen = pr.PipelineOptions.of(options, store.options)
        many = [queries] if isinstance(queries, (str, Path)) else [*queries]
        named = (one for one in (store.location, *many) if isinstance(one, (str, Path)))
        check_target(Path(path), [*map(Path, named)])
        thumbnails = Thumbnails(store, up)
        pairs = [_paired(store, one) for one in many if isinstance(one, tuple)]
        alone = [one for one in many if not isinstance(one, tuple)]
        asked |= {"options": chosen, "has_pictures": True, "up": thumbnails.up}
        outcomes = pairs + list(pr.search_many(store, alone, **asked))
        compared = {
            name: asked[name]
            for name in ("matrix", "labels", "min_score")
            if name in asked
        }
        written = write_page(
            path,
            "query.html",
            title=_title(outcomes, "pairs" if pairs else "queries"),
            catalogue=Path(store.location).name,
            panels=[
                {"name": name} | _panel(store, one, thumbnails)
                for name, one in outcomes
                if isinstance(one, pr.Answer)
            ],
            failures=[
                (name, one) for name, one in outcomes if isinstance(one, pr.ShapeError)
            ],
            settings=settings_in_words(store, chosen, **compared),
            version=pr.__version__,
        )
        for name, outcome in outcomes:
            on_answer(name, outcome)
        return written


def _title(outcomes: Sequence[tuple[str, object]], what: str) -> str:
    """The name of the only query, or how many there are."""
    if len(outcomes) == 1:
        return Path(outcomes[0][0]).name
    return f"{len(outcomes)} {what}"


def _paired(catalogue: pr.Catalogue, pair: Pair) -> tuple[str, pr.Answer]:
    """A pair as a query with one answer."""
    first, second, distance, limit = pair
    found = pr.Neighbors((second,), np.array([distance]))
    name = f"{first} and {second}, less than {limit:#.3g} apart"
    return name, pr.Answer(found, (catalogue.record(second),), query=first)


def settings_in_words(
    catalogue: pr.Catalogue,
    options: pr.PipelineOptions,
    matrix: pr.DistanceMatrix | None = None,
    labels: Collection[str] | None = None,
    min_score: float | None = None,
) -> dict[str, str]:
    """How shapes are compared, in words."""
    classes = f"the class {' or '.join(sorted(labels))} of " if labels else ""
    least = {} if min_score is None else {"least score": f"{min_score:g}"}
    if matrix is not None:
        return {
            "searched": f"{classes}{len(matrix)} shapes",
            "distance": "that of a matrix",
        } | least
    index = pr.index(catalogue, options=options)
    compared, retrieval = options.signature, options.retrieval
    size = compared.size_weight
    return {
        "searched": f"{classes}{len(index)} shapes",
        "signature": f"{compared.method}, {len(index.whitening.mean)} values, "
        + (f"with the size, weighted by {size:g}" if size else "of the form alone"),
        "distance": retrieval.distance,
        "whitening": index.whitening.reason,
        "re-ranking": "none"
        if retrieval.rerank == "none"
        else f"by {retrieval.rerank} neighbours",
        "score": index.reason,
    } | least


def _panel(
    catalogue: pr.Catalogue, answer: pr.Answer, thumbnails: Thumbnails
) -> dict[str, Any]:
    """One query as the template shows it."""
    record, picture = None, getattr(answer.query, "picture", None)
    if isinstance(answer.query, str):
        record = catalogue.record(answer.query)
        picture = thumbnails.of(catalogue, record)
    results = [
        row | {"picture": thumbnails.of(catalogue, found)}
        for row, found in zip(answer.rows(), answer.records, strict=True)
    ]
    shown = {"answer": answer, "results": results, "record": record}
    return shown | {"picture": picture}
