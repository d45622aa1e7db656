"""Files of a folder that are no scans → one line that says how many, and what would read them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from pcretrieve.formats import missing_extra

__all__ = ["unread_files"]

# What other programs write instead, for formats without a specification or a reader that is free.
EXPORTS = {
    ".glb": ".fbx .blend .usd .usda .usdc .usdz .abc .max .ma .mb .c4d .3ds .x3d",
    ".stl": ".step .stp .iges .igs .sldprt .sldasm .ipt .3dm .f3d .x_t .brep",
    ".e57": ".fls .fws .zfs .zfprj .rcp .rcs .rdbx .imp .lgs",
    ".ply": ".vtk .vtp .vtu .ctm .nvm .mesh .wrp",
}
EXPORT = {suffix: target for target, suffixes in EXPORTS.items() for suffix in suffixes.split()}

# Suffixes that are named; further ones are counted together.
MOST_NAMED = 8


def unread_files(paths: Iterable[Path]) -> str:
    """Say how many files of which suffix are left unread, and what would read them."""
    counts = Counter(path.suffix.lower() or "without a suffix" for path in paths)
    advice = {suffix: _advice(suffix) for suffix in counts}
    order = sorted(counts, key=lambda suffix: (not advice[suffix], -counts[suffix], suffix))
    said = [f"{counts[suffix]} {suffix}{advice[suffix]}" for suffix in order[:MOST_NAMED]]
    if rest := sum(counts[suffix] for suffix in order[MOST_NAMED:]):
        said.append(f"{rest} others")
    return ", ".join(said)


def _advice(suffix: str) -> str:
    extra = missing_extra(suffix)
    if extra is not None:
        return f" ({extra.command})"
    return f" (export them as {EXPORT[suffix]})" if suffix in EXPORT else ""
