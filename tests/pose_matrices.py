"""Poses as 4 x 4 matrices, and files of them as OpenSim JAM writes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

FRAMES = 7


def matrices(seed: int) -> np.ndarray:
    """(n, 4, 4): a body that turns and moves."""
    random = np.random.default_rng(seed)
    found = np.tile(np.eye(4), (FRAMES, 1, 1))
    found[:, :3, :3] = Rotation.random(FRAMES, rng=random).as_matrix()
    found[:, :3, 3] = random.normal(0.1, 0.3, (FRAMES, 3))
    return found


def written(path: Path, bodies: dict[str, np.ndarray], times: np.ndarray | None = None, **header: object) -> Path:
    """As OpenSim JAM does, each matrix row by row."""
    times = 0.02 * np.arange(FRAMES) if times is None else times
    labels = [f"{body}_T{i}{j}" for body in bodies for i in (1, 2, 3, 4) for j in (1, 2, 3, 4)]
    fields = {"nRows": len(times), "nColumns": 1 + len(labels), **header}
    rows = np.column_stack([times, *(m.reshape(len(times), 16) for m in bodies.values())])
    lines = ["poses", *(f"{key}={value}" for key, value in fields.items()), "endheader", "\t".join(["time", *labels])]
    path.write_text("\n".join([*lines, *("\t".join(f"{v:.17g}" for v in row) for row in rows)]) + "\n")
    return path
