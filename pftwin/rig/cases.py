"""Scenes and measurements of the rig's four cases, from the recordings in `data/`."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
from jax.dtypes import canonicalize_dtype

from pftwin.base.errors import InputError
from pftwin.base.leaves import number, vector
from pftwin.base.output import written_whole
from pftwin.base.program_cache import cached
from pftwin.base.spatial import Pose, Quaternion
from pftwin.model.effects.base import Effect
from pftwin.model.effects.damping import LinearDamping
from pftwin.model.effects.gravity import Gravity
from pftwin.model.effects.tendon import Tendon
from pftwin.model.measured import Measured
from pftwin.model.motion import KneeMotion
from pftwin.model.scene import PatellaBody, Scene
from pftwin.rig import geometry as rig
from pftwin.rig.contacts import contact_effect
from pftwin.rig.recording import IMPLANT_FILE, Recording, data_folder, read_recording, recording_files


def _case_number(n: int) -> int:
    if n not in rig.CASES:
        raise InputError(f"no case {n!r} of the rig", where="case", expected="1, 2, 3 or 4")
    return int(n)


def springs(case: rig.RigCase) -> tuple[Tendon, Tendon]:
    """Returns quadriceps and patellar tendon of a case."""

    def spring(name: str, body: str, along: int, stiffness: float, length: float, place: tuple, side: str) -> Tendon:
        insertion = vector((along * rig.INSERTION[0], 0.0, rig.INSERTION[2]))
        support = vector((place[0], rig.MEDIAL_LATERAL[side], place[1]))
        damping = number(rig.DAMPING_TIME * stiffness)
        return Tendon(number(stiffness), number(length), damping, insertion, support, body, name=name)

    k1, k2 = rig.QUADRICEPS_STIFFNESS, rig.PATELLAR_TENDON_STIFFNESS
    return (
        spring("quadriceps", "femur", 1, k1, case.quadriceps_length, rig.FEMUR_SUPPORT, case.femur_support),
        spring("patellar_tendon", "tibia", -1, k2, rig.PATELLAR_TENDON_LENGTH, rig.TIBIA_SUPPORT, case.tibia_support),
    )


def effects(case: rig.RigCase, contact: Effect) -> tuple[Effect, ...]:
    """Returns the effects that act on the patella."""
    return (
        Gravity(number(rig.MASS), vector(rig.GRAVITY)),
        *springs(case),
        contact,
        LinearDamping(*(number(c) for c in rig.DRAG), body="femur"),
    )


def patella_body() -> PatellaBody:
    """Returns the patella with its button."""
    return PatellaBody(number(rig.MASS), vector(rig.INERTIA), vector(rig.CENTER_OF_MASS))


def recording(n: int) -> Recording:
    """Returns the virtual laboratory's recording of a case (synthetic), read and filtered like user files."""
    return _recorded(_case_number(n), canonicalize_dtype(float) == np.float64)[0]


@lru_cache(maxsize=8)
def _recorded(n: int, float64: bool) -> tuple[Recording, KneeMotion]:
    return cached(_read, n, float64, files=recording_files(n))


def _read(n: int, float64: bool) -> tuple[Recording, KneeMotion]:
    recorded = read_recording(n)
    return recorded, KneeMotion.from_poses(recorded.femur, recorded.tibia)


def case(n: int, contact: str = "P5", *, chart: Literal["plane", "cylinder"] = "plane") -> Scene:
    """Returns the scene of one of the rig's four cases.

    Args:
        n: 1 to 4. In cases 1 and 4 the patella tracks normally; in 2 and 3 it dislocates in full extension.
        contact: a name from `pftwin.rig.contacts`: a polynomial "P2", "P4", "P5" or of any other degree, "spline", the
            paper's meshes "CM" and "FM", or "volume".
        chart: chart of the surface patch: "plane", as in the paper, or "cylinder".

    Raises:
        InputError: unknown case, contact or chart.
    """
    touches = contact_effect(contact, chart=chart)
    n = _case_number(n)
    recorded, motion = _recorded(n, canonicalize_dtype(float) == np.float64)
    return scene_of(n, recorded, motion, touches, f"rig case {n}, {contact}")


def scene_of(n: int, recorded: Recording, motion: KneeMotion, touches: Effect, name: str) -> Scene:
    """Returns the twin of a case, with nominal springs and the recorded motion."""
    first = recorded.patella
    start = Pose(vector(tuple(first.positions[0])), Quaternion(*(number(v) for v in np.asarray(first.quaternions[0]))))
    acting = effects(rig.CASES[n], touches)
    return Scene(patella_body(), acting, motion, start, name, synthetic=True, measured=recorded.measured)


def measured(n: int) -> Measured:
    """Returns the virtual laboratory's measurements of a case, which are synthetic.

    Raises:
        InputError: unknown case.
    """
    return recording(n).measured


def write_files(n: int, folder: Path) -> list[Path]:
    """Writes a case's laboratory files to a folder: markers, forces and the implant's mesh. Returns their paths.

    Raises:
        InputError: unknown case.
        OutputError: a file cannot be written.
    """
    written = []
    for source in (*recording_files(_case_number(n)), data_folder() / IMPLANT_FILE):
        target = Path(folder) / source.name
        with written_whole(target) as path:
            path.write_bytes(source.read_bytes())
        written.append(target)
    return written
