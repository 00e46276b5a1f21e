"""Audit of a scene: how the run changes without each effect, or with an effect that the scene lacks."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any

import jax

from pftwin.base.errors import InputError
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import BDF2
from pftwin.dynamics.simulate import simulate
from pftwin.dynamics.status import status_facts
from pftwin.dynamics.trajectory import checked_integrator
from pftwin.model.scene import Scene, check
from pftwin.results.result import Result
from pftwin.results.verdict import INVALID
from pftwin.studies.audit.runs import Changes, VariantRun, compare_runs, run_alone, run_side_by_side, why_incomparable
from pftwin.studies.audit.variants import KINDS, Kind, NotApplicable, Variant, ablations, additions
from pftwin.studies.runs import Cost, run_each, time_in_turn


@dataclass(frozen=True)
class Worth:
    """Effect of one variant on the result, compared with the scene's own run."""

    name: str
    kind: Kind
    sentence: str  # description of the change
    changes: Changes | None  # None if the runs cannot be compared
    # Run time of the effect as a share of the scene's run; None if the variant ran in a batch. Columns as in `Changes`.
    cost: Annotated[float | None, "time_percent", "percent", 100, "time that it takes, of the scene's run"]
    spread: Annotated[float | None, "time_spread_percent", "percent", 100, "half of the rounds' middle half"]
    outcome: str  # how the outcome differs from the scene's own; empty if it does not
    verdict: str  # whether the effect matters, in a few words


@dataclass(frozen=True)
class Audit:
    """Comparison of all variants of a scene with the scene itself."""

    scene: str
    synthetic: bool  # whether the scene's motion is synthetic
    integrator: str
    step: float  # [s]
    tolerance: float  # of the position of the tracked point [m]
    run_time: float | None  # median time of the scene's own run [s]; None if interrupted before times were measured
    tracking: str  # description of the patella's tracking in the scene
    verdict: str  # on the scene's own motion: "valid", or "INVALID" and the reasons
    status: str
    status_frames: dict[str, int]  # number of frames with each flag
    impact: str  # how the steps resolve the contact's restitution, in words; empty without a contact law
    programs: int  # number of compiled programs, for motion and equilibrium
    rows: tuple[Worth, ...]
    not_applicable: tuple[NotApplicable, ...]
    missing: tuple[str, ...] = ()  # variants not run because of an interrupt

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C ended the audit early: the existing rows are valid, but have no times."""
        return self.run_time is None

    def to_dict(self) -> dict[str, Any]:
        """Returns plain values that can be written as JSON."""
        return asdict(self)


def audit(
    scene: Scene,
    *,
    tolerance: float = 1e-4,
    integrator: Integrator | None = None,
    dt: float | None = None,
    only: Collection[str] | None = None,
    progress: Callable[[int, int, str], None] = lambda done, of, what: None,
) -> Audit:
    """Runs the scene without each effect, with effects that it lacks, and with other inertia and steps.

    Args:
        scene: the scene to audit.
        tolerance: error of the tracked point's position above which an effect matters [m].
        integrator, dt: as in `simulate`; the default step is the one that it chooses.
        only: names of the wanted rows, which saves compiling the others; None: all.
        progress: called with the number of programs done, their total, and a label, before each and at the end.

    Returns:
        The audit. After an interrupt (Ctrl-C) it has the variants that were run, without their times.

    Raises:
        InputError: invalid parameter of the scene, tolerance, step or integrator; unknown row.
        KeyboardInterrupt: interrupted before the first variant was done.
    """
    if not tolerance > 0:
        raise InputError(f"found {tolerance!r}", where="tolerance", expected="a positive number of metres")
    check(scene)
    integrator = checked_integrator(integrator or BDF2(), "audit")
    # Limits are removed, because variants need not be plausible knees.
    listed = _selected_variants(replace(scene, limits=None), integrator, only)
    wanted = sorted((v for v in listed if isinstance(v, Variant)), key=lambda v: KINDS.index(v.kind))
    of = len(_groups(wanted)) + 3  # plus `simulate`, the scene's own run, and timing
    progress(0, of, "the scene itself")
    simulated = simulate(scene, integrator=integrator, dt=dt)
    substeps = simulated.settings["substeps"]
    progress(1, of, "the scene itself")
    own = run_alone(scene, integrator, substeps)
    runs = _runs(scene, wanted, integrator, substeps, lambda k, group: progress(2 + k, of, _spelled(group)))
    costs: list[Cost | None] = [None] * (1 + len(runs))
    if len(runs) == len(wanted):
        costs = _costs([own, *(run for _, run in runs)], lambda left: progress(of - left, of, "times, in turn"))
    most = tolerance if simulated.verdict.valid else None
    rows = (_worth(scene, v, run.result, own.result, t, most) for (v, run), t in zip(runs, costs[1:], strict=True))
    return Audit(
        scene=scene.name,
        synthetic=scene.synthetic,
        integrator=integrator.text,
        step=scene.motion.frame_interval / substeps,
        tolerance=tolerance,
        run_time=None if costs[0] is None else costs[0].seconds,
        tracking=simulated.tracking,
        verdict=simulated.verdict.describe(),
        **status_facts(simulated.flags),
        impact="" if simulated.impact is None else simulated.impact.describe(),
        programs=_programs(scene, [v for v, _ in runs], integrator),
        rows=tuple(rows),
        not_applicable=tuple(v for v in listed if isinstance(v, NotApplicable)),
        missing=tuple(v.name for v in wanted if (v.name, v.kind) not in {(ran.name, ran.kind) for ran, _ in runs}),
    )


def _selected_variants(
    scene: Scene, integrator: Integrator, only: Collection[str] | None
) -> list[Variant | NotApplicable]:
    """All variants of the scene, or those named in `only`."""
    listed = [*ablations(scene), *additions(scene, integrator)]
    if only is None:
        return listed
    names = list(dict.fromkeys(v.name for v in listed))
    if isinstance(only, str) or (unknown := [n for n in only if n not in names]):
        found = only if isinstance(only, str) else ", ".join(unknown)
        raise InputError(f"found {found!r}", where="only", expected=f"a list of some of: {', '.join(names)}")
    return [v for v in listed if v.name in only]


def _groups(wanted: list[Variant]) -> list[list[Variant]]:
    """Variants to run together: those that differ only in parameter values run in batches, the others alone."""
    alike = [v for v in wanted if v.alike]
    return [alike] * bool(alike) + [[v] for v in wanted if not v.alike]


def _spelled(group: list[Variant]) -> str:
    return group[0].name if len(group) == 1 else f"{len(group)} that differ in numbers"


def _runs(
    scene: Scene,
    wanted: list[Variant],
    integrator: Integrator,
    substeps: int,
    before: Callable[[int, list[Variant]], None],
) -> list[tuple[Variant, VariantRun]]:
    """Runs each group, in batches if its variants are alike; after Ctrl-C, returns the finished runs. Their order
    is that of `wanted`."""
    groups = _groups(wanted)

    def run(group: list[Variant]) -> list[VariantRun]:
        if group[0].alike:
            return run_side_by_side(group, integrator, substeps)
        return [run_alone(v.scene, v.integrator or integrator, v.refine * substeps) for v in group]

    answers = run_each(groups, run, before=before)
    pairs = (pair for group, runs in zip(groups, answers, strict=False) for pair in zip(group, runs, strict=True))
    place = {(v.name, v.kind): k for k, v in enumerate(wanted)}
    return sorted(pairs, key=lambda pair: place[pair[0].name, pair[0].kind])


def _programs(scene: Scene, wanted: list[Variant], integrator: Integrator) -> int:
    """Number of compiled programs: `simulate`, one per structure, integrator and step, and equilibria."""
    alone = [v for v in wanted if not v.alike]
    structures = [scene, *(v.scene for v in alone)]
    kinds = {jax.tree.structure(s.unnamed()) for s in structures}
    moving = {
        (jax.tree.structure(s.unnamed()), name, n)
        for s, name, n in [(scene, integrator, 1), *((v.scene, v.integrator or integrator, v.refine) for v in alone)]
    }
    return 1 + len(kinds) + len(moving) + (len(alone) < len(wanted))


def _costs(runs: list[VariantRun], progress: Callable[[int], None]) -> list[Cost | None]:
    """Times of the scene's own run and of all single runs, measured in turn; all None after Ctrl-C.

    `progress` is called with the number of stages left, 1 and then 0.
    """
    progress(1)
    try:
        times = iter(time_in_turn([run.rerun for run in runs if run.rerun is not None]))
    except KeyboardInterrupt:
        times = None
    progress(0)
    return [None if times is None or run.rerun is None else next(times) for run in runs]


def _worth(scene: Scene, v: Variant, result: Result, own: Result, share: Cost | None, tolerance: float | None) -> Worth:
    """Compares a variant with the scene's run; `tolerance` is None if the scene's own motion is not valid."""
    trouble = why_incomparable(result, own)
    found = None if trouble is not None else compare_runs(scene, result, own)
    outcome = trouble or _outcome(result, own)
    cost = None
    if share is not None:
        cost = 1 - share.ratio if v.kind == "left out" else share.ratio - 1
    verdict = INVALID if tolerance is None else _verdict(v.kind, found, outcome, tolerance)
    return Worth(v.name, v.kind, v.sentence, found, cost, share and share.spread, outcome, verdict)


def _outcome(result: Result, own: Result) -> str:
    """Differences of outcome: a dislocation in only one of the runs, and flags that the scene's run lacks."""
    said = []
    ours, theirs = own.dislocations(), result.dislocations()
    if ours is not None and theirs is not None and bool(ours.events) != bool(theirs.events):
        said.append("dislocates" if theirs.events else "does not dislocate")
    new = result.status & ~own.status
    return "; ".join([*said, *([new.describe()] if new else [])])


def _verdict(kind: Kind, found: Changes | None, outcome: str, tolerance: float) -> str:
    """The verdict on a variant, in a few words."""
    if found is None:
        return "indispensable" if kind == "left out" else "cannot be judged"
    matters = found.center_max > tolerance or "dislocate" in outcome
    return {
        "left out": ("worth keeping", "can be left out"),
        "added": ("worth adding", "not needed"),
        "changed": ("matters", "does not matter"),
        "yardstick": ("steps too long", "steps short enough"),
    }[kind][0 if matters else 1]
