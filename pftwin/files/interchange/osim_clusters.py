"""Selects the markers of an OpenSim model's femur, tibia and patella in a recording, and the usable time range."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_knee import PARTS, OsimKnee
from pftwin.files.interchange.osim_markers import Center, OsimMarker, find_centers, recorded_names, with_centers
from pftwin.files.interchange.osim_motion import resting_patella
from pftwin.files.mocap import (
    MarkerTrajectories,
    PoseSeries,
    butterworth_lowpass,
    fill_gaps,
    mended_cluster,
    read_markers,
    segment_poses,
)

MAX_GAP = 0.1  # longest gap that is filled [s]
CUTOFF, ORDER = 12.0, 2  # of the filter [Hz], as Michaud et al. 2024 filter markers
LEAST = 3  # smallest number of markers of a segment


@dataclass
class MarkerRecording:
    """Markers of a knee in the usable time range of a recording, gaps filled, with their positions on the segments."""

    markers: MarkerTrajectories
    clusters: dict[str, dict[str, Floats]]  # positions (3,) [m] by part (femur, tibia, patella) and recorded name
    used: frozenset[str]  # the model's names of these markers
    cutoff: float | None  # cut-off of the filter for the scene [Hz]; None: the sampling rate is too low for it
    start: tuple[Floats, Floats]  # start pose of the patella in the femur: position [m] and quaternion
    notes: list[str]  # for the user
    order: int = ORDER  # of the filter


def read_recording(
    path: str | os.PathLike[str],
    knee: OsimKnee,
    markers: Sequence[OsimMarker],
    *,
    units: str | None = None,
    without: Sequence[str] = (),
    joint_centers: bool = False,
) -> MarkerRecording:
    """Reads the longest range of a recording in which femur and tibia each have three or more markers.

    The options are those of `import_osim`. Raises InputError as the file's reader, for ambiguous names, fewer than
    three markers of a segment, or never at the same time, collinear markers, a range too short for the filter, and a
    femur without a hip.
    """
    raw = read_markers(path, units=units)
    centers = find_centers(knee) if joint_centers else []
    relevant = {*PARTS, *(c.carrier for c in centers)}
    own = [m for m in markers if m.part in relevant]
    names = recorded_names(own, raw.names, str(path))
    left = _left_out(without, names, str(path))
    differ = [f"{own} is {theirs}" for own, theirs in names.items() if own != theirs]
    notes = [f"markers that the recording spells otherwise: {', '.join(differ)}"] if differ else []
    chosen = raw.select([n for n in names.values() if n not in left])
    places = {
        p: {names[m.name]: m.place for m in own if m.part == p and names.get(m.name) in chosen.names} for p in relevant
    }
    chosen = _mended(chosen, places, notes)
    filled, gaps = fill_gaps(chosen, max_gap_s=MAX_GAP, keep_long=True)
    notes += [f"{g.marker}: filled {g.in_words()}" for g in gaps if g.filled]
    selected, clusters = _known(filled, places, centers, own, knee)
    notes.append(
        f"stretch: {selected.times[0]:g} to {selected.times[-1]:g} s of {raw.times[0]:g} to {raw.times[-1]:g} s, the "
        f"longest in which enough markers of each of {', '.join(sorted(relevant - {'patella'}))} are seen throughout"
    )
    used = frozenset(m for m, theirs in names.items() if theirs in selected.names)
    notes += [
        f"{c.name} counts as a marker of {knee.femur}: the model's default place, determined from the markers of "
        f"{knee.name(c.carrier)}"
        for c in centers
    ]
    cutoff = CUTOFF if selected.rate > 2 * CUTOFF else None
    notes.append(
        f"gaps of up to {MAX_GAP:g} s are filled; filter: "
        + (f"Butterworth, {cutoff:g} Hz, order {ORDER}, forwards and backwards" if cutoff else "none, by the low rate")
    )
    smooth = _low_passed(selected.select([n for p in ("femur", "tibia") for n in clusters[p]]), cutoff)
    fits = {p: _fit(smooth, clusters[p], places[p], knee.name(p), notes) for p in ("femur", "tibia")}
    start, said = resting_patella(knee, fits["tibia"].relative_to(fits["femur"]))
    said += "; limits of how far from there it comes to rest are wide"
    return MarkerRecording(selected, clusters, used, cutoff, start, [*notes, said])


def _mended(
    markers: MarkerTrajectories, places: Mapping[str, Mapping[str, Floats]], notes: list[str]
) -> MarkerTrajectories:
    """The markers, repaired in frames in which they leave their segment's cluster."""
    positions, column = markers.positions.copy(), {name: k for k, name in enumerate(markers.names)}
    for held in (h for part, h in places.items() if part != "patella" and len(h) >= LEAST):
        mended, strays = mended_cluster(markers, held)
        positions[:, [column[n] for n in mended.names]] = mended.positions
        notes += [s.in_words() for s in strays]
    return markers.with_positions(positions)


def _known(
    filled: MarkerTrajectories,
    places: Mapping[str, Mapping[str, Floats]],
    centers: Sequence[Center],
    own: Sequence[OsimMarker],
    knee: OsimKnee,
) -> tuple[MarkerTrajectories, dict[str, dict[str, Floats]]]:
    """Markers, and joint centres if any, in the longest range in which all segments are known; and their clusters."""
    segments = sorted(places.keys() - {"patella"})
    least = {p: max(0, LEAST - len(centers)) if p == "femur" else LEAST for p in segments}
    for part in segments:
        _refuse_few(part, places[part], least[part], filled, own, knee)
    whole = _stretch(filled, {p: list(places[p]) for p in segments}, least)
    clusters = {p: _present(held, whole, throughout=p != "patella") for p, held in places.items()}
    whole = with_centers(whole, centers, clusters)
    clusters["femur"] |= {c.name: c.place for c in centers}
    clusters = {p: clusters[p] for p in PARTS}
    return whole.select([n for p in PARTS for n in clusters[p]]), clusters


def _left_out(without: Sequence[str], names: Mapping[str, str], where: str) -> set[str]:
    """Names, in the recording, of the markers to leave out."""
    found = {name: names.get(name, name) for name in without}
    if strange := [name for name, theirs in found.items() if theirs not in names.values()]:
        problem = f"no marker {strange[0]!r} of the knee to leave out"
        raise InputError(problem, where=where, expected=f"one of: {', '.join(names.values())}")
    return set(found.values())


def _refuse_few(
    part: str, places: Mapping[str, Floats], least: int, filled: MarkerTrajectories,
    own: Sequence[OsimMarker], knee: OsimKnee,
) -> None:  # fmt: skip
    present = list(_present(places, filled, throughout=False))
    if len(present) >= least:
        return
    model = ", ".join(m.name for m in own if m.part == part)
    centers = "" if part != "femur" or least < LEAST else "--joint-centers, where the pelvis has markers; "
    raise InputError(
        f"{len(present)} of the markers on {knee.name(part)} are seen: {', '.join(present) or 'none'}",
        where=filled.source,
        expected=f"{LEAST} or more that span a plane; the model has {model or 'none'} there",
        remedy=f"--markers FILE.xml with the places of more that were recorded; {centers}"
        "or coordinates (.mot) or poses (.sto) in place of markers",
    )


def _present(places: Mapping[str, Floats], markers: MarkerTrajectories, *, throughout: bool) -> dict[str, Floats]:
    """Markers that are present in every frame (`throughout`), or in any."""
    most = 0 if throughout else markers.times.size - 1  # largest number of frames in which a marker may be missing
    lost = dict(zip(markers.names, np.count_nonzero(markers.missing, axis=0), strict=True))
    return {name: place for name, place in places.items() if lost[name] <= most}


def _stretch(
    markers: MarkerTrajectories, segments: Mapping[str, list[str]], least: Mapping[str, int]
) -> MarkerTrajectories:
    """The longest range (the first of several) in all frames of which enough markers of each segment are present.

    Raises InputError if it has fewer than two frames.
    """
    counts = {}  # (n + 1, m): number of earlier frames in which each marker is present
    for part, names in segments.items():
        present = ~markers.select(names).missing
        counts[part] = np.concatenate([np.zeros((1, len(names)), int), np.cumsum(present, axis=0)])

    def known(a: int, b: int) -> bool:
        return all(np.count_nonzero(c[b] - c[a] == b - a) >= least[part] for part, c in counts.items())

    first, best = 0, (0, 0)
    for end in range(1, markers.times.size + 1):
        while first < end and not known(first, end):
            first += 1
        best = max(best, (first, end), key=lambda span: span[1] - span[0])
    if best[1] - best[0] < 2:
        each = "; ".join(f"{part}: {', '.join(names)}" for part, names in segments.items())
        found = f"in no two frames enough markers of each segment are seen at once ({each})"
        raise InputError(found, where=markers.source, expected="a stretch in which femur and tibia are both known")
    return markers.between(float(markers.times[best[0]]), float(markers.times[best[1] - 1]))


def _low_passed(markers: MarkerTrajectories, cutoff: float | None) -> MarkerTrajectories:
    if cutoff is None:
        return markers
    try:
        return markers.with_positions(butterworth_lowpass(markers.positions, markers.rate, cutoff, ORDER))
    except InputError as error:
        raise InputError(
            f"femur and tibia are both known from {markers.times[0]:g} to {markers.times[-1]:g} s at the longest: "
            f"{error.problem}",
            where=markers.source,
            expected=error.expected,
        ) from error


def _fit(
    markers: MarkerTrajectories, cluster: Mapping[str, Floats], own: Collection[str], body: str, notes: list[str]
) -> PoseSeries:
    """Fits a segment's poses; adds notes on the markers' residuals and on the marker that is best left out."""
    poses = segment_poses(markers, cluster, source=f"{markers.source}, {body}")
    places, points = np.array([*cluster.values()]), markers.select(list(cluster)).positions
    off = points - poses.positions[:, None] - np.einsum("nij,mj->nmi", poses.matrices(), places)
    each = ", ".join(f"{n} {1e3 * v:.1f}" for n, v in zip(cluster, _rms(off, (0, 2)), strict=True))
    frames = _rms(off, (1, 2))
    note = (
        f"{body}: {len(cluster)} markers are off a rigid body by {1e3 * float(_rms(off, (0, 1, 2))):.1f} mm rms, "
        f"{1e3 * float(frames.max()):.1f} in the worst frame ({each}): soft tissue, and places that differ from the "
        "model's"
    )
    if len(cluster) > LEAST:
        left = {n: _misfit(np.delete(points, i, 1), np.delete(places, i, 0)) for i, n in enumerate(cluster) if n in own}
        name, best = min(left.items(), key=lambda item: item[1])
        note += f"; without {name} by {1e3 * best:.1f} mm rms"
    notes.append(note)
    return poses


def _misfit(points: Floats, places: Floats) -> float:
    """Root mean square distance of markers (n, m, 3) from the rigid body (m, 3) fitted to each frame [m].

    With the singular values s of the covariance, the residual sum of squares is |p|^2 + |r|^2 - 2 (s1 + s2 +- s3)
    (Soederkvist & Wedin 1993).
    """
    p, r = points - points.mean(axis=1, keepdims=True), places - places.mean(axis=0)
    u, s, vt = np.linalg.svd(np.einsum("nmi,mj->nij", p, r))
    s[:, 2] *= np.linalg.det(u @ vt)
    left = (p**2).sum(axis=(1, 2)) + (r**2).sum() - 2 * s.sum(axis=1)
    return float(np.sqrt(np.maximum(left, 0.0).mean() / len(places)))


def _rms(off: Floats, axis: tuple[int, ...]) -> NDArray[np.float64]:
    """Root mean square of the lengths of vectors (last axis) over other axes."""
    return np.sqrt(np.mean(off**2, axis=axis) * 3)
