"""Catalogue → the signatures of its shapes, and their index with its whitening and its scores.

An index of a million shapes takes 75 s and 2.3 GiB to compute, with the default options, and milliseconds to
open. That of a large catalogue is therefore stored, for one state of the catalogue.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcretrieve.catalogue import Catalogue, CatalogueLike, Record
from pcretrieve.catalogue.arrays import intact, packed_values, unpacked_values
from pcretrieve.catalogue.cache import short_digest
from pcretrieve.catalogue.records import OWN
from pcretrieve.draw.axes import tape_measures, upward
from pcretrieve.errors import CatalogueError, InputError, ShapeError
from pcretrieve.options import (
    OptionsLike,
    PipelineOptions,
    RetrievalOptions,
    options_difference,
)
from pcretrieve.retrieval import SignatureIndex, Whitening, people, table_whitening
from pcretrieve.retrieval.people import Reference
from pcretrieve.retrieval.scores import fit_scores
from pcretrieve.retrieval.whitening import read_whitening
from pcretrieve.values import (
    FloatArray,
    Signature,
    SignatureTable,
    SizeUnit,
)

logger = logging.getLogger(__name__)

# Version of the arrays of an index, which is incremented when their meaning changes, or retrieval/people.npz.
FORMAT = 24

# Smallest number of shapes for which an index is stored, or a map. The scores of 600 shapes, with the import
# of what fits them, would be two thirds of a query by id.
SMALLEST_KEPT = 100

# Beside the difference of two scans: its median over two standing poses of each of twelve simulated people,
# and what ISO 20685 allows a scanner; m, m³.
BESIDE = {
    "height": (0.009, 0.004),
    "chest": (0.002, 0.009),
    "waist": (0.002, 0.009),
    "hip": (0.002, 0.009),
    "thigh": (0.001, None),
    "volume": (None, None),
}

# Number of computed signatures that are stored together, so that few are lost after an interruption.
KEPT_AT_ONCE = 100


def signatures(
    catalogue: CatalogueLike, *, options: OptionsLike = None
) -> SignatureTable:
    """The signatures of all shapes of a catalogue that did not fail, with their classes.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The shapes. Signatures by other options than its own are computed from the stored spectra and
        surfaces, and stored in it.
    options : OptionsLike, optional
        The descriptor. By default the options of the catalogue.

    Returns
    -------
    SignatureTable
        One signature for each shape, in alphabetical order of ids.

    Raises
    ------
    CatalogueError
        If the options require other spectra than the catalogue has.
    InputError
        If sizes are compared, and the unit of some shapes alone is known.
    ShapeError
        If a part of a shape that the descriptor needs was not stored.
    """
    with Catalogue.opened(catalogue) as store:
        return _table(store, _fitting(store, options))[0]


def stored_signature(
    catalogue: CatalogueLike, shape_id: str, *, options: OptionsLike = None
) -> Signature:
    """The signature of one shape of a catalogue, computed from what is stored of it.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue.
    shape_id : str
        The id of the shape.
    options : OptionsLike, optional
        The descriptor. By default the options of the catalogue.

    Returns
    -------
    Signature
        With the error over the surfaces of the scan; comparable with those of the catalogue.

    Raises
    ------
    InputError
        If there is no shape of this id.
    ShapeError
        If a part of the shape that the descriptor needs was not stored.
    """
    from pcretrieve.descriptors import DESCRIPTORS, describe
    from pcretrieve.descriptors.describe import with_overlaps

    with Catalogue.opened(catalogue) as store:
        chosen = PipelineOptions.of(options, store.options)
        needs = DESCRIPTORS[chosen.signature.method].needs
        if "overlaps" not in needs or "overlaps" in store.options.catalogue.keep:
            shape = store.shape(shape_id, needs)
        else:
            shape = store.shape(shape_id, (*needs, "mesh"))
            shape = with_overlaps(shape, store.options.spectral.element)
    made = describe(shape, chosen.signature)
    return replace(made, digest=chosen.signature_digest)


def stored_measures(
    catalogue: CatalogueLike, shape_id: str
) -> dict[str, tuple[float, float]]:
    """Height, girths and volume of a person who stands with hanging arms, from the stored surfaces of a scan.

    A girth is that of a tape: the border of the convex hull of a horizontal section, without the arms. The
    hip is the largest one round the seat, the waist the smallest between hip and chest, the chest lies at
    .68 of the height; the thigh is the mean of both, .05 of the height below the crotch. Upwards is the axis
    that the catalogue knows, else the direction from the ground that was removed, else that of the body.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue.
    shape_id : str
        The id of the shape.

    Returns
    -------
    dict
        ``height chest waist hip thigh`` (m) and ``volume`` (m³), each with its ±: half of the difference
        between the two surfaces of the scan, and, but for the volume, what two standing poses of one person
        differ by, as the root of the sum of their squares. Empty if the unit of the scan is not known, its
        surfaces were not stored, or it shows another pose, for which the girths do not hold, or no person.

    Raises
    ------
    InputError
        If there is no shape of this id.
    """
    with Catalogue.opened(catalogue) as store:
        record = store.record(shape_id)
        unit = record.metres_per_unit
        if record.status == "failed" or unit is None:
            return {}
        surfaces = store.shape(shape_id, ("mesh",)).surfaces
        said = upward(store.rows.settings().get("up"))
        up = store.rows.direction_upwards(shape_id) if said is None else said
    meshes = [surface.mesh for surface in surfaces if surface.mesh is not None]
    found = [tape_measures(mesh.vertices, mesh.faces, up) for mesh in meshes]
    if not found or not all(found):
        return {}
    rows = {name: [unit * one[name] for one in found] for name in found[0]}
    rows["volume"] = [unit**3 * mesh.volume for mesh in meshes]
    return {
        name: (
            float(np.mean(row)),
            float(np.hypot(np.ptp(row) / 2, BESIDE[name][0] or 0)),
        )
        for name, row in rows.items()
    }


class TapeDifference(NamedTuple):
    """A measure of two scans with its ±, second minus first, and what this difference is beside.

    usual: the median difference of two scans of one person who stands; None where it was not measured.
    allowed: what ISO 20685 allows a scanner; None where it does not say it.
    """

    first: tuple[float, float]
    second: tuple[float, float]
    difference: float
    usual: float | None
    allowed: float | None


def compare_measures(
    catalogue: CatalogueLike, first: str, second: str
) -> dict[str, TapeDifference]:
    """The measures of two scans of people who stand with hanging arms, beside each other.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The catalogue.
    first : str
        The id of a shape.
    second : str
        The id of another shape.

    Returns
    -------
    dict
        By the names of `stored_measures` (m, m³); empty if one of them has none.

    Raises
    ------
    InputError
        If there is no shape of an id.
    """
    with Catalogue.opened(catalogue) as store:
        one, other = (stored_measures(store, name) for name in (first, second))
    return {
        name: TapeDifference(own, other[name], other[name][0] - own[0], *BESIDE[name])
        for name, own in one.items()
        if other
    }


def index(catalogue: CatalogueLike, *, options: OptionsLike = None) -> SignatureIndex:
    """The index of the signatures of a catalogue, with its whitening and its scores.

    The index of 100 shapes or more is stored in the cache folder of the user, and opened from there until
    shapes or labels change.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The shapes. The whitenings ``neighbours``, ``pca`` and ``within-class`` are fitted to them.
    options : OptionsLike, optional
        Signature, distance and whitening, such as ``{"retrieval": {"whitening": "pca"}}``. By default the
        options of the catalogue.

    Returns
    -------
    SignatureIndex
        Its attribute `whitening` maps log-signatures to the places that are compared.

    Raises
    ------
    CatalogueError, ShapeError
        As by `signatures`.
    InputError
        If the catalogue has no shapes, or too few for the whitening; and as by `signatures`.
    """
    with Catalogue.opened(catalogue) as store:
        chosen, cache = _fitting(store, options), store.cache
        name = _index_name(chosen, store.revision())
        if cache.last is None or cache.last[0] != name:
            found = cache.opened(name, SignatureIndex.from_arrays)
            if found is None:
                table, revision = _table(store, chosen)
                found, name = _made_index(table, chosen), _index_name(chosen, revision)
                if len(found) >= SMALLEST_KEPT:
                    cache.keep(name, found.to_arrays())
                    # The stored index replaces the one in memory, which is then freed.
                    found = cache.opened(name, SignatureIndex.from_arrays) or found
            cache.last = name, found
        made: SignatureIndex = cache.last[1]
        return made


# --- inside -------------------------------------------------------------------------------------------------


def _fitting(catalogue: Catalogue, options: OptionsLike) -> PipelineOptions:
    """The options of a request, after a check that they need no other spectra than the stored ones."""
    chosen = PipelineOptions.of(options, catalogue.options)
    if chosen.digest != catalogue.options.digest:
        difference = "; ".join(options_difference(catalogue.options, chosen))
        raise CatalogueError(
            f"{catalogue.location} was built with other options: {difference}. Only the options in "
            "[signature] and [retrieval] can be changed: start from Catalogue.options"
        )
    return chosen


def _table(catalogue: Catalogue, options: PipelineOptions) -> tuple[SignatureTable, str]:
    """The signatures by some options, and a name of the state of the catalogue that they belong to."""
    from pcretrieve.descriptors import DESCRIPTORS, signature_length

    descriptor = DESCRIPTORS[options.signature.method]
    unit = _unit_of_sizes(catalogue, options)
    is_own = options.signature_digest == catalogue.options.signature_digest
    digest = OWN if is_own else _signatures_digest(options)
    n_values = signature_length(options.signature)
    with intact(catalogue.location, "a signature"):
        revision, ids, labels, has, packed = catalogue.rows.listed(digest)
        values = stored = unpacked_values(packed, int(has.sum()), n_values)
    if len(stored) < len(ids):
        values = np.empty((len(ids), n_values))
        values[has] = stored
        missing = np.flatnonzero(~has)
        made = _described(catalogue, digest, options, [ids[row] for row in missing])
        for row, values_now in zip(missing, made, strict=True):
            values[row] = values_now
    made_by = descriptor.name, options.signature_digest
    table = SignatureTable(
        tuple(ids), values, *made_by, tuple(labels), descriptor.metric, unit
    )
    return table, revision


def _described(
    catalogue: Catalogue, digest: str, options: PipelineOptions, ids: Sequence[str]
) -> list[FloatArray]:
    """Compute the signatures (L,) of some shapes, and store them if the catalogue can be written to."""
    made: list[FloatArray] = []
    for start in range(0, len(ids), KEPT_AT_ONCE):
        unkept: list[tuple[Record, bytes]] = []
        try:
            for shape_id in ids[start : start + KEPT_AT_ONCE]:
                # Before the shape, so that no signature of an earlier shape is kept for a later one.
                record = catalogue.record(shape_id)
                try:
                    signature = stored_signature(catalogue, shape_id, options=options)
                except ShapeError as error:
                    error.shape_id = shape_id
                    raise
                made.append(signature.values)
                unkept.append((record, packed_values(made[-1])))
        finally:
            if unkept and catalogue.rows.database.is_writable:
                catalogue.rows.keep(digest, unkept)
        if len(unkept) == KEPT_AT_ONCE:
            logger.info(
                "%s: %d of %d shapes", options.signature.method, len(made), len(ids)
            )
    return made


def _unit_of_sizes(catalogue: Catalogue, options: PipelineOptions) -> SizeUnit | None:
    """The one unit of the sizes in all signatures; None if they do not depend on sizes."""
    if not options.signature.compares_sizes:
        return None
    units = catalogue.rows.units()
    if None in units and len(units) > 1:
        raise InputError(
            f"sizes must be in one unit to be compared: in {catalogue.location} some shapes are in metres, "
            "the unit of others is unknown; ingest all into a new catalogue with --unit (scan.unit), the "
            "unit of the files that have none, or compare the form alone (size_weight = 0, and the scale "
            "area)"
        )
    return "unknown" if None in units else "m"


def _made_index(table: SignatureTable, options: PipelineOptions) -> SignatureIndex:
    """Fit the whitening and the scores of signatures."""
    retrieval, known = options.retrieval, people(options.signature)
    whitening = calibrated(options) or table_whitening(table, retrieval, people=known)
    reference = reference_of(options, whitening)
    scores = fit_scores(table, whitening, retrieval, reference=reference)
    return SignatureIndex(table, retrieval, whitening=whitening, scores=scores)


def reference_of(options: PipelineOptions, whitening: Whitening) -> Reference | None:
    """What distances after a whitening mean, by people who are in no collection; None if it is unknown."""
    is_usual = options.retrieval.distance == RetrievalOptions().distance
    known = people(options.signature) if whitening.kind == "people" and is_usual else None
    return None if known is None else known.reference


def _index_name(options: PipelineOptions, revision: str) -> str:
    """A name of everything that an index depends on; that of the shapes is after the hyphen."""
    retrieval = options.retrieval
    fitted = calibrated(options)
    learnt = "" if fitted is None else hashlib.sha256(fitted.matrix.tobytes()).hexdigest()
    compared = (
        f"{retrieval.distance} {retrieval.whitening} {retrieval.shrinkage} {learnt}"
    )
    made = short_digest(f"{FORMAT} {_signatures_digest(options)} {compared}")
    return f"{made}-{short_digest(revision)}"


def _signatures_digest(options: PipelineOptions) -> str:
    """The digest of the signatures that are compared by some options."""
    if not options.signature.of_other_packages:
        return options.signature_digest
    from pcretrieve.descriptors import DESCRIPTORS

    # With the version of the package of the descriptor, because other versions may give other values.
    return options.signature_digest + DESCRIPTORS.version(options.signature.method)


def calibrated(options: PipelineOptions) -> Whitening | None:
    """The whitening of a file, which is not fitted to the shapes of the catalogue."""
    if options.retrieval.calibration is None:
        return None
    whitening = read_whitening(Path(options.retrieval.calibration))
    whitening.check_made_for(options.signature_digest)
    return whitening
