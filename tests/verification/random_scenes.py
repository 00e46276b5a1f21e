"""Random scenes around the rig's cases: are results with a clean status right?

    python tests/verification/random_scenes.py --seed 1 --scenes 50 --case 1 2 3 4

Each scene is one of the rig's cases (contact P5) with, independently of each other,

- stiffness of both springs times 0.7 to 1.4 (log-uniform), their slack lengths times 0.96 to 1.04 (uniform);
- damping of the springs: none in one scene of five, otherwise times 0.1 to 3 (log-uniform);
- contact stiffness: as it is in one scene of three, otherwise times 0.1 to 1000 (log-uniform);
- coefficient of restitution 0.1 to 0.95 (uniform);
- drag of the surroundings: none in one scene of three, otherwise times 0.1 to 10 (log-uniform);
- mass, and with it the moments of inertia and the weight, times 0.5 to 2 (log-uniform).

`pftwin.simulate` runs each with default settings, or with `--integrator` and `--dt`. The truth is a run of BDF2 with
steps of 1/32 ms, if one of half that step is within a fifth of the limits of it; otherwise steps are halved on, to
1/256 ms. A scene that has not converged then has no known truth (contacts that chatter): it is counted apart, and
beside it those of them that are off even so, by more than the limits and what the two finest runs are apart.

A result is off where at some frame the tracked point is more than 1 mm away from the truth, or the contact force more
than the smaller of 5 N and 20 % of the largest true force; its facets are off where that holds of the force on one of
them. A status is clean where `pftwin simulate` would end with exit code 0. Exit code 1 where a result or its facets
are off with a clean status.
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import pftwin
from pftwin.dynamics.integrator_text import integrator_from_text
from pftwin.dynamics.observe import Observation
from pftwin.dynamics.status import Status
from pftwin.model.scene import Scene

FARTHEST, MOST_FORCE, MOST_SHARE = 1e-3, 5.0, 0.2  # [m], [N], of the largest force
TOLD = (
    Status.NO_CONTACT | Status.LEFT_PATCH | Status.SNAPPED
)  # flags that leave the exit code of `pftwin simulate` at 0
FIRST, LAST = 320, 2560  # steps between two frames, 10 ms apart, of the truth
CONVERGED = 0.2  # of the limits


def drawn(rng: np.random.Generator, n: int) -> np.ndarray:
    """(n, 9) factors: see above. The coefficient of restitution itself comes seventh."""

    def log_uniform(low: float, high: float) -> np.ndarray:
        return np.exp(rng.uniform(np.log(low), np.log(high), n))

    stiffness = log_uniform(0.7, 1.4), log_uniform(0.7, 1.4)
    slack = rng.uniform(0.96, 1.04, n), rng.uniform(0.96, 1.04, n)
    tendon_damping = np.where(rng.random(n) < 1 / 5, 0.0, log_uniform(0.1, 3))
    contact = np.where(rng.random(n) < 1 / 3, 1.0, log_uniform(0.1, 1000))
    restitution = rng.uniform(0.1, 0.95, n)
    drag = np.where(rng.random(n) < 1 / 3, 0.0, log_uniform(0.1, 10))
    return np.stack([*stiffness, *slack, tendon_damping, contact, restitution, drag, log_uniform(0.5, 2)], axis=1)


def varied(scene: Scene, row: jax.Array) -> Scene:
    """The scene with a row of `drawn`."""
    k1, k2, l1, l2, damped, contact, restitution, drag, mass = row
    for name, k, length in (("quadriceps", k1, l1), ("patellar_tendon", k2, l2)):
        for field, factor in (("stiffness", k), ("slack_length", length), ("damping", damped)):
            scene = _times(scene, f"{name}.{field}", factor)
    button: Any = scene.contact
    law = button.law
    stiffer = eqx.tree_at(
        lambda e: (e.law.contact_stiffness, e.law.restitution), button, (law.contact_stiffness * contact, restitution)
    )
    scene = scene.with_effect(stiffer)
    for field in ("translational", "rotational"):
        scene = _times(scene, f"damping.{field}", drag)
    body = scene.patella
    heavier = body.mass * mass, jax.tree.map(lambda i: i * mass, body.inertia)
    scene = eqx.tree_at(lambda s: (s.patella.mass, s.patella.inertia), scene, heavier)
    return _times(scene, "gravity.mass", mass)


def _times(scene: Scene, path: str, factor: jax.Array) -> Scene:
    name, field = path.split(".")
    effect = next(e for e in scene.effects if e.name == name)
    return scene.with_effect(eqx.tree_at(lambda e: getattr(e, field), effect, getattr(effect, field) * factor))


class Course(NamedTuple):
    """What is compared, of one scene."""

    center: np.ndarray  # (n, 3) [m]
    force: np.ndarray  # (n, 3) on the patella [N]
    facets: np.ndarray  # (n, 2) [N]

    @property
    def peak(self) -> float:
        """The largest contact force [N]."""
        return float(np.linalg.norm(self.force, axis=1).max())

    def off(self, true: Course) -> np.ndarray:
        """Largest errors of place, contact force and force on a facet, in parts of what is allowed (3,)."""
        if not (np.isfinite(self.center).all() and np.isfinite(true.center).all()):
            return np.full(3, np.inf)
        allowed = min(MOST_FORCE, MOST_SHARE * true.peak)
        return np.array(
            [
                np.linalg.norm(self.center - true.center, axis=1).max() / FARTHEST,
                np.linalg.norm(self.force - true.force, axis=1).max() / allowed,
                np.abs(self.facets - true.facets).max() / allowed,
            ]
        )


def forces(scene: Scene, seen: Observation) -> dict[str, jax.Array]:
    """An outcome of a batch."""
    assert scene.contact is not None
    report = seen.effects[scene.contact.name]
    return {
        "force": jnp.stack([report[f"force_{axis}"] for axis in "xyz"], axis=-1),
        "facets": jnp.stack([report["force_medial"], report["force_lateral"]], axis=-1),
    }


def batch(scene: Scene, rows: np.ndarray, substeps: int) -> list[Course]:
    """Courses of the scenes of these rows with a step."""
    found = pftwin.simulate_batch(
        pftwin.Variants(scene, varied, rows),
        integrator=pftwin.BDF2(),
        dt=float(scene.motion.frame_interval) / substeps,
        outcome=forces,
        trajectories=True,
        care=True,  # a member whose equilibrium is not found at once starts from a relaxed state, as `simulate` does
    )
    columns = (found[name].values for name in ("sphere_center", "force", "facets"))
    return [Course(*row) for row in zip(*columns, strict=True)]


class Truth(NamedTuple):
    """What is known of a scene."""

    course: Course
    left: np.ndarray  # (3,) how far the two finest runs are apart, in parts of what is allowed

    @property
    def known(self) -> bool:
        """Whether steps are short enough for it to tell."""
        return bool((self.left <= CONVERGED).all())


def truths(scene: Scene, rows: np.ndarray) -> list[Truth]:
    """Of the scenes of these rows."""
    found = [Truth(course, np.full(3, np.inf)) for course in batch(scene, rows, FIRST)]
    n = FIRST
    while n < LAST and (open_ := [i for i, t in enumerate(found) if not t.known]):
        n *= 2
        for i, finer in zip(open_, batch(scene, rows[open_], n), strict=True):
            found[i] = Truth(finer, found[i].course.off(finer))
    return found


class Seen(NamedTuple):
    """What `simulate` gives of a scene."""

    course: Course
    clean: bool
    valid: bool
    substeps: int
    seconds: float  # for one warm run, all that it takes


def simulated(scene: Scene, rows: np.ndarray, **options) -> list[Seen]:
    """Of the scenes of these rows."""
    found = []
    for i, row in enumerate([rows[0], *rows]):
        changed = varied(scene, jnp.asarray(row))
        began = time.perf_counter()
        result = pftwin.simulate(changed, **options)
        spent = time.perf_counter() - began
        facets = np.stack([result.contact_force_medial, result.contact_force_lateral], axis=1)
        course = Course(result.center, result.contact_force, facets)
        if i > 0:  # the first one compiles
            clean, valid = not result.status & ~TOLD, result.verdict.valid
            found.append(Seen(course, clean, valid, result.settings["substeps"], spent))
    return found


def report(case: int, seen: list[Seen], true: list[Truth]) -> int:
    """Prints a case's line; returns how many are off with a clean status."""
    off = np.array([s.course.off(t.course) for s, t in zip(seen, true, strict=True)])
    left = np.array([t.left for t in true])
    known, clean = left <= CONVERGED, np.array([s.clean for s in seen])
    # Where the truth is not known, what is surely more off than allowed.
    off = np.where(known, off, off - np.where(np.isfinite(left), left, 0.0))
    wrong = off > 1
    path, force, facet = (wrong[:, k] for k in range(3))
    silent = clean & (path | force)
    silent_facets = clean & facet & ~silent
    peaks, true_peaks = (np.array([c.course.peak for c in courses]) for courses in (seen, true))
    no_peak = np.array([s.valid for s in seen]) & known[:, 1] & (np.abs(peaks - true_peaks) > 0.5 * true_peaks)
    steps, counts = np.unique([s.substeps for s in seen], return_counts=True)
    share = {n: f"{100 * np.mean(x):.0f} %" for n, x in (("path", path), ("force", force), ("facet", facet))}
    print(
        f"case {case}: {len(seen)} scenes; off: path {share['path']}, force {share['force']}, facet {share['facet']};"
        f" clean status {np.sum(clean)}, of these off: {np.sum(silent)}, on a facet alone: {np.sum(silent_facets)};"
        f" flagged though right: {np.sum(~clean & ~wrong.any(axis=1))};"
        f" valid with a largest force more than half off: {np.sum(no_peak)};"
        f" truth not known: {np.sum(~known.all(axis=1))}, clean: {np.sum(~known.all(axis=1) & clean)};"
        f" steps between frames: {dict(zip(steps.tolist(), counts.tolist(), strict=True))};"
        f" median {1e3 * np.median([s.seconds for s in seen]):.0f} ms a scene",
        flush=True,
    )
    for i in np.flatnonzero(silent | silent_facets):
        print(f"  scene {i}: clean, but off by {np.round(off[i], 2)} times what is allowed (place, force, facet);"
              f" the finest runs are apart by {np.round(left[i], 2)}")  # fmt: skip
    return int(np.sum(silent | silent_facets))


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(
        description="Are results with a clean status right? See the text at the head of this file."
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scenes", type=int, default=50, help="of each case")
    parser.add_argument("--case", type=int, nargs="+", default=[1, 2, 3, 4])
    parser.add_argument("--integrator", help="as the command line names it")
    parser.add_argument("--dt", type=float, help="longest step [s]")
    given = parser.parse_args()
    options = {} if given.dt is None else {"dt": given.dt}
    if given.integrator is not None:
        options["integrator"] = integrator_from_text(given.integrator)
    silent = 0
    for case in given.case:
        rows = drawn(np.random.default_rng([given.seed, case]), given.scenes)
        scene = pftwin.rig.case(case, contact="P5").unnamed()
        silent += report(case, simulated(scene, rows, **options), truths(scene, rows))
    print(f"off with a clean status: {silent} of {given.scenes * len(given.case)}")
    return int(silent > 0)


if __name__ == "__main__":
    sys.exit(main())
