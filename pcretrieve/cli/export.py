"""The command that writes meshes or signatures of a catalogue to files or to a database: export."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from pcretrieve.cli.commands import command, option
from pcretrieve.cli.comparison import compared, comparison_options
from pcretrieve.cli.messages import say, write_line
from pcretrieve.cli.parts import catalogue_option

__all__ = ["export_command"]


@command("export")
@click.argument("shape_ids", nargs=-1, metavar="[ID]...")
@catalogue_option
@option(
    "--output",
    "-o",
    type=click.Path(path_type=Path),
    metavar="PATH",
    help="A mesh file for one shape (.ply .obj .off .stl .glb); a folder for several; a file of signatures "
    "(.npz .parquet .csv).",
)
@option("--signatures", is_flag=True, help="Write signatures, ids and classes, not meshes.")
@option(
    "--to",
    metavar="URL",
    help="Write whitened signatures to a PostgreSQL database.",
    details="postgresql://user@host/name, with pgvector; the new table is pcretrieve_signatures.",
)
@comparison_options
def export_command(
    shape_ids: tuple[str, ...],
    catalogue: str,
    output: Path | None,
    signatures: bool,
    to: str | None,
    **comparison: Any,
) -> None:
    """Write the meshes, or the signatures, of some or all shapes of a catalogue to files or to a database.

    \b
    pcretrieve export cat0 --catalogue bodies.sqlite -o cat0.obj
    pcretrieve export --catalogue bodies.sqlite -o meshes/
    pcretrieve export --signatures --catalogue bodies.sqlite -o bodies.parquet
    pcretrieve export --catalogue bodies.sqlite --to postgresql://localhost/bodies
    """
    from pcretrieve.catalogue import Catalogue, stored_shapes
    from pcretrieve.catalogue.vectors import export_vectors
    from pcretrieve.errors import InputError
    from pcretrieve.formats import write_mesh, write_signatures

    if (output is None) == (to is None) or (to and signatures):
        raise click.UsageError("give either --output, or --to for signatures in a database")
    given = [f"--{name.replace('_', '-')}" for name, value in comparison.items() if value is not None]
    if given and not signatures and not to:
        raise click.UsageError(
            f"{', '.join(given)} is for --signatures and --to: meshes have no such options"
        )
    if output is None:
        with Catalogue(catalogue) as whole:
            n = export_vectors(whole, str(to), compared(whole, **comparison), shape_ids=shape_ids)
        say(f"wrote {n} signatures to the table pcretrieve_signatures")
        return
    if signatures:
        with Catalogue(catalogue) as whole:
            table = whole.signatures(compared(whole, **comparison))
        write_signatures(table.select(shape_ids) if shape_ids else table, output)
        write_line(str(output))
        return
    with stored_shapes(catalogue) as store:
        if len(shape_ids) == 1 and output.suffix and not output.is_dir():
            write_mesh(store.mesh(shape_ids[0]), output)
            write_line(str(output))
            return
        for shape_id in shape_ids:
            store.mesh(shape_id)  # raises, if one of the meshes is missing, before any file is written
        try:
            output.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"cannot make the folder {output}: {error.strerror}") from error
        chosen = shape_ids or [record.id for record in store.records(status="done")]
        for shape_id in chosen:
            path = output / _file_name(shape_id)
            write_mesh(store.mesh(shape_id), path)
            write_line(str(path))
    say(f"wrote {len(chosen)} meshes to {output}")


def _file_name(shape_id: str) -> str:
    """The name of the file of a mesh. Ids are names of files, but a catalogue from elsewhere may have any."""
    return shape_id.replace("/", "%2F").replace("\0", "%00") + ".ply"
