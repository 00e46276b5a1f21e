"""Do predicted peak forces hold? `fitting.predict` by default settings, against steps of 1/32 and 1/64 ms.

    python tests/verification/predictions.py --seed 1 --scenes 50 --case 1 2 3 4

Around each of the rig's cases (contact P5) the springs vary, independently of each other: stiffness times 0.8 to 1.25
(log-uniform), slack length times 0.97 to 1.03 (uniform). Every such knee is predicted untreated and with its tibial
tuberosity 7 mm more medial. A peak contact force holds where it is within 0.5 N or 2 % of the truth, the larger of
them; the truth is known where its two runs are within a fifth of that. Exit code 1 where fewer than 95 % hold of those
that are neither flagged nor unknown, or fewer than 95 % of all.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

import fitting
import pftwin
from fitting.prediction.predicting import Fitted
from fitting.prediction.variants import grid
from pftwin.model.scene import Scene

PEAK = "peak_contact_force"
LEAST, SHARE = 0.5, 0.02  # [N], of the peak
FINE = 320, 640  # steps between two frames, 10 ms apart, of the truth
WANTED = 0.95
NAMES = tuple(
    f"{spring}.{field}" for spring in ("quadriceps", "patellar_tendon") for field in ("stiffness", "slack_length")
)


@dataclass(eq=False)
class Spread(Fitted):
    """Springs around a scene's own, as `predict` takes an estimate."""

    values: np.ndarray  # (4,)
    names: tuple[str, ...] = NAMES
    units: tuple[str, ...] = ("N/m", "m", "N/m", "m")

    @property
    def apply(self) -> Any:
        """A function of a scene and values."""
        return self.changed

    def changed(self, scene: Scene, theta: Any = None) -> Scene:
        """The scene with these springs."""
        for name, value in zip(self.names, self.values if theta is None else theta, strict=True):
            scene = scene.set(name, value)
        return scene

    def samples(self, count: int, seed: int = 0) -> np.ndarray:
        """(count, 4)."""
        random = np.random.default_rng(seed)
        stiffness = np.exp(random.uniform(np.log(0.8), np.log(1.25), (count, 2)))
        length = random.uniform(0.97, 1.03, (count, 2))
        return self.values * np.stack([stiffness[:, 0], length[:, 0], stiffness[:, 1], length[:, 1]], axis=1)


def judged(case: int, scenes: int, seed: int) -> tuple[int, int, int, int]:
    """Prints a case's line; returns how many hold, how many clean ones hold, how many are clean, and all."""
    scene = pftwin.rig.case(case, contact="P5")
    spread = Spread(np.array([float(scene.get(name)) for name in NAMES]))
    medially = grid("tibial_tuberosity_transfer", medialisation=[0.0, 0.007])
    options: dict[str, Any] = {"samples": scenes - 1, "seed": 100 * seed + case}
    began = time.perf_counter()
    found = fitting.predict(scene, medially, spread, **options)
    spent = time.perf_counter() - began
    finer, truth = (fitting.predict(scene, medially, spread, dt=1e-2 / n, **options)[PEAK].values for n in FINE)
    limit = np.maximum(LEAST, SHARE * truth)
    known = np.abs(truth - finer) <= 0.2 * limit
    off = np.abs(found[PEAK].values - truth)
    flags = found["flag"].values.tolist()
    flagged = found["failed"].values | (found["status_frames"].values[..., flags.index("inaccurate")] > 0)
    clean, holds = known & ~flagged, (off <= limit) & known
    print(
        f"case {case}: {off.size} predictions; peak force holds in {np.sum(holds)}; flagged {np.sum(flagged)};"
        f" truth not known {np.sum(~known)}; of {np.sum(clean)} others hold {np.sum(holds & clean)};"
        f" error median {np.nanmedian(off):.3f} N, 95 % below {np.nanquantile(off, 0.95):.2f} N,"
        f" largest {np.nanmax(off):.2f} N; {spent:.0f} s with compiling",
        flush=True,
    )
    return int(holds.sum()), int((holds & clean).sum()), int(clean.sum()), off.size


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(
        description="Do predicted peak forces hold? See the text at the head of this file."
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scenes", type=int, default=25, help="of each case, each with and without a treatment")
    parser.add_argument("--case", type=int, nargs="+", default=[1, 2, 3, 4])
    given = parser.parse_args()
    hold, clean_hold, clean, all_ = np.sum([judged(case, given.scenes, given.seed) for case in given.case], axis=0)
    print(f"hold: {hold} of {all_} ({100 * hold / all_:.1f} %); of the clean ones {clean_hold} of {clean}")
    return int(hold < WANTED * all_ or clean_hold < WANTED * clean)


if __name__ == "__main__":
    sys.exit(main())
