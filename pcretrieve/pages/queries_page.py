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

# Number of pairs that prove that there are no duplicates.
N_PROOFS = 3


def query_page(
    catalogue: pr.Catalogue | str | Path,
    queries: str | Path | Iterable[str | Path | pr.Signature],
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
        As for `search_many`. Scans that fail are listed on the page, with the reasons.
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
        asked |= {"options": chosen, "has_pictures": True, "up": thumbnails.up}
        outcomes = list(pr.search_many(store, many, **asked))
        compared = {
            name: asked[name]
            for name in ("matrix", "labels", "min_score")
            if name in asked
        }
        written = write_page(
            path,
            "query.html",
            title=Path(outcomes[0][0]).name
            if len(outcomes) == 1
            else f"{len(outcomes)} scans",
            catalogue=Path(store.location).stem,
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


def duplicates_page(
    catalogue: pr.Catalogue | str | Path,
    pairs: Sequence[pr.NearPair],
    path: str | Path,
    *,
    options: OptionsLike = None,
    up: str | None = None,
) -> Path:
    """Show the pairs that `duplicates` has found side by side on an HTML page.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue that was searched.
    pairs : sequence of NearPair
        The pairs. If there are none, the page shows the nearest pairs as a proof.
    path : str or Path
        The HTML file. It needs no other file.
    options : OptionsLike, optional
        Signature, distance and whitening by which the shapes were compared.
    up : {"x", "-x", "y", "-y", "z", "-z"}, optional
        The axis of the files that points upwards on pictures; by default found for each shape.

    Returns
    -------
    Path
        Absolute path of the page.

    Raises
    ------
    CatalogueError
        If the options require other spectra than the catalogue has.
    InputError
        If the page cannot be written.
    """
    with pr.Catalogue.opened(catalogue) as store:
        chosen = pr.PipelineOptions.of(options, store.options)
        check_target(Path(path), [Path(store.location)])
        thumbnails = Thumbnails(store, up)
        shown = pairs or _nearest_pairs(store, chosen)

        def card(shape_id: str) -> tuple[pr.Record, bytes | None]:
            record = store.record(shape_id)
            return record, thumbnails.of(store, record)

        return write_page(
            path,
            "duplicates.html",
            title=f"Duplicates in {Path(store.location).stem}",
            n_shapes=len(store),
            found=pairs,
            pairs=[(card(pair.first), card(pair.second), pair) for pair in shown],
            settings=settings_in_words(store, chosen) if len(store) else {},
            version=pr.__version__,
        )


def _nearest_pairs(
    catalogue: pr.Catalogue, options: pr.PipelineOptions
) -> list[pr.NearPair]:
    """The nearest pairs of all shapes, nearest first."""
    if len(catalogue) < 2:
        return []
    made = pr.index(catalogue, options=options)
    gaps: dict[tuple[str, str], float] = {}
    for one in made.ids:
        near = made.nearest(one, N_PROOFS + 1)
        for other, gap in zip(near.ids, near.distances.tolist(), strict=True):
            if other != one:
                gaps[min(one, other), max(one, other)] = gap
    ranked = sorted(gaps.items(), key=lambda pair: (pair[1], pair[0]))
    return [pr.NearPair(*pair, gap, np.inf) for pair, gap in ranked[:N_PROOFS]]


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
