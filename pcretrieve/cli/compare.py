"""The command that compares two results for the same queries: compare."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from pcretrieve.cli.commands import command
from pcretrieve.cli.comparison import compared, comparison_options
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.evaluate import COLUMNS, numbers
from pcretrieve.cli.messages import say, write_line
from pcretrieve.cli.parts import CATALOGUE, json_option, labels_option
from pcretrieve.cli.tables import Column, write_table

if TYPE_CHECKING:
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.options import PipelineOptions

__all__ = ["compare_command"]


@command("compare")
@click.argument("first", type=CATALOGUE, metavar="A")
@click.argument("second", type=CATALOGUE, metavar="B")
@labels_option
@click.option(
    "--changes",
    type=click.IntRange(min=0),
    default=5,
    show_default=True,
    metavar="N",
    help="Number of the most changed shapes to list.",
)
@comparison_options
@json_option
def compare_command(
    first: str, second: str, labels: str | None, changes: int, as_json: bool, **comparison: Any
) -> None:
    """Compare two results for the same shapes, query by query.

    A and B are catalogues, distance matrices, or files queries.csv of `evaluate --csv`. Printed are the
    measures of both, and the differences B minus A with 95 % confidence intervals. Options such as
    --whitening are for both catalogues; given twice, they are for A and for B.

    \b
    pcretrieve compare A.sqlite A.sqlite --whitening none --whitening pca
    pcretrieve compare run1.txt run2.txt --labels shrec11.cla
    """
    from pcretrieve.evaluation import MEASURES, compare_scores, result_scores

    used: dict[str, PipelineOptions] = {}
    found = compare_scores(
        result_scores(first, _options(comparison, 0, used), labels),
        result_scores(second, _options(comparison, 1, used), labels),
    )
    rows = {
        "first": found.first,
        "second": found.second,
        "difference": found.difference,
        "low": found.interval[0],
        "high": found.interval[1],
    }
    shown = found.changes[:changes]
    if as_json:
        document: dict[str, object] = {
            name: dict(zip(MEASURES, row.tolist(), strict=True)) for name, row in rows.items()
        }
        document |= {
            # The head of the document has the options of one computation, and here are two, or none of files.
            "first_options": used["first"].model_dump(mode="json") if "first" in used else None,
            "second_options": used["second"].model_dump(mode="json") if "second" in used else None,
            "level": found.level,
            "n_queries": len(found.changes),
            "only_first": found.only_first,
            "only_second": found.only_second,
            "changes": [
                {"id": one.shape_id, "label": one.label, "first": one.first, "second": one.second}
                for one in shown
            ],
        }
        write_document(document)
        return
    table = [
        (*numbers(found.first), f"A: {first}"),
        (*numbers(found.second), f"B: {second}"),
        (*numbers(found.difference, "+.3f"), "B - A"),
        (*numbers(found.interval[0], "+.3f"), f"  {found.level:.0%} interval from"),
        (*numbers(found.interval[1], "+.3f"), "  to"),
    ]
    write_table(COLUMNS, table)
    changed = [one for one in shown if one.first != one.second]
    if changed:
        write_line("average precision of the most changed shapes:")
        precisions = ((one.shape_id, one.label, f"{one.first:.4f}", f"{one.second:.4f}") for one in changed)
        write_table((Column("ID"), Column("CLASS"), Column("A", "number"), Column("B", "number")), precisions)
    left = len(found.only_first) + len(found.only_second)
    say(
        f"{len(found.changes)} queries in both"
        + (
            f"; left out are {len(found.only_first)} in A only and {len(found.only_second)} in B only"
            if left
            else ""
        )
    )


def _options(
    comparison: dict[str, tuple[Any, ...]], number: int, used: dict[str, PipelineOptions]
) -> Callable[[Catalogue], PipelineOptions]:
    """The options of one of the results, which are noted in `used` if it is computed from a catalogue."""
    chosen = {}
    for name, values in comparison.items():
        if len(values) > 2:
            raise click.UsageError(f"--{name.replace('_', '-')} is given at most twice, got {len(values)}")
        chosen[name] = values[min(number, len(values) - 1)] if values else None

    def noted(store: Catalogue) -> PipelineOptions:
        options = used[("first", "second")[number]] = compared(store, **chosen)
        return options

    return noted


for _parameter in compare_command.params:
    # The options of the comparison of shapes can be given twice.
    if isinstance(_parameter, click.Option) and _parameter.name not in ("labels", "changes", "as_json"):
        _parameter.multiple = True
