"""The option `pipeline.stages`: which chains there may be, and what their digests are."""

from __future__ import annotations

import pickle
import re
import sys
from pathlib import Path
from typing import Any

import pytest
from packages import install, install_addition

from pcretrieve import PipelineOptions
from pcretrieve.errors import OptionError
from pcretrieve.options import (
    DEFAULT_STAGES,
    PointFilter,
    SurfaceFilter,
    SurfaceOptions,
    describe_options,
    options_difference,
)
from pcretrieve.options.stages import OWN_STAGES, StageOptions, link_of
from pcretrieve.points import POINT_FILTERS
from pcretrieve.surface import SURFACE_FILTERS

DEFAULT = PipelineOptions()
CUT = ("cut", *DEFAULT_STAGES)


@pytest.fixture
def addition(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install_addition(tmp_path / "site", monkeypatch)


def chain(*stages: str, **tables: dict[str, Any]) -> PipelineOptions:
    """The options of a chain, with the options of its filters."""
    return DEFAULT.changed(pipeline={"stages": stages, **tables})


def test_the_stages_of_options_are_those_of_the_records() -> None:
    """Options know what stages take and give by a table of their own, since records take long to import."""
    for filters in (POINT_FILTERS, SURFACE_FILTERS):
        for name, record in filters.own.items():
            link = OWN_STAGES[name]
            assert (record.takes, record.gives, record.options) == (link.takes, link.gives, link.options)
    for name, link in OWN_STAGES.items():
        assert type(DEFAULT.of_stage(name)) is link.options


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


@pytest.mark.usefixtures("addition")
@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"stretch": {}}, "in [pipeline], a table must have the name of a filter in stages, got 'stretch'"),
        ({"clean": {}}, "in [pipeline], a table must have the name of a filter in stages, got 'clean'"),
        ({"cut": 3}, "in [pipeline], cut: input should be a table of options, got 3"),
        ({"cut": {"depth": 1}}, "in [pipeline.cut], there is no option 'depth'"),
        ({"cut": {"height": "low"}}, "in [pipeline.cut], height: input should be a valid number"),
    ],
)
def test_a_table_that_is_not_of_a_filter_in_the_chain(tables: dict[str, Any], message: str) -> None:
    with pytest.raises(OptionError, match="^" + re.escape(message)):
        chain(*CUT, **tables)


@pytest.mark.usefixtures("addition")
def test_filters_of_surfaces_need_a_surface() -> None:
    of_points = DEFAULT.changed(spectral={"element": "points"})
    assert of_points.pipeline.stages == DEFAULT_STAGES  # surface and remesh are not used
    without = of_points.changed(pipeline={"stages": ("clean", "orient", "spectrum")})
    assert without.pipeline.stages == ("clean", "orient", "spectrum")
    with pytest.raises(OptionError, match="'spectrum' takes a surface"):
        without.changed(spectral={"element": "linear"})
    with pytest.raises(OptionError, match=r"'stretch' takes a surface, and the element .* is of points"):
        of_points.changed(pipeline={"stages": ("clean", "orient", "surface", "stretch", "spectrum")})
    with pytest.raises(OptionError, match=r"'spectrum' takes points with normals, .* give points"):
        of_points.changed(pipeline={"stages": ("clean", "spectrum")})


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


def test_records_state_what_there_is() -> None:
    with pytest.raises(OptionError, match="'points' or 'normals', got 'points' and 'surface'"):
        PointFilter("odd", lambda cloud, options: cloud, gives="surface")
    for record in (PointFilter, SurfaceFilter):
        with pytest.raises(OptionError, match=r"derived from .*\.Options, got <class 'dict'>"):
            record("odd", lambda value, options: value, options=dict)  # type: ignore[arg-type]
        with pytest.raises(OptionError, match="must not have the name 'stages'"):
            record("stages", lambda value, options: value)


# --- what is meant ------------------------------------------------------------------------------------


def test_the_name_of_a_method_stands_for_the_surface() -> None:
    named = chain("crop", "clean", "orient", "poisson", "remesh", "spectrum")
    assert named == DEFAULT.changed(surface={"method": "poisson"})
    assert chain("crop", "clean", "orient", "growth", "remesh", "spectrum").digest == DEFAULT.digest
    # Named in a chain, a method replaces that of the options which are changed.
    assert named.changed(pipeline={"stages": ("orient", "growth", "spectrum")}).surface.method == "growth"
    stages = StageOptions(stages=("clean", "orient", "poisson", "spectrum"))
    options = PipelineOptions(pipeline=stages, surface=SurfaceOptions(gap=0.03))
    assert (options.surface.method, options.surface.gap) == ("poisson", 0.03)
    assert options.pipeline.stages == ("clean", "orient", "surface", "spectrum")
    for surface in ({"method": "growth"}, SurfaceOptions(method="growth")):
        with pytest.raises(OptionError, match=r"'poisson' stands for surface\.method .* got .* 'growth'"):
            PipelineOptions(pipeline=stages, surface=surface)


@pytest.mark.parametrize(
    "stages",
    [
        "orient surface spectrum",
        "clean orient surface spectrum",
        "orient clean surface remesh spectrum",
        "cut orient surface stretch spectrum",
        "clean cut orient surface stretch remesh spectrum",
        "clean orient cut surface remesh stretch spectrum",
    ],
)
@pytest.mark.usefixtures("addition")
def test_chains_that_there_may_be(stages: str) -> None:
    options = chain(*stages.split())
    assert options.pipeline.stages == tuple(stages.split())
    assert options.digest != DEFAULT.digest
    (difference,) = options_difference(DEFAULT, options)
    assert difference == f"pipeline.stages: {DEFAULT_STAGES} there, {tuple(stages.split())} here"


@pytest.mark.usefixtures("addition")
def test_the_options_of_filters() -> None:
    options = chain(*CUT, cut={"height": 0.5})
    assert options.of_stage("cut").model_dump() == {"height": 0.5}
    assert chain(*CUT).of_stage("cut").model_dump() == {"height": 0.0}
    assert options.digest not in (DEFAULT.digest, chain(*CUT).digest)
    # A default value that is named is not another one.
    assert chain(*CUT, cut={"height": 0}).digest == chain(*CUT).digest
    assert options_difference(chain(*CUT), options) == ["pipeline.cut.height: 0.0 there, 0.5 here"]


@pytest.mark.usefixtures("addition")
def test_the_options_of_filters_are_changed_as_others_are() -> None:
    options = chain(*CUT, cut={"height": 0.5})
    assert options.changed(surface={"gap": 0.03}).of_stage("cut") == options.of_stage("cut")
    both = options.changed(pipeline={"stages": ("cut", "orient", "surface", "stretch", "spectrum")})
    assert both.of_stage("cut") == options.of_stage("cut")
    stretched = both.changed(pipeline={"stretch": {"factor": 3}})
    assert stretched.of_stage("stretch").model_dump() == {"factor": 3}
    assert stretched.of_stage("cut") == options.of_stage("cut")
    # The options of a filter go with the filter.
    assert options.changed(pipeline={"stages": DEFAULT_STAGES}) == DEFAULT


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


@pytest.mark.usefixtures("addition")
def test_a_stage_is_imported_when_a_chain_names_it() -> None:
    sys.modules.pop("addition", None)
    assert "cut" in POINT_FILTERS.names.all()
    assert "addition" not in sys.modules
    assert link_of("cut").gives == "points"
    assert "addition" in sys.modules
