"""What inertia is worth, and what leaving it out saves: `quasi_static` against the dynamics, at several speeds.

    python -m tests.benchmarks.without_inertia docs/benchmarks/without_inertia.json

The rig's motions are run through faster and slower. Where the two paths are 0.1 mm apart, rms, inertia begins to count.
"""

from __future__ import annotations

import itertools
import json
import sys
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from pftwin.dynamics.integrator_text import integrator_from_text

SPEEDS = (0.125, 0.25, 0.5, 1.0, 2.0)  # of the recorded one
COUNTS_MM = 0.1
LEVEL = "0.01 mm"  # of both runs whose times are compared
SETTINGS = (("P5", 1), ("P5", 2), ("P5", 4), ("CM", 1))


class Point(NamedTuple):
    """One speed."""

    speed: float
    apart_mm: float  # rms over the frames
    most_mm: float
    snaps: int
    runs_s: dict[str, float]  # by integrator
    steps_ms: dict[str, float]


def compare(contact: str, case: int, speed: float) -> Point:
    """Both integrators on one motion, each with the step that holds the level of error."""
    import pftwin
    from pftwin.dynamics.status import Status

    scene = pftwin.rig.case(case, contact=contact)
    scene = eqx.tree_at(lambda s: s.motion, scene, scene.motion.at_speed(speed))
    runs = {name: pftwin.simulate(scene, integrator=integrator_from_text(name), tolerance=LEVEL) for name in NAMES}
    for name, run in runs.items():  # once more, warm
        again = pftwin.simulate(scene, integrator=integrator_from_text(name), dt=run.settings["dt_s"])
        for _ in range(3):
            again = min(
                again,
                pftwin.simulate(scene, integrator=integrator_from_text(name), dt=run.settings["dt_s"]),
                key=lambda r: r.timing["run_s"],
            )
        run.timing["run_s"] = again.timing["run_s"]
    apart = 1e3 * np.linalg.norm(runs[NAMES[0]].center - runs[NAMES[1]].center, axis=1)
    return Point(
        speed,
        float(np.sqrt(np.mean(apart**2))),
        float(apart.max()),
        int(np.count_nonzero(runs["quasi_static"].flags & Status.SNAPPED)),
        {name: run.timing["run_s"] for name, run in runs.items()},
        {name: 1e3 * run.settings["dt_s"] for name, run in runs.items()},
    )


NAMES = ("quasi_static", "linear_implicit_bdf2")


def speed_that_counts(points: list[Point]) -> float | None:
    """Where the distance reaches `COUNTS_MM`, between two speeds by a power law; None outside of all."""
    for one, two in itertools.pairwise(points):
        if one.apart_mm <= COUNTS_MM < two.apart_mm:
            share = np.log(COUNTS_MM / one.apart_mm) / np.log(two.apart_mm / one.apart_mm)
            return float(one.speed * (two.speed / one.speed) ** share)
    return None


def main(target: Path) -> None:
    """Measures, prints a table and writes everything as JSON."""
    import pftwin

    pftwin.configure()
    from pftwin.base.output import written_whole
    from pftwin.base.runtime import describe

    found: dict[str, Any] = {"machine": describe(), "level": LEVEL, "counts_mm": COUNTS_MM, "scenes": []}
    sys.stdout.write(
        "| scene | speed | apart rms (max), mm | snaps | ms per run (step, ms): quasi_static | dynamic |\n"
    )
    sys.stdout.write("|---|---|---|---|---|---|\n")
    for contact, case in SETTINGS:
        points = [compare(contact, case, s) for s in SPEEDS]
        limit = speed_that_counts(points)
        found["scenes"].append(
            {"contact": contact, "case": case, "limit": limit, "points": [p._asdict() for p in points]}
        )
        for p in points:
            cells = [f"{1e3 * p.runs_s[n]:.3g} ({p.steps_ms[n]:.3g})" for n in NAMES]
            sys.stdout.write(
                f"| case {case}, {contact} | {p.speed:g} | {p.apart_mm:.3g} ({p.most_mm:.3g}) | {p.snaps} |"
                f" {' | '.join(cells)} |\n"
            )
        sys.stdout.write(f"0.1 mm at {'no speed tried' if limit is None else f'{limit:.2f} of the recorded speed'}\n")
    with written_whole(target) as temporary:
        temporary.write_text(json.dumps(found, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
