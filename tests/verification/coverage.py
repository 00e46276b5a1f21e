"""How often do the intervals of a fit contain the truth, on plants of the rig that the twin does not know?

    python tests/verification/coverage.py PLANTS --seeds 1 3 5 7 --nuisance none rig --use position quadriceps
    python tests/verification/coverage.py PLANTS --seeds 13 15 --nuisance rig --method simulations
    python tests/verification/coverage.py PLANTS --seeds 13 15 --nuisance rig oracle --method trained

Each plant (`rig_plant`, code of its own) has, drawn by its seed:

- stiffness of both springs times 0.85 to 1.15, slack lengths times 0.98 to 1.02 (uniform);
- stiffening by 0 to 10 % when stretched by a quarter of the length (uniform);
- attachments off by 0.6 mm, standard deviation of each coordinate;
- a coefficient of friction from 0.005 to 0.04 (uniform), by another law than the twin's; drag times 0.8 to 1.2.

It runs a case, and the laboratory records it: markers and load cells with their noise, files, filters, poses of the
segments. PLANTS is a folder in which recordings are kept: a plant takes a minute. Then the twin, with its nominal
numbers, is fitted; or a posterior answers that was trained once, on the recording that the package has of the case. The
truth of K and L is the straight line nearest to the plant's spring over the forces that occurred, the mean of those of
several cases. The nuisance "oracle" is the distribution of these plants' own. Printed by parameter: root mean square
error, how many 95 % intervals contain the truth, and their mean half width, all in per cent; and estimates that are
INVALID, which are counted too. Refused ones are told and left out.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

import fitting
import pftwin
from fitting.demo.straight_springs import straight_line, stretch_under
from fitting.nuisance import SLIP_SPEED
from pftwin.base.errors import PftwinError
from pftwin.files.mocap.poses import PoseSeries
from pftwin.model.effects.friction import Friction
from pftwin.model.motion import KneeMotion
from pftwin.model.scene import Scene
from pftwin.rig import geometry as rig
from pftwin.rig.cases import scene_of
from pftwin.rig.contacts import contact_effect
from pftwin.rig.recording import Recording, read_recording
from tests.verification.rig_plant.laboratory import write_recording
from tests.verification.rig_plant.mechanics import DRAG, Plant, plant_of
from tests.verification.rig_plant.plant_parts import Spring

NAMES = ("K1", "L1", "K2", "L2")
MEASURED = ("times", "center", "quaternion", "contact_force", "tibial_spring_force", "femoral_spring_force")
BOUNDS = {"K1": 0.5, "L1": 0.3, "K2": 0.5, "L2": 0.3}
FRICTION, STIFFENING, DRAG_OFF = (0.005, 0.04), 0.1, 0.2  # of plants: from least to most; at most; a share
ORACLE = fitting.Nuisance(
    attachments=rig.MISPLACED,
    friction=float(np.ptp(FRICTION)) / np.sqrt(12),
    damping=2 * DRAG_OFF / np.sqrt(12),
    stiffening=STIFFENING,
)


def drawn_plant(case: int, seed: int) -> tuple[Plant, NDArray]:
    """A plant, and the times of the rig's frames [s]."""
    random = np.random.default_rng([seed, 24])
    plant, times = plant_of(case)
    drag = tuple(c * random.uniform(1 - DRAG_OFF, 1 + DRAG_OFF) for c in DRAG)
    friction, stiffening = random.uniform(*FRICTION), random.uniform(0.0, STIFFENING)

    def spring(old: Spring, place: tuple[float, float, float], along: int) -> Spring:
        stiffness, length = old.stiffness * random.uniform(0.85, 1.15), old.slack_length * random.uniform(0.98, 1.02)
        insertion = np.array([along * rig.INSERTION[0], 0.0, rig.INSERTION[2]]) - np.array(rig.CENTER_OF_MASS)
        end, origin = (np.array(p) + random.normal(0.0, rig.MISPLACED, 3) for p in (insertion, place))
        return Spring(stiffness, length, rig.DAMPING_TIME * stiffness, end, origin, stiffening)

    built = rig.CASES[case]
    femur, tibia = rig.MEDIAL_LATERAL[built.femur_support], rig.MEDIAL_LATERAL[built.tibia_support]
    springs = (
        spring(plant.springs[0], (rig.FEMUR_SUPPORT[0], femur, rig.FEMUR_SUPPORT[1]), 1),
        spring(plant.springs[1], (rig.TIBIA_SUPPORT[0], tibia, rig.TIBIA_SUPPORT[1]), -1),
    )
    return replace(plant, springs=springs, drag=drag, friction=friction), times


def truth_of(plant: Plant, seen: dict[str, NDArray]) -> list[float]:
    """K1, L1, K2, L2 of the straight lines nearest to the plant's springs over the forces that occurred."""
    found = []
    for spring, name in zip(plant.springs, ("femoral_spring", "tibial_spring"), strict=True):
        stretch = stretch_under(seen[name], spring.stiffness, spring.slack_length, spring.stiffening)
        line = straight_line(spring.slack_length + stretch, seen[name])
        found += [line.stiffness, line.slack_length]
    return found


def recorded(case: int, seed: int, folder: Path) -> tuple[Path, NDArray]:
    """The folder with a plant's recording, made if it is not there yet, and the truth."""
    place = folder / f"case{case}_seed{seed}"
    if not (place / "truth.json").exists():
        place.mkdir(parents=True, exist_ok=True)
        plant, times = drawn_plant(case, seed)
        seen = plant.seen(times, plant.motion(times)[0])
        write_recording(case, seen, np.random.default_rng([seed, 25]), place)
        (place / "truth.json").write_text(json.dumps(truth_of(plant, seen)))
    return place, np.array(json.loads((place / "truth.json").read_text()))


class How(NamedTuple):
    """How plants are fitted."""

    contact: str = "spline"
    nuisance: str | None = None
    use: tuple[str, ...] = ("position",)
    method: str = "least_squares"
    simulations: int | None = None  # of a posterior that is trained
    until: float = np.inf  # what was recorded later is left out [s]

    @property
    def taken(self) -> str | fitting.Nuisance | None:
        """The nuisance."""
        return ORACLE if self.nuisance == "oracle" else self.nuisance


def scene_in(case: int, place: Path | None, how: How) -> Scene:
    """The twin in the motion that was recorded in a folder, or by the package, with what was measured of it."""
    data = read_recording(case, place)
    n = int(np.searchsorted(data.measured.times, how.until, side="right"))
    femur, tibia, patella = (
        PoseSeries(p.times[:n], p.positions[:n], p.quaternions[:n]) for p in (data.femur, data.tibia, data.patella)
    )
    kept = {name: getattr(data.measured, name)[:n] for name in MEASURED}
    whole = Recording(femur, tibia, patella, replace(data.measured, **kept))
    name = f"case {case} of {'the package' if place is None else place.name}, {how.contact}"
    motion = KneeMotion.from_poses(femur, tibia)
    return scene_of(case, whole, motion, contact_effect(how.contact, chart="plane"), name)


def fitted(cases: list[int], seed: int, folder: Path, how: How) -> fitting.Estimate:
    """The twin fitted to a plant's recordings of some cases together."""
    scenes = prepared([scene_in(case, recorded(case, seed, folder)[0], how) for case in cases], how)
    if how.method == "trained":
        return trained(tuple(cases), how).estimate(scenes)
    asked: dict[str, Any] = {"free": NAMES, "bounds": BOUNDS, "nuisance": how.taken, "use": how.use}
    return fitting.fit_tendons(scenes, method=how.method, **asked)


@cache
def trained(cases: tuple[int, ...], how: How) -> fitting.TrainedPosterior:
    """A posterior trained on the recordings that the package has of these cases."""
    scenes = prepared([scene_in(case, None, how) for case in cases], how)
    asked: dict[str, Any] = {"free": NAMES, "bounds": BOUNDS, "nuisance": how.taken, "use": how.use}
    return fitting.train_posterior(scenes, simulations=how.simulations, **asked)


def prepared(scenes: list[Scene], how: How) -> list[Scene]:
    """For an oracle, with the mean of the plants' friction: a prior's mean is the scene's."""
    if how.nuisance != "oracle":
        return scenes
    rough = Friction(jnp.asarray(np.mean(FRICTION)), jnp.asarray(SLIP_SPEED))
    found = []
    for scene in scenes:
        assert scene.contact is not None, scene.name
        found.append(scene.with_effect(scene.contact.with_friction(rough)))
    return found


def main() -> None:
    """Makes plants, fits the twin to them, prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("plants", type=Path, help="folder of the recordings")
    parser.add_argument("--case", type=int, nargs="+", default=[2], help="several are fitted together")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--contact", default="spline")
    parser.add_argument("--nuisance", nargs="+", default=["none", "rig"], help="none, oracle, or as `pftwin fit`")
    parser.add_argument("--use", nargs="+", default=["position"])
    parser.add_argument("--method", default="least_squares")
    parser.add_argument("--simulations", type=int, help="of each posterior that is trained; by default 30,000")
    parser.add_argument("--until", type=float, default=np.inf, help="leave out what was recorded later [s]")
    parser.add_argument("--only-plants", action="store_true")
    given = parser.parse_args()
    pftwin.configure()
    rows: dict[str, list[tuple[NDArray, NDArray, NDArray, float, bool]]] = {nuisance: [] for nuisance in given.nuisance}
    for seed in given.seeds:
        began = time.perf_counter()
        truth = np.mean([recorded(case, seed, given.plants)[1] for case in given.case], axis=0)
        print(
            f"seed {seed}: plant {time.perf_counter() - began:.0f} s, truth {np.round(truth, 4).tolist()}", flush=True
        )
        if given.only_plants:
            continue
        for nuisance in given.nuisance:
            began = time.perf_counter()
            how = How(given.contact, nuisance, tuple(given.use), given.method, given.simulations, given.until)
            how = how._replace(nuisance=None if nuisance == "none" else nuisance)
            try:
                found = fitted(given.case, seed, given.plants, how)
            except PftwinError as error:
                print(f"  {nuisance}: refused: {error}", flush=True)
                continue
            off, ends = found.values[:4] / truth - 1, found.intervals[:4]
            half, inside = 0.5 * np.diff(ends)[:, 0] / truth, (ends[:, 0] < truth) & (truth < ends[:, 1])
            rows[nuisance].append((off, half, inside, found.rmse["position"], found.invalid))
            texts = [f"{100 * o:+.2f} (+-{100 * h:.2f})" for o, h in zip(off, half, strict=True)]
            others = {n: float(f"{v:.3g}") for n, v in zip(found.names[4:], found.values[4:], strict=True)}
            left = f"{1e3 * found.rmse['position']:.3f} mm, {time.perf_counter() - began:.0f} s, {found.reason}"
            print(
                f"  {nuisance}: {', '.join(texts)} %; {int(inside.sum())} of {inside.size} contain the truth; "
                f"{left}; {others}",
                flush=True,
            )
            if found.invalid:
                print(f"  {found.sentence()}", flush=True)
    for nuisance, found in rows.items():
        if found:
            off, half, inside, left, invalid = (np.array(column) for column in zip(*found, strict=True))
            share = 100 * inside.mean(axis=0)
            rms, width = 100 * np.sqrt((off**2).mean(axis=0)), 100 * half.mean(axis=0)
            print(
                f"{nuisance}, {len(off)} plants: rms error {np.round(rms, 2)} %, "
                f"coverage {share} %: {share.mean():.0f} %"
            )
            more = f"left of the position {1e3 * left.mean():.3f} mm; {invalid.sum()} INVALID"
            print(f"  half width {np.round(width, 2)} %; {more}")


if __name__ == "__main__":
    main()
