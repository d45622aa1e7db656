"""The command that writes meshes or signatures of a catalogue to files or to a database: export."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pcretrieve.cli.commands import command, option
from pcretrieve.cli.comparison import compared, comparison_options
from pcretrieve.cli.documents import write_document
from pcretrieve.cli.messages import say, write_line
from pcretrieve.cli.parts import catalogue_option, json_option

if TYPE_CHECKING:
    from pcretrieve.catalogue.reading import StoredShapes

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
@json_option
def export_command(
    shape_ids: tuple[str, ...],
    catalogue: str,
    output: Path | None,
    signatures: bool,
    to: str | None,
    as_json: bool,
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
    from pcretrieve.formats import write_mesh, write_signatures

    if (output is None) == (to is None) or (to and signatures):
        raise click.UsageError("give either --output, or --to for signatures in a database")
    given = [f"--{name.replace('_', '-')}" for name, value in comparison.items() if value is not None]
    if given and not signatures and not to:
        raise click.UsageError(
            f"{', '.join(given)} is for --signatures and --to: meshes have no such options"
        )
    options = None
    files: list[str] = []
    if output is None or signatures:
        with Catalogue(catalogue) as whole:
            options = compared(whole, **comparison)
            if output is None:
                n = export_vectors(whole, str(to), options, shape_ids=shape_ids)
                say(f"wrote {n} signatures to the table pcretrieve_signatures")
            else:
                table = whole.signatures(options)
                write_signatures(table.select(shape_ids) if shape_ids else table, output)
                files = [str(output)]
    else:
        with stored_shapes(catalogue) as store:
            for path, shape_id in _mesh_files(store, shape_ids, output).items():
                write_mesh(store.mesh(shape_id), path)
                files.append(str(path))
                if not as_json:
                    write_line(str(path))
    if as_json:
        write_document({"files": files}, options=options)
    elif signatures:
        write_line(str(output))
    elif output is not None and output.is_dir():
        say(f"wrote {len(files)} meshes to {output}")


def _mesh_files(store: StoredShapes, shape_ids: tuple[str, ...], output: Path) -> dict[Path, str]:
    """The file of each mesh, in a folder that is made; raises if one of the meshes is missing."""
    from pcretrieve.errors import InputError

    if len(shape_ids) == 1 and output.suffix and not output.is_dir():
        return {output: shape_ids[0]}
    for shape_id in shape_ids:
        store.mesh(shape_id)
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder {output}: {error.strerror}") from error
    chosen = shape_ids or [record.id for record in store.records(status="done")]
    return {output / _file_name(shape_id): shape_id for shape_id in chosen}


def _file_name(shape_id: str) -> str:
    """The name of the file of a mesh. Ids are names of files, but a catalogue from elsewhere may have any."""
    return shape_id.replace("/", "%2F").replace("\0", "%00") + ".ply"
