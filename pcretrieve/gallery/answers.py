"""Catalogue and questions → answers: ranked shapes, and who a query is."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pcretrieve.catalogue import Catalogue, CatalogueLike, Record, thumbnails
from pcretrieve.errors import (
    InputError,
    OptionError,
    PcretrieveError,
    ScanReadError,
    ShapeError,
    did_you_mean,
)
from pcretrieve.gallery.fitted import index
from pcretrieve.options import OptionsLike, PipelineOptions, check_many
from pcretrieve.retrieval.covariances import LEAST_SHAPES
from pcretrieve.retrieval.distances import checked_k, nearest_of, position_of
from pcretrieve.values import Grade, Neighbors, Signature
from pcretrieve.values.base import Value, unit_note

if TYPE_CHECKING:
    from pcretrieve.formats import ScanLike, ScanPath
    from pcretrieve.retrieval import DistanceMatrix
    from pcretrieve.retrieval.scores import MatchScores

# Least certainty of an answer that is called sure, and below which nobody in the collection is meant:
# measured on classes that were left out, see docs/decisions.md, sure.
SURE = 0.8
UNLIKELY = 0.5

# Ratio of the numbers of faces from which distances are less exact: see docs/benchmarks.md, resolution.
FINER = 4

# Number of results, or more, among which the next class is looked for.
LOOKED_AT = 30


@dataclass(frozen=True, slots=True)
class Question:
    """What a search asks of a catalogue, whatever its queries are.

    options, k, labels, exclude_self, min_score, unit, matrix: as in `search`.
    timeout, memory: limits of the process of a scan, seconds and GiB; without a timeout, it is this process.
    has_picture, up: as for `described_scan`. false_match_rate: as in `search_many`.
    """

    options: PipelineOptions
    k: int = 10
    labels: Collection[str] | None = None
    exclude_self: bool = False
    min_score: float | None = None
    unit: str | None = None
    matrix: DistanceMatrix | None = None
    timeout: float | None = None
    memory: float | None = None
    has_picture: bool = False
    up: str | None = None
    false_match_rate: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "k", checked_k(self.k))
        for name in ("min_score", "false_match_rate"):
            value = getattr(self, name)
            if value is not None and not 0 <= value <= 1:
                raise OptionError(f"{name} must be between 0 and 1, got {value}")

    def scan_options(self, catalogue: Catalogue) -> PipelineOptions:
        """The options by which a scan that the catalogue does not have is processed."""
        own = catalogue.options.model_copy(update={"signature": self.options.signature})
        return own if self.unit is None else own.changed(scan={"unit": self.unit})


@dataclass(frozen=True, slots=True, eq=False)
class Described:
    """The signature of a query; its grade, and picture and size of its surface, if they are known."""

    signature: Signature
    grade: Grade | None = None
    picture: bytes | None = None
    n_faces: int | None = None
    area: float | None = None


Verdict = Literal["sure", "between", "stranger", "unknown"]

# What an answer says of a query, in JSON and CSV as in Python; a table has the neighbours after it.
SAID = ("verdict", "label", "other", "certainty", "because")
NEIGHBOR = ("rank", "neighbor", "neighbor_label", "distance", "score", "path")


@dataclass(frozen=True, slots=True, eq=False)
class Answer(Value):
    """Who a query is, and its nearest neighbours.

    Attributes
    ----------
    neighbors : Neighbors
        The neighbours, nearest first.
    records : tuple of Record, length k
        The record of each neighbour.
    verdict : {"sure", "between", "stranger", "unknown"}
        "sure": the query is of the class `label`. "between": of `label` or of `other`, or of a class that the
        collection does not have. "stranger": of no class of the collection. "unknown": too few shapes have
        classes to tell.
    label : str or None
        Class of the nearest shape, the query itself left out; None if no shape nearby has a class.
    other : str or None
        The next class, if neighbours have one.
    certainty : float or None
        Probability that `label` is right, estimated from the labelled shapes of the catalogue.
    because : str
        The distances that the verdict is from.
    scan : Grade or None
        The grade of the query; None if that is not known.
    query : str or Described, optional
        The query: its id in the catalogue, or its signature.
    notes : tuple of str
        What makes the answer less exact: another size or another number of faces than those of the
        neighbours, or a false-match rate that the catalogue has too few pairs for.
    """

    neighbors: Neighbors
    records: tuple[Record, ...]
    verdict: Verdict = "unknown"
    label: str | None = None
    other: str | None = None
    certainty: float | None = None
    because: str = ""
    scan: Grade | None = None
    query: str | Described | None = None
    notes: tuple[str, ...] = ()
    #: Columns of a table of answers.
    columns: ClassVar = ("query", *SAID, "scan", *NEIGHBOR)

    @property
    def named(self) -> str:
        """The class that is meant, or both; empty if none is."""
        meant = {"between": (self.label, self.other), "stranger": ()}
        return " or ".join(filter(None, meant.get(self.verdict, (self.label,))))

    def __str__(self) -> str:
        """The verdict in one line, the class first if that is sure."""
        if self.verdict == "sure":
            return f"{self.named}, sure"
        return f"{self.verdict}: {self.named}" if self.named else self.verdict

    def _repr_html_(self) -> str:
        return f"{self.neighbors._repr_html_()}<p>{escape(f'{self}, because {self.because}')}</p>"

    def document(self) -> dict[str, Any]:
        """The answer for JSON, in the names of its attributes."""
        said: dict[str, Any] = {name: getattr(self, name) for name in SAID}
        scan = None if self.scan is None else asdict(self.scan)
        return said | {"scan": scan, "notes": self.notes, "neighbors": self.rows()}

    def rows(self) -> list[dict[str, Any]]:
        """The neighbours, with the names that commands and the search page give their columns."""
        known = self.neighbors.scores
        return [
            {
                "rank": row + 1,
                "id": record.id,
                "path": record.path,
                "label": record.label,
                "distance": float(self.neighbors.distances[row]),
                "score": None if known is None else float(known[row]),
                "grade": None if record.grade is None else asdict(record.grade),
            }
            for row, record in enumerate(self.records)
        ]

    def table(self, name: str) -> list[list[Any]]:
        """Rows of `columns`, one for each neighbour, or one without; `name` is that of the query."""
        said = [getattr(self, each) for each in SAID]
        scan = None if self.scan is None else self.scan.name
        keys = ("rank", "id", "label", "distance", "score", "path")
        found = [[row[key] for key in keys] for row in self.rows()]
        return [[name, *said, scan, *row] for row in found or [[None] * len(NEIGHBOR)]]


def search(
    catalogue: CatalogueLike,
    query: ScanLike | Signature,
    *,
    k: int = 10,
    options: OptionsLike = None,
    matrix: DistanceMatrix | None = None,
    unit: str | None = None,
    labels: Collection[str] | None = None,
    exclude_self: bool = False,
    min_score: float | None = None,
    false_match_rate: float | None = None,
) -> Answer:
    """Who a scan is: the shapes of a catalogue nearest to it, and a verdict.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue that is searched.
    query : ScanLike or Signature
        The file of a scan, which is processed unless a shape has the same content; the id of a shape, as a
        str that is no path of a file; an array or geometry; or a signature that was made with these options.
    k : int, default 10
        Number of shapes, or all if the catalogue has fewer.
    options : OptionsLike, optional
        Signature, distance and whitening. By default the options of the catalogue.
    matrix : DistanceMatrix, optional
        Distances that replace the distances of signatures, for a query that the catalogue has.
    unit : str, optional
        Unit of a query that has none itself, if sizes are compared; by default that of the catalogue.
    labels : collection of str, optional
        The classes whose shapes are searched; by default all shapes.
    exclude_self : bool, default False
        Whether a query that is a shape of the catalogue is left out of its own results.
    min_score : float, optional
        Least score of a neighbour, between 0 and 1; without neighbours, the query is a stranger.
    false_match_rate : float, optional
        The query is a stranger too if a larger share of pairs of two classes is as near as its nearest shape.

    Returns
    -------
    Answer
        A verdict, and the neighbours, nearest first; equal distances by id. They have scores, the shares of
        pairs of one class among all pairs that are as near, unless there is a `matrix`, or the catalogue has
        neither labels nor enough shapes.

    Raises
    ------
    CatalogueError
        If the options require other spectra than the catalogue has.
    InputError
        If no shape is of these classes, `matrix` lacks the query, or only one of two sizes has a unit.
    ShapeError
        If the scan cannot be read or has no usable surface.
    """
    with Catalogue.opened(catalogue) as store:
        chosen = PipelineOptions.of(options, store.options)
        question = Question(
            chosen,
            k,
            labels,
            exclude_self,
            min_score,
            unit,
            matrix,
            false_match_rate=false_match_rate,
        )
        asked = (
            _query_of(store, query, question)
            if isinstance(query, (str, Path, Signature))
            else query
        )
        if not isinstance(asked, (str, Described)):
            asked = described_scan(question.scan_options(store), False, None, asked)
        return answer_to(store, asked, question)


def search_many(
    catalogue: CatalogueLike,
    queries: Iterable[str | Path | Signature],
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
    has_pictures: bool = False,
    up: str | None = None,
    false_match_rate: float | None = None,
) -> Iterator[tuple[str, Answer | ShapeError]]:
    """Answer several queries, in their order.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue that is searched.
    queries : iterable of str, Path or Signature
        Each as in `search`, or a folder, which stands for all scans in it, unless it has the id of a shape.
    k, options, matrix, unit, labels, exclude_self, min_score, false_match_rate : object
        As in `search`, for each query.
    timeout : float, optional
        Longest time in seconds for each scan, which is then processed in another process.
    memory : float, optional
        Largest heap of that process; GiB.
    has_pictures : bool, default False
        Whether `Answer.query` has a picture of a scan that is processed.
    up : {"x", "-x", "y", "-y", "z", "-z"}, optional
        The axis of the files that points upwards on it; by default found for each scan.

    Yields
    ------
    tuple of str and (Answer or ShapeError)
        The path or the id of a query, or the kind of a signature; and its answer, or the error of a scan that
        cannot be read or has no usable surface.

    Raises
    ------
    CatalogueError, InputError
        As by `search`, before the first answer.
    """
    check_many("queries", queries)
    with Catalogue.opened(catalogue) as store:
        chosen = PipelineOptions.of(options, store.options)
        how = (matrix, timeout, memory, has_pictures, up, false_match_rate)
        question = Question(chosen, k, labels, exclude_self, min_score, unit, *how)
        yield from _answers(store, queries, question)


def _answers(
    catalogue: Catalogue, queries: Iterable[str | Path | Signature], question: Question
) -> Iterator[tuple[str, Answer | ShapeError]]:
    asked = [each for query in queries for each in _expanded(catalogue, query, question)]
    scans = [query for _, query in asked if not isinstance(query, (str, Described))]
    of_scan = partial(
        described_scan,
        question.scan_options(catalogue),
        question.has_picture,
        question.up,
    )
    described: Iterator[tuple[ScanPath, Described | PcretrieveError]] = map(
        partial(_attempted, of_scan), scans
    )
    if scans and question.timeout is not None:
        # Imported here, because it is not needed for shapes that the catalogue has.
        from pcretrieve.ingestion.pool import in_processes

        timeout, memory = question.timeout, question.memory
        described = in_processes(
            of_scan, scans, workers=1, timeout=timeout, memory=memory
        )
    for name, query in asked:
        known = query if isinstance(query, (str, Described)) else next(described)[1]
        if isinstance(known, ShapeError):
            yield name, known
        elif isinstance(known, PcretrieveError):
            raise known
        else:
            yield name, answer_to(catalogue, known, question)


def answer_to(catalogue: Catalogue, query: str | Described, question: Question) -> Answer:
    """Answer one query that is known already. No file is read, whatever the query is called."""
    asked = catalogue.record(query) if isinstance(query, str) else query
    ranked = _ranked(catalogue, query, question)
    known = {record.id: record for record in catalogue.rows.several(ranked.ids)}
    # Without shapes that another process has removed meanwhile.
    ranked = _some(ranked, [row for row, name in enumerate(ranked.ids) if name in known])
    labelled = [
        (float(distance), label)
        for shape_id, distance in zip(ranked.ids, ranked.distances, strict=True)
        if shape_id != query and (label := known[shape_id].label) is not None
    ]
    is_given = question.matrix is not None
    made = None if is_given else index(catalogue, options=question.options)
    scores = None if made is None else made.scores
    found = _cut(catalogue, ranked, question)
    records = tuple(known[shape_id] for shape_id in found.ids)
    notes = tuple(_notes(catalogue, query, [*known.values()], scores, question))
    answer = Answer(found, records, scan=asked.grade, query=query, notes=notes)
    own = asked.label if isinstance(asked, Record) else None
    # Neighbours of its class spare the search for others in a large catalogue.
    is_near = any(label == own for _, label in labelled)
    if own is not None and not is_near and catalogue.rows.labelled([own]) == [query]:
        return replace(answer, because=f"it is the only scan of {own}")
    answer = _judged(answer, labelled, scores, question)
    if question.min_score is None or records:
        return answer
    because = f"no shape has a score of {question.min_score:g} or more"
    return replace(answer, verdict="stranger", because=because)


def _notes(
    catalogue: Catalogue,
    query: str | Described,
    near: Sequence[Record],
    scores: MatchScores | None,
    question: Question,
) -> Iterator[str]:
    """The notes of an answer; `near` are the nearest shapes."""
    rate, n_apart = question.false_match_rate, 0 if scores is None else scores.n_apart
    if rate is not None and rate * n_apart < 1:
        yield f"the {n_apart:,} pairs of two classes are too few for a false-match rate of {rate:g}"
    if isinstance(query, str):
        return
    areas = [record.area for record in near if record.area]
    if query.area and areas:
        unit = question.unit or catalogue.options.scan.unit
        if said := unit_note(math.sqrt(query.area / statistics.median(areas)), unit):
            yield f"its size is {said}"
    n_faces = [record.n_faces for record in near if record.n_faces]
    if query.n_faces and n_faces:
        ratio = query.n_faces / statistics.median(n_faces)
        if max(ratio, 1 / ratio) > FINER:
            yield f"it has {ratio:.2g} times the faces of the results: distances are less exact"


def _judged(
    answer: Answer,
    found: list[tuple[float, str]],
    scores: MatchScores | None,
    question: Question,
) -> Answer:
    """An answer with a verdict, by the distances and the classes of the neighbours of its query."""
    if not found:
        return replace(answer, because="no shape nearby has a class")
    nearest, label = min(found)
    others = [one for one in found if one[1] != label]
    # Without another class among the neighbours, the next one is at least as far as the last of them.
    distance, other = min(others) if others else (max(found)[0], None)
    beyond = (
        f"the next class is {other}, at {distance:.3g}"
        if other
        else "no other class is near"
    )
    because = f"the nearest class is {label}, at a distance of {nearest:.3g}; {beyond}; "
    answer = replace(answer, label=label, other=other)
    certainty = None if scores is None else scores.certainty(nearest, distance)
    if scores is None or certainty is None:
        return replace(answer, because=f"{because}how often that is right is not known")
    verdict: Verdict = "sure" if certainty >= SURE else "between"
    rate = question.false_match_rate
    if rate is not None and nearest > scores.limit(rate):
        verdict, because = (
            "stranger",
            f"{because}{rate:g} of pairs of two classes are nearer; ",
        )
    elif certainty < UNLIKELY:
        verdict = "stranger"
    because += f"such an answer is right in {certainty:.0%} of cases"
    return replace(answer, verdict=verdict, certainty=certainty, because=because)


def described_scan(
    options: PipelineOptions, has_picture: bool, up: str | None, scan: ScanLike
) -> Described:
    """Process a scan, and draw a thumbnail of it on request, in which the axis `up` points upwards."""
    from pcretrieve.pipeline.process import process, signature_of

    shape = process(scan, options)
    signature = signature_of(shape, options, scan)
    mesh = shape.surfaces[0].mesh
    drawn = mesh.thumbnail(up) if has_picture and mesh is not None else None
    picture = None if drawn is None else drawn.png
    n_faces = None if mesh is None else len(mesh.faces)
    return Described(signature, shape.grade, picture, n_faces, shape.surfaces[0].area)


def _attempted(
    of_scan: Callable[[ScanPath], Described], scan: ScanPath
) -> tuple[ScanPath, Described | PcretrieveError]:
    try:
        return scan, of_scan(scan)
    except ShapeError as error:
        return scan, error


def _expanded(
    catalogue: Catalogue, query: str | Path | Signature, question: Question
) -> Iterator[tuple[str, str | ScanPath | Described]]:
    """The queries of a folder, or the one query that is given: their names, and what they name."""
    scans: list[str | Path | ScanPath | Signature] = [query]
    is_folder = not isinstance(query, Signature) and Path(query).is_dir()
    if is_folder and (
        isinstance(query, Path) or not catalogue.rows.several([str(query)])
    ):
        from pcretrieve.ingestion.discover import discover

        limits = {"timeout": question.timeout, "memory": question.memory}
        scans = list(
            discover([str(query)], limits=None if question.timeout is None else limits)
        )
    for scan in scans:
        name = scan.kind if isinstance(scan, Signature) else str(scan)
        try:
            yield name, _query_of(catalogue, scan, question)
        except ScanReadError:
            from pcretrieve.formats import ScanPath

            yield name, ScanPath.parse(name)  # reading it as a scan will report why


def _query_of(
    catalogue: Catalogue, query: str | Path | ScanPath | Signature, question: Question
) -> str | ScanPath | Described:
    """The stored shape, the scan or the signature that a query is."""
    found = (
        Described(query)
        if isinstance(query, Signature)
        else _shape_or_scan(catalogue, query, question)
    )
    if question.matrix is not None and not isinstance(found, str):
        name = query.kind if isinstance(query, Signature) else query
        raise InputError(
            f"a distance matrix ranks shapes of {catalogue.location} only, which does not hold {name}: leave "
            "out the matrix, or ingest the scan and make the matrix again"
        )
    return found


def _shape_or_scan(
    catalogue: Catalogue, query: str | Path | ScanPath, question: Question
) -> str | ScanPath:
    # Readers are imported for files only, because they are not needed to look up an id.
    path = Path(str(query))
    is_no_file = isinstance(query, str) and not path.is_file()
    if is_no_file and (path.is_dir() or catalogue.rows.several([str(query)])):
        return _stored(catalogue, str(query))
    from pcretrieve.formats import ScanPath
    from pcretrieve.formats.identity import content_hash

    scan = ScanPath.parse(query)
    if isinstance(query, str) and not scan.file.exists():
        return _stored(catalogue, query)
    if question.matrix is None and question.unit not in (
        None,
        catalogue.options.scan.unit,
    ):
        return scan  # sizes in another unit: a shape of the same content does not stand for the file
    done = (
        record.id
        for record in catalogue.rows.with_content(content_hash(scan))
        if record.status == "done"
    )
    return next(done, scan)


def _stored(catalogue: Catalogue, shape_id: str) -> str:
    """An id, after a check that its shape has a signature."""
    if not catalogue.rows.several([shape_id]):
        raise InputError(
            f"a query must be the file of a scan or the id of a shape, {shape_id!r} is no file and no shape "
            f"of {catalogue.location}; `pcretrieve list` names the shapes{catalogue.rows.suggested(shape_id)}"
        )
    return catalogue[shape_id].id


def _ranked(
    catalogue: Catalogue, query: str | Described, question: Question
) -> Neighbors:
    """The first results, at least `LOOKED_AT`, without the query if it is to be left out."""
    among = None if question.labels is None else _labelled(catalogue, question.labels)
    # A query that is left out of its results is one of them before.
    most = max(question.k, LOOKED_AT) + question.exclude_self
    matrix = question.matrix
    if matrix is not None and isinstance(query, str):
        row = matrix.values[position_of(matrix.ids, query)]
        chosen = [
            number
            for number, name in enumerate(matrix.ids)
            if among is None or name in among
        ]
        found = nearest_of([matrix.ids[number] for number in chosen], row[chosen], most)
    else:
        compared = query if isinstance(query, str) else query.signature
        made = index(catalogue, options=question.options)
        found = made.ranked(
            compared, most, among=among, rerank=question.options.retrieval.rerank
        )
    left_out = query if question.exclude_self else None
    return _some(found, [row for row, name in enumerate(found.ids) if name != left_out])


def _labelled(catalogue: Catalogue, labels: Collection[str]) -> set[str]:
    check_many("labels", labels)
    for label in sorted(labels):
        if not catalogue.rows.labelled([label]):
            known = filter(None, catalogue.labels().values())
            raise InputError(
                f"no shape of {catalogue.location} is of the class {label}; `pcretrieve list` shows the "
                f"classes{did_you_mean(label, known)}"
            )
    return {*catalogue.rows.labelled(labels)}


def _cut(catalogue: Catalogue, found: Neighbors, question: Question) -> Neighbors:
    """The first results, as far as their scores are large enough."""
    found = replace(found, pictures=partial(thumbnails, catalogue.location))
    rows = range(min(question.k, len(found)))
    if question.min_score is None:
        return _some(found, rows)
    if found.scores is None:
        raise InputError(
            "a least score needs calibrated scores, which are estimated from distances of signatures, of "
            f"labelled shapes or of {LEAST_SHAPES} or more: label shapes, or leave out the least score"
        )
    return _some(found, [row for row in rows if found.scores[row] >= question.min_score])


def _some(found: Neighbors, rows: Sequence[int]) -> Neighbors:
    chosen = list(rows)
    scores = None if found.scores is None else found.scores[chosen]
    ids = tuple(found.ids[row] for row in chosen)
    return replace(found, ids=ids, distances=found.distances[chosen], scores=scores)
