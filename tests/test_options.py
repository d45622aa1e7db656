"""Options: reading from TOML, digests, and invalid options."""

import math
import re
from pathlib import Path
from typing import Any

import pytest

from pcretrieve.errors import OptionError
from pcretrieve.options import (
    PipelineOptions,
    RemeshOptions,
    describe_options,
    options_difference,
)

# Another value for each option: one that its type and limits allow, and that is not the default.
OTHER: dict[str, dict[str, Any]] = {
    "scan": {
        "unit": "mm",
        "min_range": 0.3,
        "max_range": 4.5,
        "box": ((-1.0, -1.0, 0.0), (1.0, 1.0, 2.0)),
        "ground": "none",
        "keep_largest": True,
        "voxel": 0.01,
        "outlier_std": 3.0,
        "normal_neighbors": 12,
        "orientation": "flood",
        "flood_gap": 0.03,
    },
    "surface": {
        "mode": "keep",
        "max_faces": 5000,
        "method": "poisson",
        "genus": 1,
        "cell": 0.005,
        "gap": 0.03,
        "reconstructions": 3,
        "poisson_depth": 8,
        "target_faces": 4000,
        "max_discarded": 0.2,
    },
    "remesh": {"method": "tetwild", "edge_length": 0.1, "timeout": 5.0},
    "spectral": {"element": "cubic", "n_pairs": 91},
    "signature": {
        "method": "shape-dna",
        "n_values": 30,
        "n_modes": 70,
        "scale": "absolute",
        "size_weight": 2.5,
        "atoms": ((1.0, *(0.0,) * 18),) * 32,
    },
    "retrieval": {
        "distance": "d1",
        "whitening": "within-class",
        "calibration": "metric.npz",
        "shrinkage": 0.2,
        "rerank": "k-reciprocal",
    },
    "catalogue": {"keep": ("overlaps",)},
    "merge": {
        "refine": False,
        "sensor": "origin",
        "background": "planes",
        "keep_largest": True,
        "voxel": 0.01,
        "reach": 0.02,
        "min_overlap": 0.2,
    },
}
# The tables on which no spectrum depends: of signatures, which are computed from it, and of other commands.
AFTER = ("signature", "retrieval", "catalogue", "merge")


def every_option() -> list[tuple[str, str]]:
    return [
        (stage, name)
        for stage, values in PipelineOptions().model_dump().items()
        for name in values
    ]


def test_the_table_above_names_every_option() -> None:
    assert every_option() == [
        (stage, name) for stage, values in OTHER.items() for name in values
    ]


@pytest.mark.parametrize("options", [PipelineOptions(), PipelineOptions(**OTHER)])
def test_described_options_read_back_as_themselves(
    options: PipelineOptions, tmp_path: Path
) -> None:
    path = tmp_path / "options.toml"
    path.write_text(describe_options(options), encoding="utf-8")
    assert PipelineOptions.from_toml(path) == options


def test_every_option_is_explained() -> None:
    lines = describe_options(PipelineOptions()).splitlines()
    for number, line in enumerate(lines):
        if " = " in line and not line.startswith("#"):
            assert lines[number - 1].startswith("# "), line


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"[surface\n", r"options.toml is not valid TOML: Expected ']'"),
        (b"# \xff\n", r"options.toml is not valid TOML: it is not UTF-8 text"),
        (
            b"[surfice]\n",
            r"there is no option 'surfice'; `pcretrieve lab options` lists them all; did you mean 'surface'",
        ),
        (
            b"[surface]\ndepth = 7\n",
            r"options.toml: in \[surface\], there is no option 'depth'",
        ),
        (
            b"[scan]\nvoxel = 'small'\n[surface]\nmode = 'guess'\n",
            r"in \[scan\], voxel: input should be 'auto', got 'small'; "
            r"voxel: input should be a valid number.*, got 'small'; "
            r"in \[surface\], mode: input should be 'auto', 'reconstruct' or 'keep', got 'guess'",
        ),
        (
            b"remesh = 3\nsurface = 3\n",
            r"surface: input should be a valid dictionary .* got 3; remesh: .*, got 3",
        ),
    ],
)
def test_a_bad_file_says_what_is_wrong_with_it(
    text: bytes, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "options.toml"
    path.write_bytes(text)
    with pytest.raises(OptionError, match=message):
        PipelineOptions.from_toml(path)


BAD: list[tuple[str, dict[str, Any]]] = [
    (
        "scan",
        {"min_range": 0.0, "max_range": -1.0, "outlier_std": 0.0, "normal_neighbors": 2},
    ),
    ("scan", {"max_range": math.inf, "voxel": -0.1, "flood_gap": 1.0}),
    ("scan", {"voxel": 1.0, "box": [[0.0, 0.0, 0.0], [1.0, 0.0, 1.0]]}),
    ("scan", {"voxel": math.nan}),
    (
        "surface",
        {
            "max_faces": 100,
            "cell": 0.0,
            "gap": -0.1,
            "poisson_depth": 13,
            "target_faces": 100,
        },
    ),
    ("surface", {"mode": "Auto", "poisson_depth": 7.5, "max_discarded": -0.1}),
    ("surface", {"poisson_depth": 3}),
    ("remesh", {"edge_length": 0.0, "timeout": 0}),
    ("remesh", {"timeout": math.inf}),
    ("spectral", {"n_pairs": 2}),
    ("signature", {"n_values": 0, "n_modes": 1, "size_weight": -1}),
    ("signature", {"size_weight": 21, "n_values": 99_999_999_999}),
    ("retrieval", {"shrinkage": 0.0}),
    ("retrieval", {"shrinkage": 1.1}),
]


def test_values_that_cannot_be() -> None:
    anywhere = [
        (stage, {name: "nonsense"})
        for stage, name in every_option()
        if name != "calibration"
    ]
    for stage, values in [*BAD, *anywhere]:
        for name, bad in values.items():
            message = (
                rf"in \[{stage}\], {name}: input should .*, got {re.escape(repr(bad))}"
            )
            with pytest.raises(OptionError, match=message):
                PipelineOptions().changed(**{stage: {name: bad}})
    with pytest.raises(
        OptionError, match=r"^timeout: input should be greater than 0, got -1"
    ):
        RemeshOptions(timeout=-1)  # one stage by itself


def test_every_option_that_moves_a_spectrum_has_a_digest_of_its_own() -> None:
    options, digests = PipelineOptions(), set()
    for stage, name in every_option():
        other = OTHER[stage][name]
        changed = options.changed(**{stage: {name: other}})
        difference = f"{stage}.{name}: {options.model_dump()[stage][name]!r} there, {other!r:.60} here"
        hidden = stage in ("retrieval", "merge")
        assert options_difference(options, changed) == ([] if hidden else [difference])
        digests.add(changed.digest)
        # One catalogue serves every signature, and every way to compare them.
        assert (changed.digest == options.digest) == (stage in AFTER)
        # The unit of a signature is `Signature.unit`.
        is_in_no_signature = stage in AFTER[1:] or (stage, name) == ("scan", "unit")
        assert (
            changed.signature_digest == options.signature_digest
        ) == is_in_no_signature
    assert len(digests) == 1 + sum(
        len(values) for stage, values in OTHER.items() if stage not in AFTER
    )
    assert options == PipelineOptions()  # `changed` returns a copy


def test_a_name_is_a_preset_unless_there_is_such_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    base = PipelineOptions().changed(surface={"genus": 1}, retrieval={"distance": "d2"})
    assert PipelineOptions.of("clean-mesh") == PipelineOptions.of(
        {"surface": {"mode": "keep"}}
    )
    assert PipelineOptions.of("clean-mesh", base) == base.changed(
        surface={"mode": "keep"}
    )
    Path("clean-mesh").write_text("[signature]\nn_modes = 50\n")
    assert PipelineOptions.of("clean-mesh", base) == base.changed(
        signature={"n_modes": 50}
    )
    with pytest.raises(
        OptionError, match="no preset or file 'nowhere'; the presets are body-scanner"
    ):
        PipelineOptions.of("nowhere")
    with pytest.raises(
        OptionError, match=r"cannot read the options file absent\.toml: No such file"
    ):
        PipelineOptions.of("absent.toml")
    with pytest.raises(
        OptionError, match=r"options must be PipelineOptions, a mapping .*, got int"
    ):
        PipelineOptions.of(3)  # type: ignore[arg-type]
