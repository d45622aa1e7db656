"""The file system of a catalogue → which journal SQLite can use there, and whether it can write at all.

With a write-ahead log, processes share memory, which computers cannot. On file systems of a network, SQLite
therefore uses a rollback journal, with which readers and the writer wait for each other by locks; if these
locks do not reach other computers, it only reads.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

__all__ = ["Mount", "journal_of", "mount_of"]

MOUNTS = Path("/proc/self/mountinfo")

# Types of file systems that several computers mount, with the options by which locks stay on one computer.
NETWORK: dict[str, tuple[str, ...]] = {
    "nfs": ("nolock", "local_lock=all", "local_lock=posix"),
    "nfs4": ("local_lock=all", "local_lock=posix"),
    "cifs": ("nobrl",),
    "smb3": ("nobrl",),
    "lustre": ("localflock", "noflock"),
    "gpfs": (),
    "ceph": (),
    "fuse.ceph-fuse": (),
    "fuse.glusterfs": (),
    "9p": (),
    "virtiofs": (),
}

# Types without locks that other computers see.
WITHOUT_LOCKS = {
    "afs",
    "beegfs",
    "ncpfs",
    "smbfs",
    "vboxsf",
    "fuse.afs",
    "fuse.blobfuse",
    "fuse.blobfuse2",
    "fuse.davfs",
    "fuse.gcsfuse",
    "fuse.goofys",
    "fuse.mountpoint-s3",
    "fuse.rclone",
    "fuse.s3fs",
    "fuse.sshfs",
}

# Types of FUSE on local disks, where memory can be shared.
LOCAL = {"fuse.fuse-overlayfs", "fuseblk"}


@dataclass(frozen=True, slots=True)
class Mount:
    """A mounted file system."""

    kind: str
    options: frozenset[str] = frozenset()


def mount_of(path: Path) -> Mount:
    """The file system in which a file is, or would be made."""
    try:
        lines = MOUNTS.read_text("utf-8", "surrogateescape").splitlines()
    except OSError:
        return Mount("")
    place = Path(os.path.realpath(path))
    found, depth = Mount(""), 0
    for line in lines:
        before, _, after = line.partition(" - ")
        point = Path(re.sub(r"\\([0-7]{3})", lambda code: chr(int(code[1], 8)), before.split(" ")[4]))
        if place.is_relative_to(point) and len(point.parts) >= depth:  # the last of several at one place
            kind, _, options = after.split(" ", 2)
            found, depth = Mount(kind, frozenset(options.split(","))), len(point.parts)
    return found


def journal_of(mount: Mount) -> Literal["WAL", "DELETE"] | None:
    """The journal mode of SQLite in a file system."""
    if mount.kind in WITHOUT_LOCKS or mount.options.intersection(NETWORK.get(mount.kind, ())):
        return None
    if mount.kind == "lustre" and "flock" not in mount.options:
        return None  # the default of earlier versions: no locks
    # A file system of FUSE does not say whether it is one of a network; not all of them can share memory.
    is_shared = mount.kind in NETWORK or mount.kind.split(".")[0] == "fuse"
    return "DELETE" if is_shared and mount.kind not in LOCAL else "WAL"
