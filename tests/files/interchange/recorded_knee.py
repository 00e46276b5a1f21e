"""A small OpenSim model with markers, and recordings of them from known poses."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from knee_models import DEFAULTS, WELD, body, coordinate, ligaments, model
from scipy.spatial.transform import Rotation

from pftwin.files.mocap import MarkerTrajectories, write_trc

FRAMES, RATE = 241, 120.0
TIMES = 2.0 + np.arange(FRAMES) / RATE
PLACES = {  # by body and marker [m]
    "femur_r": {
        "R.Thigh.A": (0.011, 0.212, 0.063),
        "R.Thigh.B": (0.057, 0.131, 0.042),
        "R.Thigh.C": (-0.024, 0.093, 0.071),
    },
    "tibia_r": {"R.Shank.A": (0.043, -0.112, 0.021), "R.Shank.B": (0.012, -0.231, 0.052)},
    "shank_r": {"R.Shank.C": (0.032, -0.153, -0.027)},  # welded to the tibia, 50 mm below
    "patella_r": {"R.Patella": (0.027, 0.013, -0.006)},
    "hand": {"R.Wrist": (0.0, 0.1, 0.2)},  # no body of the model
}
PELVIS = {"R.Asis": (0.031, 0.021, 0.122), "L.Asis": (0.023, 0.012, -0.131), "Sacral": (-0.142, 0.033, 0.004)}
HIP_IN_PELVIS, HIP_IN_FEMUR = (-0.052, -0.071, 0.084), (0.003, 0.404, -0.002)


def marker(name: str, where: str, place: tuple[float, ...]) -> str:
    """As OpenSim 4 writes it, or OpenSim 3 where the frame is a bare name."""
    frame = f"<socket_parent_frame>{where}</socket_parent_frame>" if "/" in where else f"<body> {where} </body>"
    return f'<Marker name="{name}">{frame}<location> {" ".join(map(str, place))} </location></Marker>'


def marker_set(places: Mapping[str, Mapping[str, tuple[float, ...]]] = PLACES, prefix: str = "/bodyset/") -> str:
    """With the prefix of OpenSim 4, or without any, as in OpenSim 3."""
    inside = "".join(marker(n, f"{prefix}{where}", p) for where, held in places.items() for n, p in held.items())
    return f'<MarkerSet name="markerset"><objects>{inside}</objects></MarkerSet>'


def osim(markers: str = marker_set()) -> str:
    """A model without contact."""
    return model(forces=ligaments(), meshes=False).replace("</Model>", f"{markers}</Model>")


def with_pelvis() -> str:
    """The femur hangs on a pelvis by a ball joint."""
    turns = "".join(coordinate(f"hip_{k}", 0.1, -1.0, 1.0) for k in "xyz")
    free = "".join(coordinate(f"pelvis_{k}", 0.2, -2.0, 2.0) for k in ("rx", "ry", "rz", "tx", "ty", "tz"))
    places = [" ".join(map(str, p)) for p in (HIP_IN_PELVIS, HIP_IN_FEMUR)]
    frames = "".join(
        f'<PhysicalOffsetFrame name="{name}"><socket_parent>/bodyset/{of}</socket_parent>'
        f"<translation>{place}</translation></PhysicalOffsetFrame>"
        for name, of, place in zip(("socket", "head"), ("pelvis", "femur_r"), places, strict=True)
    )
    hip = (
        '<BallJoint name="hip"><socket_parent_frame>socket</socket_parent_frame><socket_child_frame>head'
        f"</socket_child_frame><coordinates>{turns}</coordinates><frames>{frames}</frames></BallJoint>"
        '<FreeJoint name="pelvis"><socket_parent_frame>/ground</socket_parent_frame><socket_child_frame>/bodyset/pelvis'
        f"</socket_child_frame><coordinates>{free}</coordinates></FreeJoint>"
    )
    text = osim(marker_set({**PLACES, "pelvis": PELVIS}))
    assert WELD in text
    assert DEFAULTS in text
    return text.replace(WELD, hip).replace('"bodyset"><objects>', f'"bodyset"><objects>{body("pelvis", 10.0)}')


def pose(turns: np.ndarray, places: np.ndarray) -> np.ndarray:
    """(n, 4, 4) from rotation vectors and places (n, 3)."""
    found = np.tile(np.eye(4), (len(turns), 1, 1))
    found[:, :3, :3], found[:, :3, 3] = Rotation.from_rotvec(turns).as_matrix(), places
    return found


def motion() -> dict[str, np.ndarray]:
    """Poses (n, 4, 4) in the laboratory, which begin and end at rest; the shank's are those of its weld."""
    u = np.linspace(0, 1, FRAMES)[:, None]
    t = u**3 * (10 - 15 * u + 6 * u**2)
    femur = pose(t * [0.02, -0.05, 0.3] + [0.1, 0.2, 0.1], [0.6, 0.9, 0.3] + t * [0.3, 0.01, 0.02])
    tibia = femur @ pose(t * [0.0, 0.02, -0.5] - [0, 0, 0.2], np.tile([0.001, -0.002, 0.0], (FRAMES, 1)))
    patella = femur @ pose(t * [0.03, 0.0, -0.3], np.array([0.049, 0.002, 0.003]) + t * [-0.004, -0.01, 0.001])
    weld = np.eye(4)
    weld[1, 3] = -0.05  # knee_models.FIBULA has the tibia 50 mm above the shank's origin
    pelvis = femur @ pose(t * [0.1, 0.05, -0.2], np.zeros((FRAMES, 3)))
    moved = pelvis[:, :3, :3] @ np.array(HIP_IN_PELVIS) - femur[:, :3, :3] @ np.array(HIP_IN_FEMUR)
    pelvis[:, :3, 3] = femur[:, :3, 3] - moved
    return {"femur_r": femur, "tibia_r": tibia, "shank_r": tibia @ weld, "patella_r": patella, "pelvis": pelvis}


def seen(places: Mapping[str, Mapping[str, tuple[float, ...]]] = PLACES) -> dict[str, np.ndarray]:
    """Where the markers are in the laboratory, (n, 3) [m]; dots in their names are underscores."""
    bodies = motion()
    return {
        name.replace(".", "_"): bodies[where][:, :3, :3] @ np.array(p) + bodies[where][:, :3, 3]
        for where, held in places.items()
        if where in bodies
        for name, p in held.items()
    }


def record(path: Path, markers: Mapping[str, np.ndarray]) -> Path:
    """A TRC file."""
    write_trc(path, MarkerTrajectories(TIMES, tuple(markers), np.stack([*markers.values()], axis=1)))
    return path
