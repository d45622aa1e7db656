"""The command that ingests, queries and evaluates simulated scans: demo."""

from __future__ import annotations

import shlex
from pathlib import Path

import click

from pcretrieve.cli import options as opt
from pcretrieve.cli.messages import bar, say, stop_waiting


@opt.command("demo")
@click.argument(
    "folder", type=click.Path(path_type=Path), default=Path("pcretrieve-demo"), metavar="[FOLDER]"
)
def demo_command(folder: Path) -> None:
    """Try everything on simulated scans: ingest, query, evaluate, and a page of the results.

    The demo takes one or two minutes, and prints each command before it runs. All files are in FOLDER
    (pcretrieve-demo by default): scans of people, an animal and a hand, their catalogue, and the page.

    \b
    pcretrieve demo
    pcretrieve demo elsewhere
    """
    from pcretrieve.errors import InputError
    from pcretrieve.simulation.samples import DEMO_QUERY, DEMO_SAMPLES, write_samples

    scans, catalogue, page = folder / "scans", folder / "bodies.sqlite", folder / "index.html"
    n = len(DEMO_SAMPLES)
    say(f"Simulating {n} scans of five bodies in {scans}, and a new scan of one of the bodies.")
    stop_waiting()
    with bar(total=n + 1, unit="scan", desc="simulate", disable=None, leave=False) as shown:
        try:
            write_samples(scans, DEMO_SAMPLES, on_scan=lambda path: shown.update())
            (new,) = write_samples(folder / "new", [DEMO_QUERY], on_scan=lambda path: shown.update())
        except OSError as error:
            raise InputError(f"cannot write scans into {folder}: {error.strerror}; name another") from error

    run_step(
        "Of each scan, a surface, a spectrum and a signature are computed and stored in a catalogue.",
        *("ingest", scans, "--labels", scans / "labels.csv", "--catalogue", catalogue),
    )
    run_step(
        "The scans most similar to the new scan, nearest first, and the class that they vote for.",
        *("query", "--catalogue", catalogue, folder / "new" / new, "-k", "5"),
    )
    run_step(
        "How well scans of one body find each other: each scan is a query, and the best score is 1.",
        *("evaluate", "--catalogue", catalogue),
    )
    run_step(
        "The results with pictures, on an HTML page.", *("report", "--catalogue", catalogue, "--output", page)
    )
    say("")
    say(f"Open this page in a browser: {page.resolve().as_uri()}")


def run_step(purpose: str, *words: str | Path) -> None:
    """Print the purpose of a command and the command, and run it; end with its exit code unless it is 0."""
    context = click.get_current_context()
    arguments = [str(word) for word in words]
    for line in ("", purpose, f"$ {shlex.join(['pcretrieve', *arguments])}"):
        say(line)
    command = context.find_root().command
    if code := command.main(arguments, prog_name="pcretrieve", standalone_mode=False):
        context.exit(code)
