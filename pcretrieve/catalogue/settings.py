"""Options ↔ the settings that a catalogue stores."""

from __future__ import annotations

import json
from collections.abc import Mapping

from pcretrieve.catalogue.tables import damaged
from pcretrieve.errors import CatalogueError, OptionError
from pcretrieve.options import NUMBERS_VERSION, PipelineOptions, options_difference


def settings_of(options: PipelineOptions) -> dict[str, str]:
    """The settings of a catalogue that is built with some options."""
    return {"options": options.model_dump_json(), "numbers_version": str(NUMBERS_VERSION)}


def stored_options(
    location: str,
    settings: Mapping[str, str],
    given: PipelineOptions | None = None,
    *,
    any_numbers: bool = False,
) -> PipelineOptions:
    """The options that a catalogue was built with."""
    try:
        values, numbers = json.loads(settings["options"]), int(settings["numbers_version"])
        own = PipelineOptions(**values)
    except OptionError as error:
        raise CatalogueError(
            f"{location} was built by a pcretrieve with other options ({error.message}): ingest into a "
            "new catalogue, or use that version"
        ) from error
    except (KeyError, TypeError, ValueError) as error:
        raise damaged(location, "it has no readable options") from error
    if numbers != NUMBERS_VERSION and not any_numbers:
        raise CatalogueError(
            f"{location} was built by a pcretrieve whose numbers differ (version {numbers} there, "
            f"{NUMBERS_VERSION} here): ingest into a new catalogue; `list`, `show` and `export` read this one"
        )
    same = given is None or (given.signature_digest, given.catalogue) == (own.signature_digest, own.catalogue)
    if given is not None and not same:
        difference = "; ".join(options_difference(own, given))
        raise CatalogueError(
            f"{location} was built with other options: {difference}. Ingest into a new catalogue, or leave "
            "the options out to use its own"
        )
    return own


def fitting_options(location: str, own: PipelineOptions, given: PipelineOptions) -> PipelineOptions:
    """Check that the options of a request need no other spectra than a catalogue stores."""
    if given.digest != own.digest:
        difference = "; ".join(options_difference(own, given))
        raise CatalogueError(
            f"{location} was built with other options: {difference}. Only the options in [signature] and "
            "[retrieval] can be changed: start from Catalogue.options"
        )
    return given
