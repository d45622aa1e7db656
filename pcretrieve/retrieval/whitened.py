"""The contents of an index: whitened coordinates of many shapes, in the order of their ids."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcretrieve.errors import InputError
from pcretrieve.retrieval.covariances import CHUNK
from pcretrieve.retrieval.distances import coordinates
from pcretrieve.retrieval.filtering import Filter
from pcretrieve.retrieval.names import Names
from pcretrieve.retrieval.ranking import position_of
from pcretrieve.retrieval.scores import MatchScores
from pcretrieve.retrieval.units import check_unit
from pcretrieve.retrieval.whitening import Whitening
from pcretrieve.values import FloatArray, Metric, Signature, SignatureTable, SizeUnit

__all__ = ["MadeBy", "WhitenedTable"]

# Prefixes of the names of the arrays of the whitening and of the scores, among all arrays.
WHITENING = "whitening_"
SCORES = "scores_"


class MadeBy(NamedTuple):
    """How the signatures of a table were made."""

    kind: str
    digest: str
    metric: Metric
    unit: SizeUnit | None

    def check(self, other: Signature | SignatureTable) -> None:
        """Check that other signatures are comparable with those of the table."""
        if (other.kind, other.digest) != (self.kind, self.digest):
            raise InputError(
                f"signatures must be made by the same method and options as the table, "
                f"{self.kind!r} {self.digest!r}, got {other.kind!r} {other.digest!r}"
            )
        check_unit(other.unit, self.unit)


@dataclass(frozen=True, slots=True, eq=False)
class WhitenedTable:
    """Whitened coordinates of shapes, and the filter of their neighbours."""

    made_by: MadeBy
    ids: Names
    whitening: Whitening
    filter: Filter
    scores: MatchScores | None = None

    @classmethod
    def of(
        cls,
        made_by: MadeBy,
        ids: Names,
        points: FloatArray,
        distance: str,
        whitening: Whitening,
        nearest: str = "auto",
    ) -> WhitenedTable:
        """Whiten coordinates in place, and bound their distances.

        points: (N, L) float64, coordinates of the signatures, which are overwritten.
        """
        whitening.check_made_for(made_by.digest)
        for start in range(0, len(ids), CHUNK):
            chunk = slice(start, start + CHUNK)
            points[chunk] = whitening.apply(points[chunk])
        return cls(made_by, ids, whitening, Filter.of(distance, points, nearest=nearest))

    def point_of(self, query: str | Signature | ArrayLike) -> FloatArray:
        """The whitened coordinates of a query, after checks that it is comparable with the table.

        query: str, Signature or (L,) array_like, the id of a shape of the table, or a signature.
        Returns (1, L) float64: the coordinates.
        """
        if isinstance(query, str):
            place = position_of(self.ids, query)
            held: FloatArray = self.filter.points[place : place + 1]
            return held
        if isinstance(query, Signature):
            self.made_by.check(query)
            query = query.values
        point = coordinates(query, self.made_by.metric)
        row = self.filter.points.shape[1:]
        if point.shape != row:
            raise InputError(f"the query must have shape {row}, as the table's rows have, got {point.shape}")
        return self.whitening.apply(point[np.newaxis])

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """The contents as arrays by name, none of which holds objects: the input of `from_arrays`."""
        arrays = self.filter.to_arrays()
        arrays |= {f"{WHITENING}{name}": array for name, array in self.whitening.to_arrays().items()}
        if self.scores is not None:
            arrays |= {f"{SCORES}{name}": array for name, array in self.scores.to_arrays().items()}
        arrays |= {"id_text": self.ids.text, "id_ends": self.ids.ends}
        return arrays | {name: np.array(text or "") for name, text in self.made_by._asdict().items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> WhitenedTable:
        """The table that `to_arrays` has written as arrays."""
        fitted, scored = (
            {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
            for prefix in (WHITENING, SCORES)
        )
        try:
            kind, digest, metric, unit = (str(arrays[name]) for name in MadeBy._fields)
            made_by = MadeBy(kind, digest, cast("Metric", metric), cast("SizeUnit", unit) or None)
            ids = Names(arrays["id_text"], arrays["id_ends"])
            scores = MatchScores.from_arrays(scored) if scored else None
            table = cls(made_by, ids, Whitening.from_arrays(fitted), Filter.from_arrays(arrays), scores)
        except KeyError as error:
            raise InputError(f"the arrays of an index must include {error.args[0]!r}") from error
        if len(ids) != len(table.filter.points):
            raise InputError("the arrays of an index must be of one table, got several; build it again")
        return table
