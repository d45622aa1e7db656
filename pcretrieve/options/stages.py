"""The chain of stages: what each stage takes and gives, and the options that name the stages in order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import ConfigDict, field_validator, model_validator

from pcretrieve.errors import OptionError
from pcretrieve.names import NAMES
from pcretrieve.options.filters import PointFilter, SurfaceFilter, Value
from pcretrieve.options.model import Options
from pcretrieve.options.scan import ScanOptions
from pcretrieve.options.signature import SpectralOptions
from pcretrieve.options.surface import RemeshOptions, SurfaceOptions
from pcretrieve.plugins import Registry, named

__all__ = ["DEFAULT_STAGES", "OWN_STAGES", "Link", "StageOptions", "check_chain", "link_of", "with_method"]

#: The stages of the default chain, by name.
DEFAULT_STAGES = ("crop", "clean", "orient", "surface", "remesh", "spectrum")


@dataclass(frozen=True, slots=True)
class Link:
    """The declaration of a stage: its input, its output and its options.

    Attributes
    ----------
    takes, gives : str
        The values before and after the stage.
    options : type
        Class of its options.
    table : str
        Name of the table of its options; empty for ``pipeline.NAME``, with the name of the stage.
    """

    takes: Value
    gives: Value
    options: type[Options]
    table: str = ""


#: The stages of pcretrieve: those of the default chain, and filters with a table ``pipeline.NAME``. Tests
#: hold them and the records of the filters against each other.
OWN_STAGES: Mapping[str, Link] = {
    "crop": Link("points", "points", ScanOptions, "scan"),
    "clean": Link("points", "points", ScanOptions, "scan"),
    "orient": Link("points", "normals", ScanOptions, "scan"),
    "surface": Link("normals", "surface", SurfaceOptions, "surface"),
    "remesh": Link("surface", "surface", RemeshOptions, "remesh"),
    "spectrum": Link("surface", "spectrum", SpectralOptions, "spectral"),
}

# The stages that other packages add.
_POINT_FILTERS = Registry[PointFilter](NAMES["point filter"], {}, named(PointFilter))
_SURFACE_FILTERS = Registry[SurfaceFilter](NAMES["surface filter"], {}, named(SurfaceFilter))

# How messages about the chain begin.
PLACE = "in [pipeline], stages: "

# Words for values in messages, and what to do if a stage takes another value than there is before it.
NOUNS: Mapping[Value, str] = {
    "points": "points",
    "normals": "points with normals",
    "surface": "a surface",
    "spectrum": "a spectrum",
}
BEFORE_SURFACE = "put it before 'surface'"
ADVICE: Mapping[tuple[Value, Value], str] = {
    ("normals", "points"): "put 'orient' before it",
    ("surface", "points"): "put 'orient' and 'surface' before it",
    ("surface", "normals"): "put 'surface', or the name of a surface method, before it",
    ("points", "surface"): BEFORE_SURFACE,
    ("normals", "surface"): BEFORE_SURFACE,
}


def link_of(stage: str) -> Link:
    """What a stage takes and gives, and the class of its options; a package that adds the stage is imported.

    Parameters
    ----------
    stage : str
        A name in `pipeline.stages`.

    Returns
    -------
    Link
        The declaration of the stage.

    Raises
    ------
    OptionError
        If there is no such stage, or its package cannot be imported.
    """
    if stage in OWN_STAGES:
        return OWN_STAGES[stage]
    if stage in NAMES["surface method"].all():
        return OWN_STAGES["surface"]
    filters = _SURFACE_FILTERS if stage in NAMES["surface filter"].all() else _POINT_FILTERS
    record: PointFilter | SurfaceFilter = filters[stage]
    return Link(record.takes, record.gives, record.options)


def check_chain(stages: Sequence[str], *, of_points: bool) -> None:
    """Check that each stage takes what the stages before it give, and that the last gives a spectrum.

    Parameters
    ----------
    stages : sequence of str
        Names of stages.
    of_points : bool
        Whether the spectrum is that of points with normals, for which no surface is made: the stages
        ``surface`` and ``remesh``, which are in the default chain, are then not used.

    Raises
    ------
    OptionError
        If the stages do not lead from points to a spectrum.
    """
    given: Value = "points"
    for stage in stages:
        link = link_of(stage)
        takes = link.takes
        if of_points and stage in ("surface", "remesh"):
            continue
        if of_points and takes == "surface":
            if stage != "spectrum":
                raise OptionError(
                    f"{PLACE}{stage!r} takes a surface, and the element of the spectrum is of points, for "
                    "which no surface is made: leave the stage out, or choose another spectral.element"
                )
            takes = "normals"
        if given == "spectrum":
            raise OptionError(f"{PLACE}'spectrum' must be the last, got {stage!r} after it: put it before")
        if takes != given and (takes, given) != ("points", "normals"):
            raise OptionError(
                f"{PLACE}{stage!r} takes {NOUNS[takes]}, but the stages before it give {NOUNS[given]}: "
                f"{ADVICE[takes, given]}"
            )
        # Filters of points keep normals.
        given = given if (given, link.gives) == ("normals", "points") else link.gives
    if given != "spectrum":
        raise OptionError(
            f"{PLACE}'spectrum' must be the last, got {', '.join(stages) or 'no stage'}: add it"
        )


def with_method(tables: Mapping[str, Any]) -> dict[str, Any]:
    """Replace the name of a surface method in the chain by ``surface`` and the option `surface.method`.

    Parameters
    ----------
    tables : mapping of str to a mapping or to options
        Options by table, before they are validated.

    Returns
    -------
    dict
        The tables, with the method that the chain has named as the option `surface.method`.

    Raises
    ------
    OptionError
        If `surface.method` is another method.
    """
    changed = dict(tables)
    chain, surface = tables.get("pipeline"), tables.get("surface", {})
    stages = _named(chain, "stages")
    if not isinstance(stages, (list, tuple)):
        return changed
    # The entry points of other packages are not read for the stages of pcretrieve.
    others = [stage for stage in stages if isinstance(stage, str) and stage not in OWN_STAGES]
    for method in [stage for stage in others if stage in NAMES["surface method"].all()]:
        other = _named(surface, "method")
        if other not in (None, method):
            raise OptionError(
                f"{PLACE}{method!r} stands for surface.method = {method!r}, got "
                f"surface.method = {other!r} too: name the method in one place"
            )
        surface = _replaced(surface, method=method)
        stages = tuple("surface" if stage == method else stage for stage in stages)
        changed |= {"pipeline": _replaced(chain, stages=stages), "surface": surface}
    return changed


def _named(table: Any, option: str) -> Any:
    """The value of an option that a table names, or None."""
    if isinstance(table, Options):
        return getattr(table, option) if option in table.model_fields_set else None
    return table.get(option) if isinstance(table, Mapping) else None


def _replaced(table: Any, **values: Any) -> Any:
    """A table of options with some values replaced. Values that are not tables are refused later."""
    if isinstance(table, Options):
        return table.model_copy(update=values)
    return {**table, **values} if isinstance(table, Mapping) else table


class StageOptions(Options):
    """The stages from a scan to its spectrum. A table [pipeline.NAME] has the options of a filter."""

    model_config = ConfigDict(extra="allow")

    stages: tuple[str, ...] = DEFAULT_STAGES
    """Names of stages, in order. crop, clean and orient (options in [scan]), and filters of points that other
    packages add; surface ([surface]), or in its place the value of surface.method; remesh ([remesh]), and
    filters of surfaces that other packages add; spectrum ([spectral]), the last. A mesh that is used without
    reconstruction passes through the added filters of surfaces only."""

    @field_validator("stages")
    @classmethod
    def _are_known(cls, stages: tuple[str, ...]) -> tuple[str, ...]:
        for stage in stages:
            if stages.count(stage) > 1:
                raise ValueError(f"input should name each stage once, got {stage!r} again: leave it out")
        for stage in [stage for stage in stages if stage not in OWN_STAGES]:
            kinds = {kind: NAMES[kind].all() for kind in ("point filter", "surface filter", "surface method")}
            meanings = [kind for kind, names in kinds.items() if stage in names]
            if not meanings:
                known = dict.fromkeys([*OWN_STAGES, *(name for names in kinds.values() for name in names)])
                raise ValueError(f"input should be names of {', '.join(known)}, got {stage!r}")
            if len(meanings) > 1:
                raise ValueError(
                    f"input should name one stage by each name, got {stage!r}, a {' and a '.join(meanings)}: "
                    "uninstall the package of one of them"
                )
        return stages

    @model_validator(mode="after")
    def _have_tables(self) -> StageOptions:
        """Make the options of each filter: of its table, or the defaults."""
        filters = {stage: link.options for stage in self.stages if not (link := link_of(stage)).table}
        tables: dict[str, Any] = {} if self.__pydantic_extra__ is None else self.__pydantic_extra__
        for name in tables:
            if name not in filters:
                raise OptionError(
                    f"a table must have the name of a filter in stages, got {name!r}: add it to stages, or "
                    "leave the table out"
                )
        made = {name: _made(name, options, tables.get(name, {})) for name, options in filters.items()}
        tables.clear()
        tables.update({name: options for name, options in made.items() if type(options).model_fields})
        return self

    @property
    def tables(self) -> dict[str, Options]:
        """The options of the filters that have any, by name."""
        return dict(self.__pydantic_extra__ or {})


def _made(name: str, kind: type[Options], table: Any) -> Options:
    """The options of a filter, from a table of values, or from an object of options."""
    if isinstance(table, kind):
        return table
    if not isinstance(table, Mapping):
        raise OptionError(f"{name}: input should be a table of options, got {table!r}")
    try:
        return kind(**table)
    except OptionError as error:
        raise OptionError(f"in [{name}], {error.message}") from error
