"""Checks of the arguments of the simulation."""

from __future__ import annotations

from pcretrieve.errors import InputError, OptionError
from pcretrieve.values import TriangleMesh

__all__ = ["check_at_least", "check_shares", "check_surface"]


def check_surface(mesh: TriangleMesh) -> None:
    """Check that there is a surface to scan."""
    if not (len(mesh.faces) and mesh.area > 0):
        raise InputError(
            f"a scan needs a surface with area, got {len(mesh.faces)} faces without: take another mesh"
        )


def check_at_least(bound: int, **options: float) -> None:
    """Check that options are not too small."""
    for name, value in options.items():
        if not value >= bound:
            raise OptionError(f"{name} must be at least {bound}, got {value}")


def check_shares(**options: float) -> None:
    """Check that options are shares."""
    for name, value in options.items():
        if not 0 <= value <= 1:
            raise OptionError(f"{name} must be a share between 0 and 1, got {value}")
