"""The record that declares a pairwise matcher, and the table of matchers.

Another package adds a matcher by an entry point of the group ``pcretrieve.matchers`` that names a record
`Matcher`; the name of the entry point is then a value of the option `--matcher`. The names of pcretrieve's
own matchers are reserved.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, get_args

from pcretrieve.errors import OptionError
from pcretrieve.matching.heat import heat_distance, heat_set
from pcretrieve.names import NAMES
from pcretrieve.plugins import Registry, named
from pcretrieve.types import Need, Shape

__all__ = ["MATCHERS", "Matcher"]


@dataclass(frozen=True, slots=True)
class Matcher:
    """The declaration of a method that compares two shapes and has no vector for a single one.

    Attributes
    ----------
    name : str
        Value of the option `--matcher`.
    prepare : function of Shape
        Called once for each shape, with a shape that holds the parts in `needs`; returns the features of the
        shape, of any type that can be pickled.
    distance : function of (features, features) that returns float
        The distance from a query to a shape of the gallery: not NaN, not negative, may be infinite.
    needs : tuple of {"spectrum", "overlaps", "mesh", "points"}
        The parts of a shape that `prepare` uses, as in `pcretrieve.descriptors.Descriptor`: `Shape.spectrum`,
        its overlaps, `Shape.mesh`, or `Shape.points`, which the catalogue does not store.
    symmetric : bool, default True
        Whether the distance from a to b is that from b to a, so that half of the distances need computing.

    Raises
    ------
    OptionError
        If there is no such need.
    """

    name: str
    prepare: Callable[[Shape], Any]
    distance: Callable[[Any, Any], float]
    needs: tuple[Need, ...]
    symmetric: bool = True

    def __post_init__(self) -> None:
        known = [need for need in get_args(Need) if need != "eigenvectors"]
        if wrong := sorted(set(self.needs).difference(known)):
            raise OptionError(f"needs of a matcher must be of {', '.join(known)}, got {wrong[0]!r}")


HEAT_HAUSDORFF = Matcher("heat-hausdorff", heat_set, heat_distance, needs=("mesh",))


MATCHERS: Registry[Matcher] = Registry(
    NAMES["matcher"], {HEAT_HAUSDORFF.name: HEAT_HAUSDORFF}, named(Matcher)
)
