"""What is wrong with everything that is stored of one shape."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator

import numpy as np

from pcretrieve.catalogue.arrays import unpacked, unpacked_values
from pcretrieve.catalogue.rows import OWN, Entry, Payload
from pcretrieve.catalogue.surfaces import stored_shape
from pcretrieve.errors import ShapeError
from pcretrieve.options import PipelineOptions

__all__ = ["faults_of"]

DIGEST = re.compile("[0-9a-f]{64}")


def faults_of(entry: Entry, options: PipelineOptions) -> Iterator[str]:
    """What is wrong with everything that is stored of a shape."""
    record = entry.record
    if record.status == "failed":
        if not (record.stage and record.error and record.message):
            yield "it failed, but stage, error or message are missing"
        if kept := [*entry.payloads, *(["signatures"] if entry.signatures else [])]:
            yield f"it failed, but has {', '.join(kept)}"
        return
    if record.stage or record.error or record.message:
        yield f"it is finished, but has the failure {record.error or record.message} in {record.stage}"
    if not DIGEST.fullmatch(record.content_hash):
        yield f"its content hash must be 64 hexadecimal digits, but is {record.content_hash!r}"
    yield from _faults_of_signatures(entry, options)
    needed: tuple[Payload, ...] = ("spectra", "moments", *options.catalogue.keep)
    if missing := [name for name in needed if name not in entry.payloads]:
        yield f"its {' and '.join(missing)} are missing"
    if "spectra" in entry.payloads:
        yield from _faults_of_arrays(entry)
    if "thumbnails" in entry.payloads:
        try:
            unpacked(entry.payloads["thumbnails"])
        except (ValueError, struct.error, zlib.error) as error:
            yield f"its thumbnail cannot be read: {error}"


def _faults_of_signatures(entry: Entry, options: PipelineOptions) -> Iterator[str]:
    from pcretrieve.descriptors import signature_length

    if OWN not in entry.signatures:
        yield "its signature is missing"
    for digest, value in entry.signatures.items():
        name = "its signature" if digest == OWN else f"its signature by the options {digest}"
        n_values = signature_length(options.signature) if digest == OWN else len(value) // 8 - 1
        try:
            values = unpacked_values(np.frombuffer(value, np.uint8)[np.newaxis], n_values)
        except ValueError as error:
            yield f"{name} cannot be read: {error}"
        else:
            if not np.isfinite(values).all():
                yield f"{name} has values that are not finite"


def _faults_of_arrays(entry: Entry) -> Iterator[str]:
    record = entry.record
    try:
        shape = stored_shape(entry.payloads, record.steps)
    except (KeyError, ValueError, ShapeError, struct.error, zlib.error) as error:
        yield f"its arrays cannot be read: {error}"
        return
    if shape.area != record.area:
        yield f"its area is {record.area} in its record, and {shape.area} with its spectra"
    mesh = shape.surfaces[0].mesh
    if mesh is None:
        return
    stated = (record.n_vertices, record.n_faces, record.euler)
    found = (len(mesh.vertices), len(mesh.faces), mesh.euler_characteristic)
    if stated != found:
        yield f"vertices, faces and Euler characteristic are {stated} in its record, and {found} in its mesh"
