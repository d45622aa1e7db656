"""Registries: what other packages add, and what they break."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import pytest
from packages import install

from pcretrieve.cli import options as cli_options
from pcretrieve.descriptors import DESCRIPTORS
from pcretrieve.errors import InputError, OptionError, ShapeError, Stage
from pcretrieve.options import RetrievalOptions, SpectralOptions
from pcretrieve.plugins import COMPARED, METHODS, Names, Registry
from pcretrieve.retrieval import DISTANCES
from pcretrieve.shrec.matcher import MATCHERS
from pcretrieve.spectral import ELEMENTS

GROUP = "pcretrieve.tests"
POINTS = f"""
[{GROUP}]
seven = numbers_package:SEVEN
word = numbers_package:WORD
one = numbers_package:SEVEN
nowhere = numbers_package:NOWHERE
lost = package_that_is_nowhere:SEVEN
ending = ending_package:SEVEN
"""
MODULES = {
    "numbers_package": "SEVEN = 7\nWORD = 'seven'\n",
    "ending_package": "raise SystemExit(0)\n",
}


def whole_number(name: str, added: object) -> int:
    if not isinstance(added, int):
        raise TypeError(f"must be a whole number, got {added!r}")
    return added


NUMBERS = Registry(
    Names("number", GROUP, ("one", "two")), {"one": 1, "two": 2}, whole_number
)


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path / "site", "numbers-package", MODULES, POINTS, monkeypatch)


def test_names_are_those_of_the_records() -> None:
    """Options know the names by tables of their own, since records take long to import."""
    records = [DESCRIPTORS[name] for name in METHODS]
    assert {record.name: record.has_size for record in records} == METHODS
    assert METHODS.keys() - DESCRIPTORS.own.keys() == COMPARED.keys()
    assert get_args(SpectralOptions.model_fields["element"].annotation) == tuple(ELEMENTS)
    assert get_args(RetrievalOptions.model_fields["distance"].annotation) == tuple(
        DISTANCES
    )
    assert tuple(MATCHERS) == cli_options.MATCHERS


def test_a_package_adds_names_and_takes_none(request: pytest.FixtureRequest) -> None:
    assert NUMBERS.names.all() == ("one", "two")
    with pytest.raises(
        OptionError, match="there is no number 'seven'; there are one, two"
    ):
        NUMBERS["seven"]
    request.getfixturevalue("installed")
    assert NUMBERS.names.all() == (
        "one",
        "two",
        "ending",
        "lost",
        "nowhere",
        "seven",
        "word",
    )
    assert (NUMBERS["seven"], NUMBERS["one"], NUMBERS["two"]) == (7, 1, 2)
    assert NUMBERS.called("seven") == "the number 'seven' of the package numbers-package"
    assert NUMBERS.called("one") == "the number 'one'"
    assert NUMBERS.names.known("seven") == "seven"
    with pytest.raises(
        ValueError,
        match=r"input should be one of one, two, ending, .*, word, got 'three'",
    ):
        NUMBERS.names.known("three")


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "lost",
            "cannot be loaded, ModuleNotFoundError: No module named 'package_that_is_nowhere'; upgrade",
        ),
        (
            "nowhere",
            "cannot be loaded, AttributeError: .* has no attribute 'NOWHERE'; upgrade or uninstall",
        ),
        ("ending", "cannot be loaded, SystemExit: 0; upgrade or uninstall that package"),
        (
            "word",
            "must be a whole number, got 'seven'; upgrade or uninstall that package",
        ),
    ],
)
def test_what_cannot_be_loaded_is_named_and_disables_nothing_else(
    name: str, message: str
) -> None:
    with pytest.raises(
        OptionError, match=f"the number '{name}' of the package numbers-package {message}"
    ):
        NUMBERS[name]
    assert NUMBERS["seven"] == 7


def test_of_two_packages_the_first_on_the_path_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, number in (("first", 8), ("second", 9)):
        points = f"[{GROUP}]\nn = {name}:N\n"
        install(tmp_path / name, name, {name: f"N = {number}\n"}, points, monkeypatch)
    assert NUMBERS["n"] == 9


@pytest.mark.usefixtures("installed")
def test_errors_of_a_package_fail_a_shape_or_an_option_and_others_pass() -> None:
    for error in (KeyError("x"), InputError("x"), SystemExit(0)):
        with pytest.raises(
            ShapeError, match=r"^\[spectrum\] the number 'seven' of the .* failed, "
        ) as by:
            fail("seven", error)
        assert by.value.__cause__ is error
    # Without a stage, an option is at fault; values that do not suit fail a shape even of pcretrieve.
    with pytest.raises(
        OptionError, match=r"the number 'seven' of .* failed, KeyError: 'x'; upgrade"
    ):
        fail("seven", KeyError("x"), None)
    with pytest.raises(
        ShapeError, match="the number 'one' failed, InputError: must be positive"
    ):
        fail("one", InputError("must be positive"))
    others = [("seven", OptionError("n must be odd")), ("seven", ShapeError("too flat"))]
    for name, other in [*others, ("seven", MemoryError()), ("one", KeyError("x"))]:
        with pytest.raises(type(other)) as raised:
            fail(name, other)
        assert raised.value is other


def fail(name: str, error: BaseException, stage: Stage | None = Stage.SPECTRUM) -> None:
    with NUMBERS.blamed(name, stage):
        raise error
