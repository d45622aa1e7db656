"""The options of all stages as one object: read from TOML, identified by digests."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterable, Iterator, Mapping
from inspect import cleandoc, getsource
from pathlib import Path
from typing import Any, TypeAlias

from pcretrieve.errors import OptionError, did_you_mean
from pcretrieve.options.tables import (
    CatalogueOptions,
    MergeOptions,
    Options,
    RemeshOptions,
    RetrievalOptions,
    ScanOptions,
    SignatureOptions,
    SpectralOptions,
    SurfaceOptions,
)
from pcretrieve.plugins import option_texts

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

# Version of the numerical results, part of the digest. It is incremented when a change of the code, not of an
# option, changes a signature, because signatures of different versions must not be compared. The changes are
# listed in CHANGELOG.md under "Changed numbers". Values of one version may differ by 1e-8 of themselves: the
# order of sums has changed them by 7e-10, and distances between shapes are above 1e-2.
NUMBERS_VERSION = 6

#: The signature that has error bars, and that expected errors are of: that of the paper, of the form alone.
JUDGED = {"method": "r-bihdm", "n_values": 23, "scale": "area", "size_weight": 0.0}

#: What public functions take for options: see `PipelineOptions.of`.
OptionsLike: TypeAlias = "PipelineOptions | Mapping[str, Any] | str | Path | None"

# The options that differ from the defaults for scans of a common source. The measurements behind each preset
# are in docs/decisions.md, PRESETS.
PRESETS: dict[str, dict[str, dict[str, Any]]] = {
    # A ring of cameras around a person. People have genus 0: handles appear only where limbs touch, and are
    # cut. All scans are in the unit of the scanner, so that sizes are comparable too.
    "body-scanner": {"surface": {"genus": "sphere"}, "signature": {"size_weight": 6.0}},
    # A hand-held scanner moved around the body: many outliers, and large holes in places that it missed.
    "handheld": {
        "scan": {"outlier_std": 1.5, "flood_gap": 0.03},
        "surface": {"gap": 0.03},
    },
    # Frames of a depth sensor: noise of 0.3 % of the diagonal and more, and a room around the body.
    "depth-camera": {
        "scan": {
            "voxel": 0.004,
            "outlier_std": 1.5,
            "normal_neighbors": 30,
            "flood_gap": 0.03,
        },
        "surface": {"cell": 0.006, "gap": 0.03},
        "merge": {
            "sensor": "origin",
            "background": "room",
            "keep_largest": True,
            "voxel": 0.003,
        },
    },
    # Meshes from modelling software, or cleaned by hand: repaired, but not reconstructed.
    "clean-mesh": {"surface": {"mode": "keep"}},
    # The setting of Ye and Yu for the non-rigid track of SHREC'11.
    "paper": {
        "signature": {"method": "r-bihdm", "n_values": 23, "scale": "relative"},
        "retrieval": {"distance": "d2", "whitening": "none"},
        "surface": {"mode": "keep"},
    },
    # The textbook chain, for comparison: normals oriented along a minimum spanning tree, screened Poisson
    # reconstruction by Open3D, remeshing by fTetWild, linear elements, and R-BiHDM signatures, whitened
    # by PCA.
    "classic": {
        "scan": {"orientation": "tangent-plane"},
        "surface": {"method": "poisson"},
        "remesh": {"method": "tetwild"},
        "spectral": {"element": "linear"},
        "signature": {"method": "r-bihdm", "scale": "relative"},
        "retrieval": {"whitening": "pca"},
    },
}


class PipelineOptions(Options):
    """The options of all stages. `PipelineOptions()` are the defaults; docs/decisions.md has the reasons."""

    scan: ScanOptions = ScanOptions()
    surface: SurfaceOptions = SurfaceOptions()
    remesh: RemeshOptions = RemeshOptions()
    spectral: SpectralOptions = SpectralOptions()
    signature: SignatureOptions = SignatureOptions()
    retrieval: RetrievalOptions = RetrievalOptions()
    catalogue: CatalogueOptions = CatalogueOptions()
    merge: MergeOptions = MergeOptions()

    @classmethod
    def from_toml(
        cls, path: str | Path, base: PipelineOptions | None = None
    ) -> PipelineOptions:
        """Read options from a TOML file with one table for each stage; the rest as in `of`."""
        try:
            values = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise OptionError(
                f"cannot read the options file {path}: {error.strerror}"
            ) from error
        except UnicodeDecodeError as error:
            raise OptionError(
                f"{path} is not valid TOML: it is not UTF-8 text"
            ) from error
        except ValueError as error:  # also of an integer of thousands of digits
            raise OptionError(f"{path} is not valid TOML: {error}") from error
        try:
            return (base or cls()).changed(**values)
        except OptionError as error:
            raise OptionError(f"{path}: {error.message}") from error

    @classmethod
    def of(
        cls, options: OptionsLike, base: PipelineOptions | None = None
    ) -> PipelineOptions:
        """The options that a value stands for, as public functions take them.

        Parameters
        ----------
        options : PipelineOptions, mapping, str, Path or None
            Options; a mapping of stages to options with their values, such as ``{"signature": {"n_values":
            45}}``; the name of a TOML file, or of a preset if there is no such file; None for `base`.
        base : PipelineOptions, optional
            The values of options that a mapping, a preset or a file does not name, such as those of a
            catalogue. By default the defaults.

        Returns
        -------
        PipelineOptions
            The options themselves, or those named with the rest of `base`.

        Raises
        ------
        OptionError
            If the value stands for no options, a file cannot be read or is not TOML, or there is an unknown
            option or an invalid value.
        """
        if options is None:
            return base or cls()
        if isinstance(options, cls):
            return options
        if isinstance(options, (str, Path)):
            if Path(options).exists() or Path(options).suffix:
                return cls.from_toml(options, base)
            name = str(options)
            if name not in PRESETS:
                raise OptionError(
                    f"there is no preset or file {name!r}; the presets are {', '.join(PRESETS)}"
                    f"{did_you_mean(name, PRESETS)}"
                )
            options = PRESETS[name]
        if isinstance(options, Mapping):
            return (base or cls()).changed(**options)
        raise OptionError(
            "options must be PipelineOptions, a mapping such as {'signature': {'n_values': 45}}, or the name "
            f"of a preset ({', '.join(PRESETS)}) or of a TOML file, got {type(options).__name__}"
        )

    def changed(self, **stages: dict[str, Any]) -> PipelineOptions:
        """A copy with some options replaced, such as ``options.changed(surface={"mode": "keep"})``."""
        values = self.model_dump()
        for stage, changes in stages.items():
            known = isinstance(changes, Mapping) and stage in values
            values[stage] = values[stage] | dict(changes) if known else changes
        return type(self)(**values)

    @property
    def digest(self) -> str:
        """Hash of everything that a stored spectrum depends on: 16 hexadecimal digits.

        The options of the stages `signature` and `retrieval` are not included, because signatures are
        computed from the stored spectrum on demand: one catalogue serves all methods, numbers of values and
        distances. The options `catalogue` are not included, because no number depends on them, nor those of
        `merge`, which makes the file of a scan before the pipeline.
        """
        values = self.model_dump(exclude={"signature", "retrieval", "catalogue", "merge"})
        values["numbers_version"] = NUMBERS_VERSION
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[
            :16
        ]

    @property
    def signature_digest(self) -> str:
        """Hash of everything that a signature depends on: signatures are comparable only if it is equal."""
        # Without the unit, which a signature that depends on it has itself (`Signature.unit`).
        unitless = self.model_copy(
            update={"scan": self.scan.model_copy(update={"unit": "none"})}
        )
        signature = self.signature.model_dump_json(exclude_none=True)
        return hashlib.sha256((unitless.digest + signature).encode()).hexdigest()[:16]

    @property
    def without_labels(self) -> PipelineOptions:
        """The options, in which the whitening auto is not fitted to labels, as in an evaluation."""
        return self.model_copy(update={"retrieval": self.retrieval.without_labels})

    @property
    def of_copies(self) -> PipelineOptions:
        """The options by which copies are found: moments and the distance log, without whitening."""
        plain = {
            "distance": "log",
            "whitening": "none",
            "rerank": "none",
            "calibration": None,
        }
        signature = {"method": "moments", "scale": "area", "size_weight": 0.0}
        return self.changed(signature=signature, retrieval=plain)


def options_difference(stored: PipelineOptions, given: PipelineOptions) -> list[str]:
    """A line such as ``surface.genus: 'auto' there, 0 here`` for each option that a catalogue has otherwise.

    The options of retrieval and `merge` are left out, because nothing that is stored depends on them.
    """
    there, here = stored.model_dump(exclude={"retrieval", "merge"}), given.model_dump()
    return [
        f"{table}.{name}: {value!r:.60} there, {here[table][name]!r:.60} here"
        for table, values in there.items()
        for name, value in values.items()
        if value != here[table][name]
    ]


def describe_options(options: PipelineOptions, *tables: str) -> str:
    """Options as TOML for `PipelineOptions.from_toml`, or some tables of them, each option explained."""
    names = tables or type(options).model_fields
    return "\n".join(
        line for name in names for line in _table(name, getattr(options, name))
    )


def _table(name: str, options: Options) -> Iterator[str]:
    yield from _comment(options.__doc__)
    yield f"[{name}]"
    # Read here, because Pydantic would read the source of all classes whenever the options are imported.
    texts = option_texts(getsource(type(options)))
    for option in type(options).model_fields:
        text, _ = texts.get(f"{name}.{option}", ("", ""))
        yield from _comment(text)
        # TOML has no null.
        value = getattr(options, option)
        yield f"# {option} =" if value is None else f"{option} = {json.dumps(value)}"
    yield ""


def _comment(text: str | None) -> list[str]:
    return [f"# {line}".rstrip() for line in cleandoc(text or "").splitlines()]


def check_many(name: str, values: object) -> None:
    """OptionError if an argument is not several values; a text, which is a sequence of letters, is one."""
    if isinstance(values, (str, bytes)) or not isinstance(values, Iterable):
        raise OptionError(f"{name} must be a list, got {values!r}: put it into a list")
