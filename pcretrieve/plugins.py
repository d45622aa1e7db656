"""Extension by other packages: a group of entry points → records by name.

A package that is installed beside pcretrieve names its additions in its metadata::

    [project.entry-points."pcretrieve.descriptors"]
    diameter = "other_package:DIAMETER"

Names are read from the metadata alone; a package is imported when one of its names is asked for. A package
that cannot be imported disables its own names only. The names of pcretrieve's own records are reserved.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from inspect import cleandoc
from itertools import pairwise
from typing import Generic, TypeVar

from pcretrieve.errors import InputError, OptionError, ShapeError, did_you_mean

Record = TypeVar("Record")

ADVICE = "upgrade or uninstall that package"


@dataclass(frozen=True)
class Names:
    """The names of the records of one kind, which options and help need without an import of the records.

    own: the names of pcretrieve's records, which no other package can take.
    addresses: those of own names whose records are imported when they are asked for.
    """

    kind: str
    group: str
    own: tuple[str, ...]
    addresses: Mapping[str, str] = field(default_factory=dict)

    def all(self) -> tuple[str, ...]:
        """The names of pcretrieve's records in their order, then the added names in alphabetical order."""
        added = _points(self.group, tuple(sys.path))
        return (*self.own, *sorted(added.keys() - set(self.own)))

    def known(self, name: str) -> str:
        """The name itself."""
        if name in self.own or name in (names := self.all()):
            return name
        raise ValueError(
            f"input should be one of {', '.join(names)}, got {name!r}{did_you_mean(name, names)}"
        )


# Descriptors that scale with the body; only these accept the scale "absolute".
SIZED = ("r-bihdm", "bihdm", "bihdm-sampled", "shape-dna", "sd-gdm", "sd-gdm-sampled")
#: The descriptors of pcretrieve by name, and whether their values have a size. The records in
#: `pcretrieve.descriptors` say more, but take long to import.
METHODS: dict[str, bool] = {
    name: name in SIZED
    for name in (
        "r-bihdm",
        "bihdm",
        "bihdm-sampled",
        "shape-dna",
        "shape-dna-norm1",
        "shape-dna-norm1-values",
        "sd-gdm",
        "sd-gdm-sampled",
        "hks-bow",
        "hks-bow-spatial",
        "si-hks-bow",
        "si-hks-bow-spatial",
        "dl",
        "dl-supervised",
        "wks",
        "csd",
        "ispm",
        "hapt",
        "moments",
    )
}

#: The descriptors of `pcretrieve.shrec`. They are found as those of other packages are: by an address that is
#: written as in the entry points of a package.
COMPARED = {
    "bihdm-sampled": "pcretrieve.shrec.spectra:BIHDM_SAMPLED",
    "shape-dna-norm1": "pcretrieve.shrec.spectra:SHAPE_DNA_NORM1",
    "shape-dna-norm1-values": "pcretrieve.shrec.spectra:SHAPE_DNA_VALUES",
    "sd-gdm": "pcretrieve.shrec.spectra:SD_GDM",
    "sd-gdm-sampled": "pcretrieve.shrec.spectra:SD_GDM_SAMPLED",
    "hks-bow": "pcretrieve.shrec.heat:HKS_BOW",
    "hks-bow-spatial": "pcretrieve.shrec.heat:HKS_BOW_SPATIAL",
    "si-hks-bow": "pcretrieve.shrec.heat:SI_HKS_BOW",
    "si-hks-bow-spatial": "pcretrieve.shrec.heat:SI_HKS_BOW_SPATIAL",
    "dl": "pcretrieve.shrec.dl:DL",
    "dl-supervised": "pcretrieve.shrec.dl:DL_SUPERVISED",
    "ispm": "pcretrieve.shrec.ispm:ISPM",
}

#: The names of the descriptors, of pcretrieve and of other packages.
DESCRIPTOR_NAMES = Names("descriptor", "pcretrieve.descriptors", tuple(METHODS), COMPARED)


@dataclass(frozen=True)
class Registry(Generic[Record]):
    """The records of one kind by name: those of pcretrieve, and those that other packages add.

    `own` holds the records of pcretrieve that no address leads to.
    `checked` makes a record of the name of an entry point and the object that it leads to, or raises
    TypeError with a message that begins with what the object must be.
    """

    names: Names
    own: Mapping[str, Record]
    checked: Callable[[str, object], Record]

    def __getitem__(self, name: str) -> Record:
        """The record of a name."""
        if name in self.own:
            return self.own[name]
        point, called = self._point(name), self.called(name)
        try:
            added = point.load()
        # A package may even end the interpreter when it is imported.
        except (Exception, SystemExit) as error:
            cause = f"{type(error).__name__}: {error}"
            raise OptionError(f"{called} cannot be loaded, {cause}; {ADVICE}") from error
        try:
            return self.checked(name, added)
        except TypeError as error:
            raise OptionError(f"{called} {error}; {ADVICE}") from error

    def called(self, name: str) -> str:
        """The record in a message: ``the descriptor 'diameter' of the package other-package``."""
        if name in self.names.own or name not in self.names.all():
            return f"the {self.names.kind} {name!r}"
        point = self._point(name)
        package = point.dist.name if point.dist else point.module
        return f"the {self.names.kind} {name!r} of the package {package}"

    def version(self, name: str) -> str:
        """The package and the version of a record that another package adds; empty for pcretrieve's own."""
        if name in self.names.own:
            return ""
        point = self._point(name)
        return (
            f" {point.dist.name} {point.dist.version}"
            if point.dist
            else f" {point.module}"
        )

    @contextmanager
    def blamed(self, name: str, stage: str | None = None) -> Iterator[None]:
        """Turn the exceptions of a record's function into one of pcretrieve that names its package.

        It is a ShapeError in a stage of one shape, else an OptionError, since an option has named the record.
        Of the exceptions of pcretrieve's own records only InputError is changed: the shape has led to values
        that are not valid.
        """
        try:
            yield
        except (Exception, SystemExit) as error:
            if isinstance(error, ShapeError) and stage and name not in self.names.own:
                error.stage = stage
            if isinstance(error, (ShapeError, OptionError, MemoryError)) or (
                name in self.names.own and not isinstance(error, InputError)
            ):
                raise
            message = f"{self.called(name)} failed, {type(error).__name__}: {error}"
            if stage:
                raise ShapeError(message, stage=stage) from error
            raise OptionError(f"{message}; {ADVICE}") from error

    def _point(self, name: str) -> EntryPoint:
        if name in self.names.addresses:
            return EntryPoint(name, self.names.addresses[name], self.names.group)
        point = _points(self.names.group, tuple(sys.path)).get(name)
        if point is None:
            raise OptionError(
                f"there is no {self.names.kind} {name!r}; there are {', '.join(self.names.all())}"
            )
        return point


@cache
def _points(group: str, path: tuple[str, ...]) -> Mapping[str, EntryPoint]:
    """The entry points of a group by name, read once for each `path`: reading them takes milliseconds."""
    # Of two packages that add the same name, the first on the path is taken, as by the import system.
    return {point.name: point for point in reversed(tuple(entry_points(group=group)))}


def option_texts(source: str) -> dict[str, tuple[str, str]]:
    """Text and default of each option in the source of its table, by names such as signature.scale.

    Help needs them without an import of the options, whose types take long to make.
    """
    found = {}
    for table in ast.parse(source).body:
        if isinstance(table, ast.ClassDef):
            name = table.name.removesuffix("Options").lower()
            for field, text in pairwise(table.body):
                if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
                    default = ast.unparse(field.value or text).strip("'")
                    words = cleandoc(ast.literal_eval(text.value))
                    found[f"{name}.{ast.unparse(field.target)}"] = words, default
    return found
