"""What a scene's step costs as effects are added: equations, and time along the path of case 1.

Times are taken at the states of a run with contact, frame by frame, so that scenes without one are timed where a
patella is, not where it would fall; on a CPU they are its own time.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from pftwin.dynamics.integrators import LinearImplicit
from pftwin.dynamics.simulate import settle_first_frame
from pftwin.dynamics.state import State
from pftwin.model.effects.tendon import StrandGroup
from pftwin.model.scene import Scene
from pftwin.studies.audit.account import account, equations, through_frames
from pftwin.studies.runs import time_in_turn
from tests.benchmarks.row import Row

TOPIC = "growth"
STRANDS = 30
SUBSTEPS = 10  # of 10 ms
INTEGRATOR = LinearImplicit()


def rows(*, meshes: tuple[str, ...] = ("volume",)) -> list[Row]:
    """Equations and time of a step of growing scenes.

    Args:
        meshes: contacts of the rig that take the patch's place in the last scenes.
    """
    from pftwin import rig

    whole = rig.case(1, contact="P5")
    path = _path(whole)
    scenes = {**_growing(whole), **{f"{name} in the patch's place": rig.case(1, contact=name) for name in meshes}}
    runs = []
    for name, scene in scenes.items():
        states = _path(scene) if name.split()[0] in meshes else _seen_by(scene, whole, path)
        runs.append(partial(through_frames, scene.unnamed(), states, INTEGRATOR, SUBSTEPS))
    steps = SUBSTEPS * (whole.motion.n_frames - 1)
    out, before = [], None
    for (name, scene), share in zip(scenes.items(), time_in_turn(runs), strict=True):
        count = equations(scene, INTEGRATOR)
        more = "" if before is None or name.split()[0] in meshes else f", {count - before:+d}"
        details = {"equations": count, "to_the_first": share.ratio, "spread": share.spread}
        note = f"{count} equations{more}; {share.ratio:.2f} times the first"
        out.append(Row(TOPIC, f"a step: {name}", 1e6 * share.seconds / steps, "us", note=note, details=details))
        before = count
    return out


def _path(scene: Scene) -> State:
    """States of the scene's own run at the frames."""
    plain = scene.unnamed()
    return account(plain, settle_first_frame(plain)[0].answer, INTEGRATOR, SUBSTEPS).states


def _growing(whole: Scene) -> dict[str, Scene]:
    """From weight alone to the rig's whole scene, one effect more each time."""
    one = whole.without("contact").without("damping").without("quadriceps")
    two = one.with_effect(whole.effect("quadriceps"))
    strung = two.with_effect(strands(whole))
    touching = strung.with_effect(whole.effect("contact"))
    return {
        "weight": one.without("patellar_tendon"),
        "and one tendon": one,
        "and two": two,
        f"and {STRANDS} strands": strung,
        "and contact with a patch": touching,
        "and damping": touching.with_effect(whole.effect("damping")),
    }


def strands(scene: Scene) -> StrandGroup:
    """Both retinacula as one group, every strand split in three."""
    from pftwin.rig import with_retinacula

    both = [e for e in with_retinacula(scene).effects if isinstance(e, StrandGroup)]
    copies = STRANDS // sum(e.stiffness.shape[0] for e in both)
    group: Any = jax.tree.map(lambda *a: jnp.tile(jnp.concatenate(a), copies), *(_arrays(e) for e in both))
    return eqx.tree_at(lambda g: g.stiffness, group, group.stiffness / copies)


def _arrays(group: StrandGroup) -> StrandGroup:
    """The group's arrays under one name, so that groups can be joined."""
    return StrandGroup(
        group.stiffness, group.slack_length, group.toe_strain, group.damping_time, group.insertion, group.origin,
        group.body, name="strands",
    )  # fmt: skip


def _seen_by(scene: Scene, whole: Scene, path: State) -> State:
    """The path's states with the memories of those effects that the scene has."""
    memories = {e.name: m for e, m in zip(whole.effects, path.memories, strict=True)}
    own = tuple(memories.get(e.name) for e in scene.effects)
    return State(path.position, path.orientation, path.velocity, path.spin, own, path.solver_state)
