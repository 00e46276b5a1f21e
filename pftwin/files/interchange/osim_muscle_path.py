"""Path of a muscle of an OpenSim model over a motion: its length, and the segment that ends on the patella.

Path points may be conditional on a coordinate's range or move with a coordinate. Between points the path is straight,
except where it wraps over objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import GROUND, Element
from pftwin.files.interchange.osim_joints import Coordinate, function_in
from pftwin.files.interchange.osim_knee import OsimKnee
from pftwin.files.interchange.osim_lines import BODIES, POINTS
from pftwin.files.interchange.osim_motion import Motion
from pftwin.files.interchange.osim_wraps import Wrap

FIXED, CONDITIONAL, MOVING = POINTS
_LEAST = 1e-6  # smallest valid length of a path [m]
_SLACK = 1e-5  # OpenSim's tolerance on the coordinate's range of a conditional point [rad] or [m]


class PathOverMotion(NamedTuple):
    """A muscle's path in the n frames of a motion."""

    lengths: Floats  # (n,) length of the whole path [m]
    insertion: Floats  # (3,) end point on the patella, in its frame [m]
    origin: Floats  # (n, 3) the point before, in the body's frame [m]
    body: str  # "femur", "tibia" or "ground"


class MovingBodies:
    """Poses of a model's bodies in ground over a motion.

    Femur, tibia and patella have the motion's poses. Every other body has the pose, relative to the one of them that
    carries it (else the femur), that follows from the model's joints at the motion's coordinates, or at the defaults.
    """

    def __init__(self, knee: OsimKnee, motion: Motion) -> None:
        self.knee, self.motion = knee, motion
        self.count = motion.times.size
        self.values = knee.model.tree.values(motion.values or {}, self.count)
        self._found: dict[str, Floats] = {GROUND: np.tile(np.eye(4), (self.count, 1, 1))}

    def pose(self, part: str) -> Floats:
        """Pose (n, 4, 4) of "femur", "tibia", "patella" or a named body that joints connect with ground."""
        body = self.knee.name(part)
        if body not in self._found:
            self._found[body] = self._measured(body) if body in self.motion.poses else self._fixed_to_part(body)
        return self._found[body]

    def seen_from(self, part: str, points: Floats, at: np.ndarray | slice = slice(None)) -> Floats:
        """Transforms points (k, 3) [m] from ground, one for each of the frames `at`, to a part's frame."""
        return _moved(np.linalg.inv(self.pose(part))[at], points)

    def coordinate(self, path: str, where: str) -> tuple[Coordinate, Floats]:
        """A coordinate by a socket's path, and its values (n,); raises InputError if the motion has no coordinates."""
        name = path.strip().rpartition("/")[2]
        known = self.knee.model.tree.coordinates()
        if name not in known:
            raise InputError(f"no coordinate {name!r}", where=where)
        if self.motion.values is None:
            found = f"a point of a muscle's path goes by the coordinate {name!r}, which poses do not tell"
            raise InputError(found, where=where, remedy="--motion with a file of coordinates")
        return known[name], self.values[name]

    def _measured(self, body: str) -> Floats:
        out = np.tile(np.eye(4), (self.count, 1, 1))
        out[:, :3, :3], out[:, :3, 3] = self.motion.poses[body].matrices(), self.motion.poses[body].positions
        return out

    def _fixed_to_part(self, body: str) -> Floats:
        tree, bones = self.knee.model.tree, (self.knee.tibia, self.knee.patella)
        roots = {tree.welded(bone)[0]: bone for bone in bones}
        below, carrier = tree.welded(body)[0], self.knee.femur
        while below in tree.joints:
            if below in roots:
                carrier = roots[below]
                break
            below = tree.welded(tree.joints[below].parent.body)[0]
        rest, own = (tree.pose(b, self.values, self.count) for b in (carrier, body))
        return self.pose(carrier) @ np.linalg.inv(rest) @ own


class _PathPoint(NamedTuple):
    """A point of a path."""

    part: str  # of the knee, or another body's name
    own: Floats  # (n, 3) in that part's frame [m]
    place: Floats  # (n, 3) in ground [m]
    there: Floats  # (n,) whether it is active
    fixed: bool  # whether it is fixed in its part


def path_over_motion(muscle: Element, bodies: MovingBodies, wraps: Sequence[Wrap] = ()) -> PathOverMotion | None:
    """Computes a muscle's path; None unless in every frame exactly one segment ends at a fixed point of the patella.

    If it wraps over several objects, each is treated separately. Raises InputError for points without a position,
    unknown coordinates, and a path without length.
    """
    points = [_point(p, bodies) for p in muscle.all(*POINTS)]
    lengths, ends = np.zeros(bodies.count), np.zeros((bodies.count, 2), int)
    there = np.stack([p.there for p in points])
    for pattern in np.unique(there, axis=1).T:
        at = (there == pattern[:, None]).all(axis=0)
        used = np.flatnonzero(pattern)
        pairs = list(pairwise(used))
        touching = [p for p in pairs if (points[p[0]].part == "patella") != (points[p[1]].part == "patella")]
        if len(touching) != 1:
            return None
        i, j = touching[0]
        ends[at] = (i, j) if points[i].part == "patella" else (j, i)
        for a, b in pairs:
            start, end = points[a].place[at], points[b].place[at]
            lengths[at] += np.linalg.norm(end - start, axis=-1)
            for wrap in (w for w in wraps if w.between.covers(int(a), int(b))):
                lengths[at] += wrap.adds(*(bodies.seen_from(wrap.part, place, at) for place in (start, end)))
    if not (lengths > _LEAST).all():
        where = f"{muscle.where}, frame {1 + int(np.argmin(lengths))}"
        raise InputError(f"the path of {muscle.name!r} has no length", where=where, expected="points that differ")
    inserted = np.unique(ends[:, 0])
    if len(inserted) > 1 or not points[inserted[0]].fixed:
        return None
    before = {points[k].part for k in ends[:, 1]}
    body = before.pop() if len(before) == 1 and before <= {*BODIES} else "femur"
    places = np.stack([points[k].place[f] for f, k in enumerate(ends[:, 1])])
    return PathOverMotion(lengths, points[inserted[0]].own[0], bodies.seen_from(body, places), body)


def _point(element: Element, bodies: MovingBodies) -> _PathPoint:
    part, pose = bodies.knee.placed(bodies.knee.model.frames.of(element))
    here, there = np.zeros((bodies.count, 3)), np.ones(bodies.count, bool)
    if element.tag == MOVING:
        for k, axis in enumerate("xyz"):
            here[:, k] = _moving(element, axis, bodies)
    else:
        here += element.needed("location").numbers(3)
    if element.tag == CONDITIONAL:
        low, high = element.needed("range").numbers(2)
        _, values = bodies.coordinate(element.needed("socket_coordinate").text, element.where)
        there = (values >= low - _SLACK) & (values <= high + _SLACK)
    own = here @ pose[:3, :3].T + pose[:3, 3]
    return _PathPoint(part, own, _moved(bodies.pose(part), own), there, element.tag != MOVING)


def _moved(poses: np.ndarray, points: Floats) -> Floats:
    """Transforms points (n, 3) by poses (n, 4, 4)."""
    return np.einsum("nij,nj->ni", poses[:, :3, :3], points) + poses[:, :3, 3]


def _moving(element: Element, axis: str, bodies: MovingBodies) -> Floats:
    """A component (n,) [m] of a moving point in its frame; the coordinate that moves it is limited to its range."""
    function = function_in(element, f"{axis}_location")
    if function is None:
        return np.zeros(bodies.count)
    socket = element.words(f"socket_{axis}_coordinate")
    if not socket:
        return function(np.zeros(bodies.count))
    coordinate, values = bodies.coordinate(socket, element.where)
    return function(np.clip(values, coordinate.low, coordinate.high))
