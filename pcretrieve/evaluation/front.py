"""Catalogue → measures, comparisons, distances, whitenings: `evaluate`, `compare`, `matrix`, `calibrate`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from numpy.typing import ArrayLike

from pcretrieve.catalogue import Catalogue, CatalogueLike
from pcretrieve.errors import InputError
from pcretrieve.evaluation import measures
from pcretrieve.evaluation.comparison import (
    Comparison,
    compare_scores,
    result_scores,
    write_evaluation,
)
from pcretrieve.evaluation.rankings import RankedShapes, rank_shapes
from pcretrieve.gallery.fitted import index, signatures
from pcretrieve.options import OptionsLike, PipelineOptions, describe_options
from pcretrieve.retrieval import DistanceMatrix, Whitening, people
from pcretrieve.retrieval.whitening import calibrated_whitening, write_whitening
from pcretrieve.values import FloatArray, SignatureTable
from pcretrieve.values.files import csv_text, write_file

if TYPE_CHECKING:
    from pcretrieve.shrec.matcher import Matcher


@dataclass(frozen=True, eq=False)
class Evaluation(measures.RetrievalMeasures):
    """Means of the measures over all queries, and what else is known of the same rankings."""

    ranked: RankedShapes = field(repr=False)
    level: ClassVar[float] = measures.LEVEL

    @property
    def macro(self) -> measures.RetrievalMeasures:
        """Means over the classes, in which small classes count as much as large ones."""
        return measures.evaluate_rankings(self.ranked.rankings, average="macro")

    @property
    def plain(self) -> measures.RetrievalMeasures:
        """Means over the queries without re-ranking."""
        return measures.evaluate_rankings(self.ranked.plain)

    @property
    def interval(self) -> FloatArray:
        """(2, 6) float64, lower and upper ends of the confidence intervals (`level`) of the measures."""
        return measures.bootstrap_interval(self.scores.columns)

    @property
    def classes(self) -> tuple[measures.ClassMeasures, ...]:
        """The measures of each class, and the classes that it is mistaken for."""
        return measures.class_measures(self.ranked.rankings)

    @property
    def scores(self) -> measures.QueryScores:
        """The measures of each query."""
        return measures.query_scores(self.ranked.rankings)

    @property
    def confusion(self) -> measures.Confusion:
        """How often the nearest shape of a class is of each class."""
        return measures.confusion(self.ranked.rankings)

    @property
    def precision_recall(self) -> measures.PrecisionRecall:
        """The mean precision at each recall."""
        return measures.precision_recall(self.ranked.rankings)

    @property
    def verification(self) -> measures.Verification | None:
        """The error rates of pairs of shapes (DET, ROC); None if there are no pairs of two classes."""
        return measures.verification(
            self.ranked.plain.genuine, self.ranked.plain.impostor
        )

    @cached_property
    def curve(self) -> tuple[measures.CurvePoint, ...]:
        """How often the right class is found, by the number of classes: ranks 1 and 5 of the CMC.

        With re-ranking and a whitening by folds it is too high: there, a gallery is a fold.
        """
        ranked = self.ranked.rankings
        return measures.recognition_curve(
            ranked.n_nearer, ranked.labels, ranked.n_classes
        )

    def draw_curve(self, path: str | Path) -> None:
        """Write a picture of `curve`, with its intervals."""
        from pcretrieve.draw.plot import draw_recognition

        picture = draw_recognition(self.curve, Path(path).suffix.removeprefix("."))
        write_file(Path(path), picture)

    def write(self, folder: str | Path) -> tuple[Path, ...]:
        """Write the measures of queries and classes, confusions, precision-recall and DET as CSV files."""
        return write_evaluation(self.ranked.rankings, folder, self.curve)


def evaluate(
    shapes: CatalogueLike | SignatureTable | DistanceMatrix | ArrayLike,
    labels: str | Path | Iterable[object] | None = None,
    *,
    options: OptionsLike = None,
    matrix: DistanceMatrix | None = None,
    good_only: bool = False,
) -> Evaluation:
    """Retrieval measures of labelled shapes, each of which is a query in all other shapes.

    Parameters
    ----------
    shapes : Catalogue, str, Path, SignatureTable, DistanceMatrix or (N, N) array
        A catalogue, whose failed shapes count as misses; a table of signatures with labels; or distances,
        with the distances from one query to all shapes in each row.
    labels : str, Path or sequence of length N, optional
        A label file or the name of a layout, whose classes replace those of the catalogue or of the matrix;
        or the class of each row of distances, None if it is unknown.
    options : OptionsLike, optional
        Signature, distance and whitening. By default the options of the catalogue.
    matrix : DistanceMatrix, optional
        Distances that replace the distances of signatures.
    good_only : bool, default False
        Ask for scans that are good only. Poor and incomplete ones stay in the gallery.

    Returns
    -------
    Evaluation
        Nearest neighbour (NN), first and second tier (FT, ST), E-measure (E), discounted cumulative gain
        (DCG) and mean average precision (mAP), each between 0 and 1; means over the classes, confidence
        intervals, and the measures of each class.

    Raises
    ------
    BenchmarkError
        If no shape has a class, or no class two shapes.
    CatalogueError
        If the options require other spectra than the catalogue has.
    InputError
        If distances are not square, or labels are not as many as rows.
    """
    ranked = rank_shapes(shapes, options, labels, matrix=matrix, good_only=good_only)
    return Evaluation(
        **asdict(measures.evaluate_rankings(ranked.rankings)), ranked=ranked
    )


class Evaluations(dict[str, Evaluation]):
    """Evaluations by the name of the method; in a notebook one table, with a row for each."""

    def _repr_html_(self) -> str:
        return measures.table_html(self)

    def write(self, folder: str | Path) -> None:
        """Write the table as ``methods.csv``, and the files of each evaluation to a folder of its name."""
        rows = []
        for name, one in self.items():
            one.write(Path(folder) / name)
            rows.append([name, *(getattr(one, column) for column in measures.MEASURES)])
        text = csv_text(["method", *measures.MEASURES], rows)
        write_file(Path(folder) / "methods.csv", text.encode())


def evaluate_methods(
    catalogue: CatalogueLike,
    methods: Iterable[str],
    labels: str | Path | None = None,
    *,
    options: OptionsLike = None,
    good_only: bool = False,
) -> Evaluations:
    """Evaluate several descriptors of one catalogue.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        Labelled shapes with the spectra that the methods need.
    methods : iterable of str
        Names of descriptors, such as ``hapt`` and ``r-bihdm``.
    labels : str or Path, optional
        As of `evaluate`.
    options : OptionsLike, optional
        As of `evaluate`; each method replaces theirs.
    good_only : bool, default False
        As of `evaluate`.

    Returns
    -------
    Evaluations
        A dict with the `Evaluation` of each method, which a notebook shows as one table.

    Raises
    ------
    BenchmarkError, CatalogueError
        As by `evaluate`.
    OptionError
        If there is no such method.
    """
    with Catalogue.opened(catalogue) as store:
        base = PipelineOptions.of(options, store.options)
        return Evaluations(
            {
                name: evaluate(
                    store,
                    labels,
                    options=base.changed(signature={"method": name}),
                    good_only=good_only,
                )
                for name in methods
            }
        )


def compare(
    first: CatalogueLike | DistanceMatrix | Evaluation,
    second: CatalogueLike | DistanceMatrix | Evaluation,
    *,
    options: OptionsLike = None,
    second_options: OptionsLike = None,
    labels: str | Path | None = None,
) -> Comparison:
    """Compare two results for the same labelled shapes, query by query.

    Parameters
    ----------
    first : Catalogue, str, Path, DistanceMatrix or Evaluation
        A catalogue; a distance matrix, or its file; an evaluation, or its file ``queries.csv``.
    second : Catalogue, str, Path, DistanceMatrix or Evaluation
        The other result, which may be the same catalogue.
    options : OptionsLike, optional
        Signature, distance, whitening and re-ranking. By default the options of each catalogue.
    second_options : OptionsLike, optional
        Those of the second catalogue, if they differ.
    labels : str or Path, optional
        A label file, whose classes replace those of the catalogues, and which distance matrices need.

    Returns
    -------
    Comparison
        The differences of the measures, second minus first, with paired confidence intervals, and the shapes
        by how much their average precision changes.

    Raises
    ------
    BenchmarkError
        If no shape has a class, or no class two shapes.
    CatalogueError
        If a catalogue does not exist, or the options require other spectra than it has.
    InputError
        If a file cannot be read, or the results have no query in common.
    """
    others = options if second_options is None else second_options
    one, two = (
        result.scores
        if isinstance(result, Evaluation)
        else result_scores(result, chosen, labels)
        for result, chosen in ((first, options), (second, others))
    )
    return compare_scores(one, two)


def calibrate(
    catalogue: CatalogueLike, path: str | Path, *, options: OptionsLike = None
) -> Whitening | PipelineOptions:
    """Learn from labelled scans what to ignore, or which features tell them apart, for other catalogues.

    With scans of people, the metric of people is adapted to the sensor and to the poses of these scans. By
    the method ``dl-supervised``, the atoms that describe a surface are learned: those of simulated bodies are
    changed, so that the shapes of one class are nearer to each other than to those of other classes (the loss
    of triplets of Litman et al., "Supervised learning of bag-of-features shape descriptors", 2014).

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        Labelled shapes, such as three people in ten poses; for atoms, with meshes.
    path : str or Path
        The file of the whitening. ``{"retrieval": {"calibration": path}}`` are the options of a search in
        another catalogue that uses it. The file of atoms is itself the options, ``options=path``.
    options : OptionsLike, optional
        Signature and shrinkage. By default the options of the catalogue. For the method ``dl-supervised``
        that has `atoms` already, a whitening is learned.

    Returns
    -------
    Whitening or PipelineOptions
        What was learnt, which is in the file: a whitening, whose `reason` says from how many shapes; or the
        options with the atoms.

    Raises
    ------
    CatalogueError
        If the options require other spectra than the catalogue has.
    InputError
        If no class has two distinct shapes, for atoms not two classes, or the file cannot be written.
    ShapeError
        If the mesh of a shape, which atoms need, was not stored.
    """
    with Catalogue.opened(catalogue) as store:
        chosen = PipelineOptions.of(options, store.options)
        if chosen.signature.method == "dl-supervised" and chosen.signature.atoms is None:
            from pcretrieve.shrec.dl import learned_atoms

            labels = {
                one.id: one.label
                for one in store.records(status="done")
                if one.label is not None
            }
            atoms = learned_atoms(
                map(store.mesh, labels), [*labels.values()], chosen.signature.n_modes
            )
            learned = chosen.changed(signature={"atoms": atoms.round(6).tolist()})
            write_file(Path(path), describe_options(learned, "signature").encode())
            return learned
        labelled = chosen.changed(
            retrieval={"whitening": "within-class", "calibration": None}
        )
        known = people(labelled.signature)
        fitted = calibrated_whitening(
            signatures(store, options=labelled), labelled.retrieval, known
        )
    write_whitening(fitted, Path(path))
    return fitted


def matrix(
    catalogue: CatalogueLike,
    *,
    options: OptionsLike = None,
    matcher: str | Matcher | None = None,
) -> DistanceMatrix:
    """All distances between the shapes of a catalogue that did not fail.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The shapes. Shapes to which the matcher cannot be applied are left out, with a warning in the log.
    options : OptionsLike, optional
        Signature, distance and whitening. By default the options of the catalogue.
    matcher : str or Matcher, optional
        A method, one's own or by a name such as ``heat-hausdorff``, which compares pairs of shapes without
        signatures.

    Returns
    -------
    DistanceMatrix
        Row i has the distances from shape i, as a query, to all shapes.

    Raises
    ------
    CatalogueError
        If the options require other spectra than the catalogue has.
    InputError
        If the catalogue has no shapes.
    OptionError
        If there is no such matcher.
    """
    with Catalogue.opened(catalogue) as store:
        if not len(store):
            raise InputError(f"{store.location} holds no shapes: ingest some first")
        if matcher is None:
            known = index(store, options=options)
            made = DistanceMatrix(tuple(known.ids), known.between(known.ids))
        else:
            from pcretrieve.shrec.matcher import known_matcher, match_all

            method = known_matcher(matcher)
            made = DistanceMatrix(
                *match_all(method, [*store], lambda name: store.shape(name, method.needs))
            )
        return replace(made, labels=tuple(map(store.labels().get, made.ids)))
