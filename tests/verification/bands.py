"""How often do bands of a prediction hold what a plant does, on plants of the rig that the twin does not know?

    python tests/verification/bands.py PLANTS --seeds 13 15 17 --method simulations --use position quadriceps

Each plant (`coverage.py`) runs case 2, to which the twin is fitted, and case 1, whose tuberosity is elsewhere. The twin
of case 1, with draws from the fit, predicts the outcomes below, and the plant's own motion tells them. Printed by
outcome: how many 90 % bands contain the plant's, their mean half width and the mean error of their middles.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from coverage import How, drawn_plant, fitted, recorded, scene_in
from numpy.typing import NDArray
from scipy.ndimage import median_filter

import fitting
import pftwin
from pftwin.base.rotations import patellar_angles
from pftwin.base.spatial import Quaternion

FITTED, PREDICTED = 2, 1  # cases
BAND = (0.05, 0.95)
OUTCOMES = {"mean_tilt": "deg", "mean_shift": "m", "mean_contact_force": "N", "peak_contact_force": "N"}


def outcomes_of(seen: dict[str, NDArray]) -> dict[str, float]:
    """What a plant's motion (`Plant.seen`) comes to, as `fitting.prediction.outcomes` counts it."""
    tilt = np.degrees(np.asarray(patellar_angles(Quaternion(*seen["quaternion"].T)).tilt))
    force = median_filter(seen["contact"], 5, mode="nearest")
    return {
        "mean_tilt": float(tilt.mean()),
        "mean_shift": float(seen["position"][:, 1].mean()),
        "mean_contact_force": float(force.mean()),
        "peak_contact_force": float(force.max()),
    }


def truth_in(case: int, seed: int, folder: Path) -> dict[str, float]:
    """Of a plant, kept beside its recording."""
    place = recorded(case, seed, folder)[0] / "outcomes.json"
    if not place.exists():
        plant, times = drawn_plant(case, seed)
        place.write_text(json.dumps(outcomes_of(plant.seen(times, plant.motion(times)[0]))))
    return json.loads(place.read_text())


def main() -> None:
    """Fits, predicts, prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("plants", type=Path, help="folder of the recordings")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--contact", default="spline")
    parser.add_argument("--nuisance", default="rig")
    parser.add_argument("--use", nargs="+", default=["position"])
    parser.add_argument("--method", default="simulations")
    parser.add_argument("--samples", type=int, default=200)
    given = parser.parse_args()
    pftwin.configure()
    rows: dict[str, list[tuple[bool, float, float]]] = {name: [] for name in OUTCOMES}
    for seed in given.seeds:
        truth = truth_in(PREDICTED, seed, given.plants)
        how = How(given.contact, given.nuisance, tuple(given.use), given.method)
        found = fitted([FITTED], seed, given.plants, how)
        other = scene_in(PREDICTED, recorded(PREDICTED, seed, given.plants)[0], how)
        seen: Any = fitting.predict(other, None, found, samples=given.samples)
        texts = []
        for name, unit in OUTCOMES.items():
            values = np.asarray(seen[name]).ravel()[1:]
            values = values[np.isfinite(values)]
            low, high = np.quantile(values, BAND)
            rows[name].append((bool(low < truth[name] < high), 0.5 * (high - low), 0.5 * (low + high) - truth[name]))
            texts.append(f"{name} {truth[name]:.4g} in {low:.4g} to {high:.4g} {unit} ({len(values)})")
        print(f"seed {seed}: {'; '.join(texts)}", flush=True)
    for name, unit in OUTCOMES.items():
        inside, half, off = (np.array(column, dtype=float) for column in zip(*rows[name], strict=True))
        print(
            f"{name}: {inside.sum():.0f} of {inside.size} contain it; half width {half.mean():.3g}, "
            f"off {off.mean():.3g} {unit}"
        )


if __name__ == "__main__":
    main()
