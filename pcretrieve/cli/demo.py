"""The command that shows the main job on scans of its own: demo."""

from __future__ import annotations

import shlex
from pathlib import Path

import click

from pcretrieve.cli.parts import say

__all__ = ["demo_command"]


@click.command("demo")
@click.argument(
    "folder", type=click.Path(path_type=Path), default=Path("pcretrieve-demo"), metavar="[FOLDER]"
)
def demo_command(folder: Path) -> None:
    """The main job on sample scans: ingest, query, evaluate, and a page to look at.

    Everything goes into FOLDER (pcretrieve-demo by default): simulated scans of people, an animal and a hand,
    the same at every run, a catalogue of them, and an HTML page. Each step is a command that is shown before
    it runs, to be repeated by hand. A minute or two.

    \b
    pcretrieve demo
    pcretrieve demo elsewhere
    """
    from tqdm import tqdm

    from pcretrieve.errors import InputError
    from pcretrieve.simulation.samples import DEMO_QUERY, DEMO_SAMPLES, write_samples

    scans, catalogue, page = folder / "scans", folder / "bodies.sqlite", folder / "index.html"
    n = len(DEMO_SAMPLES)
    say(f"Making {n} scans of five simulated bodies in {scans}, and a new scan of one of the bodies.")
    with tqdm(total=n + 1, unit="scan", desc="simulate", disable=None, leave=False) as bar:
        try:
            write_samples(scans, DEMO_SAMPLES, on_scan=lambda path: bar.update())
            (new,) = write_samples(folder / "new", [DEMO_QUERY], on_scan=lambda path: bar.update())
        except OSError as error:
            raise InputError(f"cannot write scans into {folder}: {error.strerror}; name another") from error

    run_step(
        "Every scan becomes a surface, a spectrum and a signature, which a catalogue keeps with the labels.",
        *("ingest", scans, "--labels", scans / "labels.csv", "--catalogue", catalogue),
    )
    run_step(
        "Whose is the new scan? The most similar ones, nearest first: rank, distance, class, id, file.",
        *("query", "--catalogue", catalogue, folder / "new" / new, "-k", "5"),
    )
    run_step(
        "How well do scans of one body find each other? Each scan is a query; 1 is the best score.",
        *("evaluate", "--catalogue", catalogue),
    )
    run_step("The same as pictures, on a page.", *("report", "--catalogue", catalogue, "--output", page))
    say(f"\nOpen this page in a browser: {page.resolve().as_uri()}")


def run_step(purpose: str, *words: str | Path) -> None:
    """Say what a command is for, show it and run it; end with its exit code if that is not 0."""
    context = click.get_current_context()
    arguments = [str(word) for word in words]
    say(f"\n{purpose}\n$ {shlex.join(['pcretrieve', *arguments])}")
    command = context.find_root().command
    if code := command.main(arguments, prog_name="pcretrieve", standalone_mode=False):
        context.exit(code)
