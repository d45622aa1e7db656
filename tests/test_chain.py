"""The option `pipeline.stages`: which chains there may be, and what their digests are."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import pytest
from packages import install, install_addition

from pcretrieve import PipelineOptions
from pcretrieve.errors import OptionError
from pcretrieve.options import (
    DEFAULT_STAGES,
    describe_options,
)

DEFAULT = PipelineOptions()
CUT = ("cut", *DEFAULT_STAGES)


@pytest.fixture
def addition(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install_addition(tmp_path / "site", monkeypatch)


def chain(*stages: str, **tables: dict[str, Any]) -> PipelineOptions:
    """The options of a chain, with the options of its filters."""
    return DEFAULT.changed(pipeline={"stages": stages, **tables})


# --- what is refused ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("stages", "message"),
    [
        (
            "clean dust orient surface spectrum",
            "input should be names of crop, clean, orient, .*, got 'dust'",
        ),
        ("clean orient clean surface spectrum", "input should name each stage once, got 'clean' again"),
        (
            "clean orient growth poisson spectrum",
            "'poisson' stands for surface.method = 'poisson', got .* = 'growth'",
        ),
        (
            "clean surface spectrum",
            "'surface' takes points with normals, but .* before it give points: put",
        ),
        ("spectrum", "'spectrum' takes a surface, but .* give points: put 'orient' and 'surface' before it"),
        (
            "clean orient spectrum",
            "'spectrum' takes a surface, .* points with normals: put 'surface', or",
        ),
        ("clean orient remesh surface spectrum", "'remesh' takes a surface, but .* give points with normals"),
        ("orient surface clean spectrum", "'clean' takes points, .* give a surface: put it before 'surface'"),
        ("clean orient surface", "'spectrum' must be the last, got clean, orient, surface: add it"),
        ("", "'spectrum' must be the last, got no stage: add it"),
        ("clean orient surface spectrum remesh", "'spectrum' must be the last, got 'remesh' after it"),
    ],
)
def test_a_chain_that_does_not_lead_to_a_spectrum(stages: str, message: str) -> None:
    with pytest.raises(OptionError, match=rf"^in \[pipeline\], stages: {message}"):
        chain(*stages.split())


@pytest.mark.usefixtures("addition")
@pytest.mark.parametrize(
    ("stages", "message"),
    [
        ("clean orient surface cut spectrum", "'cut' takes points, but .* give a surface: put it before"),
        ("clean stretch orient surface spectrum", "'stretch' takes a surface, but .* give points: put"),
        ("cut clean orient surface spectrum cut", "input should name each stage once, got 'cut' again"),
    ],
)
def test_a_filter_in_a_place_that_is_not_its_own(stages: str, message: str) -> None:
    with pytest.raises(OptionError, match=rf"^in \[pipeline\], stages: {message}"):
        chain(*stages.split())


MODULE = """
from pcretrieve.points import PointFilter

NUMBER = 7
TWICE = PointFilter("twice", None)
"""
ENTRY_POINTS = """
[pcretrieve.point_filters]
number = filters:NUMBER
lost = nowhere:LOST
twice = filters:TWICE
[pcretrieve.surface_filters]
twice = filters:TWICE
"""


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("number", "the point filter 'number' of the package theirs must be of the class PointFilter, got 7"),
        ("lost", "the point filter 'lost' of the package theirs cannot be loaded, ModuleNotFoundError"),
        (
            "twice",
            "input should name one stage by each .* 'twice', a point filter and a surface filter: ",
        ),
    ],
)
def test_a_filter_that_cannot_be_used(
    name: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path / "site", "theirs", {"filters": MODULE}, ENTRY_POINTS, monkeypatch)
    with pytest.raises(OptionError, match=rf"^in \[pipeline\], .*{message}"):
        chain(name, *DEFAULT_STAGES)


# --- what is meant ------------------------------------------------------------------------------------


@pytest.mark.usefixtures("addition")
def test_a_chain_is_stored_and_sent_to_workers(tmp_path: Path) -> None:
    options = chain(*CUT, cut={"height": 0.5})
    assert PipelineOptions.model_validate_json(options.model_dump_json()) == options
    assert pickle.loads(pickle.dumps(options)) == options
    (tmp_path / "chain.toml").write_text(describe_options(options))
    assert PipelineOptions.from_toml(tmp_path / "chain.toml") == options
    assert (
        "[pipeline.cut]\n# The z coordinate of the plane; unit of the file.\nheight = 0.5\n"
        in describe_options(options)
    )
