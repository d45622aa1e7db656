"""Commands on what a catalogue holds, and on options: list, show, remove, export, options."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from pcretrieve.cli.parts import (
    catalogue_option,
    config_option,
    json_option,
    load_options,
    say,
    step_lines,
    write_json,
)

__all__ = ["export_command", "list_command", "options_command", "remove_command", "show_command"]


@click.command("list")
@catalogue_option
@click.option("--failed", is_flag=True, help="Only shapes that failed, with the reason.")
@json_option
def list_command(catalogue: Path, failed: bool, as_json: bool) -> None:
    """The shapes of a catalogue: id, status, class, Euler characteristic, seconds, path.

    \b
    pcretrieve list --catalogue bodies.sqlite --failed
    """
    from pcretrieve.catalogue import Catalogue

    with Catalogue(catalogue) as store:
        records = [record for record in store.records() if not failed or record.status == "failed"]
    if as_json:
        write_json([asdict(record) | {"seconds": round(record.seconds, 3)} for record in records])
        return
    for record in records:
        euler = "-" if record.euler is None else str(record.euler)
        reason = f"  [{record.stage}] {record.message}" if record.status == "failed" else ""
        click.echo(
            f"{record.id:<24}  {record.status:<6}  {record.label or '-':<16}  {euler:>4}  "
            f"{record.seconds:6.2f}  {record.path}{reason}"
        )


@click.command("show")
@click.argument("shape_id", metavar="ID")
@catalogue_option
@json_option
def show_command(shape_id: str, catalogue: Path, as_json: bool) -> None:
    """A shape's provenance: where it came from, and what each stage did to it.

    \b
    pcretrieve show cat0 --catalogue bodies.sqlite
    """
    from pcretrieve.catalogue import Catalogue

    with Catalogue(catalogue) as store:
        record = store.record(shape_id)
    if as_json:
        write_json(asdict(record) | {"seconds": round(record.seconds, 3)})
        return
    for name, value in asdict(record).items():
        if name == "versions":
            value = ", ".join(f"{package} {version}" for package, version in record.versions.items())
        if name != "steps" and value is not None:
            click.echo(f"{name:<15} {value}")
    click.echo("\n".join(step_lines(record.steps)))


@click.command("remove")
@click.argument("shape_ids", nargs=-1, required=True, metavar="ID...")
@catalogue_option
def remove_command(shape_ids: tuple[str, ...], catalogue: Path) -> None:
    """Forget shapes; their files are left alone.

    \b
    pcretrieve remove cat0 cat1 --catalogue bodies.sqlite
    """
    from pcretrieve.catalogue import Catalogue

    chosen = dict.fromkeys(shape_ids)
    with Catalogue(catalogue) as store:
        for shape_id in chosen:
            store.record(shape_id)  # all or nothing: name the unknown one before any is gone
        for shape_id in chosen:
            store.remove(shape_id)
    say(f"removed {len(chosen)} from {catalogue}")


@click.command("export")
@click.argument("shape_ids", nargs=-1, metavar="[ID]...")
@catalogue_option
@click.option(
    "--output",
    "-o",
    type=click.Path(path_type=Path),
    required=True,
    metavar="PATH",
    help="A mesh file for one shape (.ply .obj .off .stl .glb), or a folder for .ply files.",
)
def export_command(shape_ids: tuple[str, ...], catalogue: Path, output: Path) -> None:
    """Clean meshes out of a catalogue: those named, or all.

    \b
    pcretrieve export cat0 --catalogue bodies.sqlite -o cat0.obj
    pcretrieve export --catalogue bodies.sqlite -o meshes/
    """
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.errors import InputError
    from pcretrieve.surface import write_mesh

    with Catalogue(catalogue) as store:
        done = [record.id for record in store.records() if record.status == "done"]
        if len(shape_ids) == 1 and output.suffix and not output.is_dir():
            write_mesh(store.mesh(shape_ids[0]), output)
            click.echo(str(output))
            return
        for shape_id in set(shape_ids) - set(done):
            store.mesh(shape_id)  # all or none: says what is wrong with that one before any is written
        try:
            output.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"cannot make the folder {output}: {error.strerror}") from error
        chosen = shape_ids or done
        for shape_id in chosen:
            path = output / f"{shape_id}.ply"
            write_mesh(store.mesh(shape_id), path)
            click.echo(str(path))
    say(f"wrote {len(chosen)} meshes to {output}")


@click.command("options")
@config_option
def options_command(config: Path | None) -> None:
    """Every number of the pipeline with its unit, as TOML for --config.

    \b
    pcretrieve options > mine.toml
    """
    from pcretrieve.options import describe_options

    click.echo(describe_options(load_options(config)))
