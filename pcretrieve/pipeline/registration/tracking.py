"""Views in the order of a sequence, such as the frames of a depth camera → tracks with key frames.

Views of a sequence overlap the views before them almost completely, so that a local registration from the
motion before finds their poses; no features are matched. Views in no order have no tracks: each is alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from pcretrieve.options import MergeOptions
from pcretrieve.pipeline.registration.alignment import (
    Poses,
    Verification,
    adjusted,
    verification,
)
from pcretrieve.pipeline.registration.views import View
from pcretrieve.values import FloatArray

# Largest distances of correspondences in the steps of the registration of a frame, in units of `reach`: from
# the motion before, and from a pose near the final one.
TRACKING = (4.0, 3.0, 2.0, 1.5, 1.0)
NEAR = (1.0, 1.0)

# A frame is tracked if it shares this fraction of its points with the key frame. It becomes a key frame if it
# shares less than the second fraction, because it then adds surface.
TRACKED = 0.6
NEW_SURFACE = 0.85

# Number of key frames, the nearest in the common frame, to which another frame is registered.
NEAREST_KEYS = 3


class Track(NamedTuple):
    """Views that were registered one after another.

    poses: poses of the views by number, in the frame of the first of them.
    keys: number of the key frame of each view; that of a key frame is its own.
    """

    poses: dict[int, FloatArray]
    keys: dict[int, int]

    @property
    def key_poses(self) -> dict[int, FloatArray]:
        """Poses of the key frames, by number."""
        return {
            number: self.poses[number]
            for number, key in self.keys.items()
            if number == key
        }


def tracks(views: Sequence[View], reach: float, options: MergeOptions) -> list[Track]:
    """Register each view to the views before it, as far as they overlap almost completely.

    A view is registered by point-to-plane ICP to the key frame of the view before, from the pose of constant
    velocity, so that errors add up from key frame to key frame only. The result is verified by the range
    images of both, as all matches are. Where this fails, the view before becomes a key frame; where that
    fails too, the view begins a track of its own. A view after an interruption may continue the last track.
    """
    found: list[Track] = []
    for number in range(len(views)):
        last = [track for track in found[-1:] if len(track.poses) == 1]
        longer = [track for track in reversed(found) if len(track.poses) > 1][:1]
        if not any(
            _continued(views, track, number, reach, options) for track in [*longer, *last]
        ):
            found.append(Track({number: np.eye(4)}, {number: number}))
    return found


def _continued(
    views: Sequence[View], track: Track, number: int, reach: float, options: MergeOptions
) -> bool:
    """Add a view to a track, if it can be registered to the last view of the track, or to its key frame."""
    *_, last = track.poses
    before = list(track.poses)[-2:]
    velocity = np.linalg.inv(track.poses[before[0]]) @ track.poses[last]
    guess = track.poses[last] @ (
        velocity if len(before) == 2 and number == last + 1 else np.eye(4)
    )
    for key in dict.fromkeys((track.keys[last], last)):
        here = {key: track.poses[key]}
        pose = adjusted(
            views, here | {number: guess}, fixed=[key], steps=TRACKING, reach=reach
        )[number]
        found = verification(views, here, {number: pose}, reach)
        if _is_tracked(found, options):
            track.keys[key] = key
            track.poses[number] = pose
            track.keys[number] = number if found.share < NEW_SURFACE else key
            return True
    return False


def _is_tracked(found: Verification, options: MergeOptions) -> bool:
    return found.share >= TRACKED and found.contradiction <= options.max_contradiction


def posed_track(
    views: Sequence[View], poses: Poses, reach: float, options: MergeOptions
) -> Track:
    """Choose the key frames of views with poses."""
    track = Track(dict(poses), {})
    key = min(poses)
    for number in poses:
        found = verification(views, {key: poses[key]}, {number: poses[number]}, reach)
        key = (
            key if _is_tracked(found, options) and found.share >= NEW_SURFACE else number
        )
        track.keys[number] = key
    return track


def followed(
    views: Sequence[View],
    keys: Poses,
    tracked: Sequence[Track],
    reach: float,
    options: MergeOptions | None,
) -> tuple[dict[int, FloatArray], Mapping[int, int]]:
    """Register the views of tracks to their key frames, which do not move.

    keys: poses of the key frames, by number, in the common frame.
    options: those by which the poses are verified; None to accept them all.
    Returns poses, key_of: pose and key frame of each view that could be registered, and of the key frames, by
        number; the poses ascending.
    """
    poses, key_of = dict(keys), {number: number for number in keys}
    for track in tracked:
        for number, key in track.keys.items():
            if number == key or key not in keys:
                continue
            guess = keys[key] @ np.linalg.inv(track.poses[key]) @ track.poses[number]
            near = _nearest(views, keys, guess, number)
            pose = adjusted(
                views, near | {number: guess}, fixed=list(near), steps=NEAR, reach=reach
            )[number]
            if options is None or verification(views, near, {number: pose}, reach).holds(
                options
            ):
                poses[number], key_of[number] = pose, key
    return dict(sorted(poses.items())), key_of


def _nearest(
    views: Sequence[View], keys: Poses, pose: FloatArray, number: int
) -> dict[int, FloatArray]:
    """The poses of the key frames whose sensors are nearest to that of a view."""

    def sensor(number: int, pose: FloatArray) -> FloatArray:
        viewpoints = np.asarray(views[number].cloud.viewpoints)
        return np.asarray(pose[:3, :3] @ viewpoints[0] + pose[:3, 3])

    here = sensor(number, pose)
    distance = {key: float(np.linalg.norm(sensor(key, keys[key]) - here)) for key in keys}
    return {
        key: keys[key]
        for key in sorted(keys, key=lambda key: (distance[key], key))[:NEAREST_KEYS]
    }
