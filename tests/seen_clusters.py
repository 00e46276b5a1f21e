"""Scenes whose tibia and patella are seen through clusters of markers, the tibia's not in a plane."""

from __future__ import annotations

import json

import numpy as np
from toy_scene_files import CLUSTERS, START, changed, fixed_poses, markers_of, tibia_poses

from pftwin.files.mocap import MarkerTrajectories, write_trc

FOUR = {**CLUSTERS["tibia"], "T4": (-0.2, 0.0, 0.15)}  # not in a plane


def tibia_seen(markers: MarkerTrajectories, folder, clusters) -> str:
    """A scene whose tibia, and patella, are seen through clusters of these markers."""
    write_trc(folder / "seen.trc", markers)
    text = changed('poses = "poses.csv"', 'markers = "seen.trc"')
    parts = {k: json.dumps(v).replace('":', '" =') for k, v in clusters.items()}
    text = text.replace('[tibia]\nbody = "tibia"', f"[tibia]\ncluster_m = {parts['tibia']}")
    return text.replace("fixed = { position_m = [-0.005, 0.001, 0.05] }", f"cluster_m = {parts['patella']}")


def seen(noise: float = 0.0, tibia=FOUR):
    poses = tibia_poses()
    bodies = {"tibia": poses, "patella": fixed_poses(poses, *START)}
    markers = markers_of(bodies)
    names = [*markers.names, *(n for n in tibia if n not in markers.names)]
    extra = [
        poses.positions + np.einsum("nij,j->ni", poses.matrices(), np.asarray(tibia[n]))
        for n in tibia
        if n not in markers.names
    ]
    points = np.concatenate([markers.positions, *(e[:, None] for e in extra)], axis=1)
    rng = np.random.default_rng(0)
    return MarkerTrajectories(markers.times, tuple(names), points + noise * rng.normal(size=points.shape))


def clusters(tibia=FOUR):
    return {"tibia": tibia, "patella": CLUSTERS["patella"]}
