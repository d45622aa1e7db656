"""The verdict on a shape: whether its signature can be relied on, and why not."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from pcretrieve.errors import InputError

__all__ = ["Judgement", "Verdict"]

Judgement = Literal["sound", "doubtful", "unusable"]


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether the signature of a shape can be relied on, from checks of its points and its surface.

    Attributes
    ----------
    judgement : {"sound", "doubtful", "unusable"}
        "sound": the signature differs less between scans of the body than between bodies. "doubtful": its
        neighbours may be wrong. "unusable": it may be that of another body.
    uncertainty : float
        The log-signature error that is expected from what was filled in, cut off or thinly sampled, and from
        noise; dimensionless, comparable to the distance ``log`` of `SignatureIndex`. Two poses of a body are
        about 0.1 apart, two similar bodies 0.5. It is not `Signature.deviation`, the error bar over the
        surfaces of one scan.
    reasons : tuple of str
        The checks that led to the judgement, each with its measurement, most severe first; empty if sound.

    Raises
    ------
    InputError
        If there is no such judgement, or the uncertainty is negative or not finite.
    """

    judgement: Judgement
    uncertainty: float
    reasons: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.judgement not in get_args(Judgement):
            raise InputError(
                f"a judgement must be one of {', '.join(get_args(Judgement))}, got {self.judgement!r}"
            )
        if not (self.uncertainty >= 0 and math.isfinite(self.uncertainty)):
            raise InputError(f"an uncertainty must be at least 0 and finite, got {self.uncertainty}")
        object.__setattr__(self, "reasons", tuple(self.reasons))

    def __str__(self) -> str:
        because = f": {'; '.join(self.reasons)}" if self.reasons else ""
        return f"{self.judgement}, ± {self.uncertainty:.2g}{because}"

    @property
    def is_sound(self) -> bool:
        """Whether the judgement is "sound"."""
        return self.judgement == "sound"
