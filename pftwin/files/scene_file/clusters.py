"""Checks that clusters of markers fit rigid bodies, and bodies of the side that the scene file states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.files.mocap import MarkerTrajectories, PoseSeries, cluster_poses
from pftwin.files.scene_file.document import Document
from pftwin.model.limits import Limits, beyond

# A cluster is of the other side if it fits worse [m], and its mirror image better [m] and within this share of it.
# Two of its markers are exchanged if it fits worse than COMPARED, and with both exchanged within the same share.
MISFIT, MIRROR_FITS, SHARE = 2e-3, 5e-3, 1 / 3
COMPARED = 1e-3  # smaller residuals are noise, however small those of other clusters are [m]
FRAMES = 200  # about the number of frames that are compared with two markers exchanged
FLAT = 0.05  # ratio of thickness to extent below which a cluster is planar


class ClusterFits:
    """Quality of the fits of a scene's clusters."""

    def __init__(self, limits: Limits, notes: list[str]) -> None:
        self.limits, self.notes = limits, notes
        self._worst: dict[str, float] = {}  # residual of each cluster in its worst frame, by location in the file [m]
        self._swaps: dict[str, str] = {}  # two markers of each cluster that seem to be exchanged, in words; or empty
        self._flat: list[str] = []  # planar clusters

    def take(
        self, name: str, cluster: Mapping[str, Sequence[float]], markers: MarkerTrajectories, poses: PoseSeries
    ) -> None:
        """Checks a fit, and adds a note on its quality.

        Raises InputError for a cluster of the other side, or one with too large residuals.
        """
        assert poses.residual_rms is not None
        place = np.array(list(cluster.values()))
        measured = markers.select(list(cluster)).positions
        mirrored = cluster_poses(measured, place * [1.0, -1.0, 1.0], markers.times).residual_rms
        assert mirrored is not None
        own, other = (1e3 * float(np.median(r)) for r in (poses.residual_rms, mirrored))
        if own > 1e3 * MISFIT and other < min(SHARE * own, 1e3 * MIRROR_FITS):
            raise InputError(
                f"the markers fit the cluster within {own:.1f} mm rms, and its mirror image within {other:.1f} mm",
                expected="places of the markers on this side of the body",
                remedy="measure the cluster on this knee, or change the signs of its medial-lateral coordinates",
            )
        swap = self._swaps[name] = _swap(list(cluster), measured, place) if own > 1e3 * COMPARED else ""
        frame = int(np.argmax(poses.residual_rms))
        worst = float(poses.residual_rms[frame])
        if 1e3 * worst > (most := self.limits.most_marker_residual_mm):
            where = f"frame {frame + 1} (from 1)"
            found = f"markers fit a rigid body within {1e3 * worst:.1f} mm rms in {where}: names swapped?{swap}"
            raise beyond("most_marker_residual_mm", most, found, 1e3 * worst)
        fitted = poses.positions[:, None] + np.einsum("nij,mj->nmi", poses.matrices(), place)
        each = 1e3 * np.sqrt(np.nanmean(np.sum((measured - fitted) ** 2, axis=2), axis=0))
        listed = ", ".join(f"{marker} {rms:.2f}" for marker, rms in zip(cluster, each, strict=True))
        self.notes.append(
            f"{name}: markers fit a rigid body within {1e3 * worst:.2f} mm rms; over the motion {listed} mm rms"
            + (f": names swapped?{swap}" if swap else "")
        )
        self._worst[name] = worst
        if np.linalg.svd(place - place.mean(axis=0), compute_uv=False)[2] < FLAT * np.ptp(place, axis=0).max():
            self._flat.append(name)

    def compare(self, document: Document) -> None:
        """Compares the fits with each other; adds a note on planar clusters, whose side cannot be checked.

        Raises InputError for a cluster whose fit is far worse than the others'.
        """
        most = self.limits.most_marker_residual_ratio
        for name, worst in self._worst.items():
            others = [r for n, r in self._worst.items() if n != name]
            if not others or worst < COMPARED:
                continue
            usual = max(float(np.median(others)), 1e-3 * COMPARED)
            if worst > most * usual:
                words = f"{1e3 * worst:.1f} mm rms, {worst / usual:.3g} times the other clusters': names swapped?"
                words += self._swaps[name]
                place = document.where(*name.split("."), "cluster_m")
                raise beyond(
                    "most_marker_residual_ratio", most, f"markers fit a rigid body within {words}", worst / usual, place
                )
        if self._flat:
            self.notes.append(
                f"{', '.join(self._flat)}: markers in one plane do not tell a left cluster from a right one"
            )

    def side_as_given(self, side: str) -> str:
        """A note that the side cannot be checked, for a left knee or one with planar clusters; else empty.

        Meshes, poses and attachments are equally plausible on either side; only a cluster that is not planar decides.
        """
        if len(self._worst) > len(self._flat) or (side == "right" and not self._flat):
            return ""
        return f'side = "{side}" is taken as given: nothing in the files tells a left knee from a right one'


def _swap(names: Sequence[str], measured: Floats, place: Floats) -> str:
    """The two markers of `measured` (n, m, 3) [m] whose exchange fits the places (m, 3) [m] clearly best, in words, or
    an empty text."""
    whole = measured[np.isfinite(measured).all(axis=(1, 2))]
    if not len(whole):
        return ""
    some = whole[:: max(1, len(whole) // FRAMES)]

    def residual(order: Sequence[int]) -> float:
        rms = cluster_poses(some, place[list(order)], np.arange(len(some))).residual_rms
        assert rms is not None
        return 1e3 * float(np.median(rms))

    every = range(len(place))
    orders = {(i, j): [{i: j, j: i}.get(k, k) for k in every] for i, j in combinations(every, 2)}
    fits = {pair: residual(order) for pair, order in orders.items()}
    i, j = min(fits, key=fits.__getitem__)
    if fits[i, j] >= SHARE * residual(every):
        return ""
    return f" With {names[i]} and {names[j]} exchanged they fit within {fits[i, j]:.2f} mm"
