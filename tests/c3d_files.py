"""C3D files for tests, written by ezc3d."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np


def write_c3d(
    path: Path,
    points: np.ndarray,
    labels: Sequence[str],
    *,
    units: str | None = "mm",
    residuals: np.ndarray | None = None,
    rate: float = 100.0,
    first: int = 0,
    channels: Mapping[str, tuple[str, np.ndarray]] | None = None,
    form: str = "",
) -> Path:
    """Points (n, m, 3) at `rate` from frame `first` on; channels {label: (unit, samples)} at a multiple of that rate.

    Channel i (from 1) is scaled by 0.5^i; `form` is their ANALOG:FORMAT.
    """
    import ezc3d

    file = ezc3d.c3d()
    data = np.ones((4, points.shape[1], points.shape[0]))
    data[:3] = points.transpose(2, 1, 0)
    file["header"]["points"]["first_frame"] = first
    point, analog = file["parameters"]["POINT"], file["parameters"]["ANALOG"]
    point["RATE"]["value"], point["LABELS"]["value"] = [rate], tuple(labels)
    if units is not None:
        point["UNITS"]["value"] = [units]
    file["data"]["points"] = data
    if residuals is not None:
        file["data"]["meta_points"]["residuals"] = residuals
    if channels:
        samples = np.stack([values for _, values in channels.values()])
        analog["RATE"]["value"] = [rate * samples.shape[1] / points.shape[0]]
        analog["LABELS"]["value"], analog["UNITS"]["value"] = tuple(channels), tuple(u for u, _ in channels.values())
        analog["SCALE"]["value"] = 0.5 ** np.arange(1, len(channels) + 1)
        analog["OFFSET"]["value"] = np.zeros(len(channels), int)
        if form:
            analog["FORMAT"]["value"] = [form]
        file["data"]["analogs"] = samples[None]
    file.write(str(path))
    return path
