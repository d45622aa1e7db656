"""One scan through all stages.

In comes a scan, as a file or as arrays; out come its surface, its spectrum and its signature. Views of one
body become a scan by `pipeline.registration`.
"""

import logging
from collections.abc import Iterable

from pcretrieve.values import Step

_LOGGER = logging.getLogger(__name__)


def log_steps(scan: str | None, steps: Iterable[Step]) -> None:
    """Log steps: each at the level INFO, and its notes on repairs and fallbacks at the level WARNING.

    The records of the level INFO have the attribute ``step``.
    """
    name = scan or "scan"
    for step in steps:
        sizes = ", ".join(f"{what} {size:.6g}" for what, size in step.sizes.items())
        text = f"{name}: {step.stage} in {step.seconds:.2f} s" + (
            f": {sizes}" if sizes else ""
        )
        _LOGGER.info("%s", text, extra={"step": step})
        for note in step.notes:
            _LOGGER.warning("%s: %s: %s", name, step.stage, note)
