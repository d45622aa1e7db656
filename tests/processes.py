"""Processes that tests start."""

from __future__ import annotations

import multiprocessing

PATIENCE = 60  # seconds


def all_workers_ended() -> bool:
    """Whether all child processes end by themselves: one that was killed takes a moment on a busy machine."""
    for child in multiprocessing.active_children():
        child.join(PATIENCE)
    return not multiprocessing.active_children()
