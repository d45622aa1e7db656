"""Options in words: as TOML with descriptions, and the differences of two sets of options."""

from __future__ import annotations

import json

from pcretrieve.options.model import Options
from pcretrieve.options.pipeline import PipelineOptions

__all__ = ["describe_options", "options_difference"]


def options_difference(theirs: PipelineOptions, ours: PipelineOptions) -> list[str]:
    """The options of what a catalogue stores, retrieval therefore left out, in which two sets differ.

    Parameters
    ----------
    theirs : PipelineOptions
        The options called "there", such as those of a stored catalogue.
    ours : PipelineOptions
        The options called "here".

    Returns
    -------
    list of str
        One line for each option, such as ``surface.poisson_depth: 7 there, 8 here``.
    """
    there, here = theirs.model_dump(exclude={"retrieval"}), ours.model_dump()
    return [
        f"{stage}.{name}: {there[stage][name]!r} there, {here[stage][name]!r} here"
        for stage in there
        for name in there[stage]
        if there[stage][name] != here[stage][name]
    ]


def describe_options(options: PipelineOptions) -> str:
    """Options as TOML, with the description of each option as a comment, for ``--config``.

    Parameters
    ----------
    options : PipelineOptions
        The options to write.

    Returns
    -------
    str
        A TOML document that `PipelineOptions.from_toml` reads back to equal options.
    """
    lines = []
    for stage in type(options).model_fields:
        group: Options = getattr(options, stage)
        lines += [f"# {group.__doc__}", f"[{stage}]"]
        for name, info in type(group).model_fields.items():
            lines += [f"# {line}" for line in (info.description or "").splitlines()]
            lines += [f"{name} = {json.dumps(getattr(group, name))}"]
        lines.append("")
    return "\n".join(lines)
