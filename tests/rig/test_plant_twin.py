"""The plant and the twin, two codes of the same equations, agree where both have them; and the plant made the files."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pftwin
from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Pose, Quaternion
from pftwin.files.mocap import read_csv, read_trc
from pftwin.files.mocap.poses import PoseSeries
from pftwin.geometry.patch.implant import rig_implant
from pftwin.model.effects.contact_law import HuntCrossley
from pftwin.model.effects.sphere_contact import SphereContact
from pftwin.model.motion import KneeMotion
from pftwin.model.scene import Scene
from pftwin.rig import geometry as rig
from pftwin.rig.cases import effects, patella_body
from pftwin.rig.recording import data_folder
from tests.verification.rig_plant.hand import hand_motion
from tests.verification.rig_plant.laboratory import FORCE_NOISE, MARKER_NOISE, record
from tests.verification.rig_plant.mechanics import DISSIPATION, START, built_springs, plant_of

pytestmark = pytest.mark.slow
FRAMES = 121  # of case 1: rest, then half of the first flexion


def twin_scene() -> Scene:
    """Case 1 on the true implant, with linear springs where they should be and without friction."""
    surface = jax.tree.map(lambda a: number(a) if isinstance(a, float) else a, rig_implant())
    law = HuntCrossley(number(rig.CONTACT_STIFFNESS), number(DISSIPATION))
    contact = SphereContact(surface, law, vector((0.0, 0.0, 0.0)), number(rig.BUTTON_RADIUS))
    femur, tibia = (PoseSeries(p.times[:FRAMES], p.positions[:FRAMES], p.quaternions[:FRAMES]) for p in hand_motion(1))
    start = Pose(vector(tuple(START)), Quaternion.identity())
    return Scene(patella_body(), effects(rig.CASES[1], contact), KneeMotion.from_poses(femur, tibia), start, "case 1")


def test_both_codes_agree_on_a_motion_of_the_same_knee():
    """To two nanometres and a tenth of a millinewton, with both facets touched."""
    plant, times = plant_of(1)
    plant = replace(plant, springs=built_springs(rig.CASES[1], 0.0, 0.0), drag=rig.DRAG, friction=0.0)
    states, _ = plant.motion(times[: FRAMES - 1])
    true = plant.seen(times[: FRAMES - 1], states)
    path = eqx.filter_jit(lambda s: pftwin.trajectory(s, integrator=pftwin.BDF2(), dt=1e-3 / 16))(twin_scene())
    seen = jax.tree.map(
        lambda a: np.asarray(a)[: FRAMES - 1], (path.position.array(), path.patella.orientation.array())
    )
    assert np.ptp(true["position"], axis=0).max() > 5e-3
    assert np.linalg.norm(seen[0] - true["position"], axis=1).max() < 2e-9
    turns = (Rotation.from_quat(q, scalar_first=True) for q in (seen[1], true["quaternion"]))
    assert (next(turns).inv() * next(turns)).magnitude().max() < 1e-8
    for name, spring in (("quadriceps", "femoral_spring"), ("patellar_tendon", "tibial_spring")):
        assert np.abs(np.asarray(path.tensions[name])[: FRAMES - 1] - true[spring]).max() < 5e-6
    force = np.asarray(path.contact_force_medial + path.contact_force_lateral)[: FRAMES - 1]
    assert np.abs(force - true["contact"]).max() < 1e-4


def test_the_plant_reproduces_the_recording_of_a_case_that_dislocates(tmp_path):
    """Made by an earlier plant, the files come out again, noise and all, to a tenth of that noise."""
    record(2, tmp_path)
    markers, forces = (
        [read(folder / f"case2_{name}") for folder in (tmp_path, data_folder())]
        for read, name in ((read_trc, "markers.trc"), (read_csv, "forces.csv"))
    )
    assert np.abs(markers[0].positions - markers[1].positions).max() < 0.1 * MARKER_NOISE
    for name in ("contact", "tibial_spring", "femoral_spring"):
        off = forces[0].column(name) - forces[1].column(name)
        assert np.sqrt(np.mean(off**2)) < 0.1 * FORCE_NOISE
