"""Cohorts whose units take no time: the loop, the files and the manifest are the real ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from made_estimates import made_estimate

from fitting.cohort import Cohort, Patient, read_cohort
from fitting.cohort.run import Tell
from fitting.estimate import Estimate
from pftwin.base.errors import InputError

HEAD = """schema = 1
name = "cheap"

[fit]
free = ["K1", "L1"]

[predict]
samples = 2

[[treatment]]
tibial_tuberosity_transfer = { medialisation_mm = [0, 10] }
"""


def write_cohort(folder: Path, count: int = 3, head: str = HEAD) -> Path:
    """A cohort file with patients A, B, ...; their scene files are TOML, and no more is asked of them here."""
    text = head
    for i in range(count):
        name = chr(ord("A") + i)
        (folder / f"{name}.toml").write_text(f"mass = {i}\n")
        text += f'\n[[patient]]\nname = "{name}"\nscene = "{name}.toml"\n'
    path = folder / "cohort.toml"
    path.write_text(text)
    return path


def cheap(folder: Path, count: int = 3, head: str = HEAD) -> Cohort:
    return read_cohort(write_cohort(folder, count, head))


class CheapWork:
    """In the place of `Work`: numbers that follow from the patient's name.

    Args:
        began: called with patient and kind when a unit begins.
        broken: by patient and kind, what is raised.
        size: draws of a prediction, which make its file large.
    """

    def __init__(
        self,
        began: Callable[[str, str], None] = lambda *_: None,
        broken: dict[tuple[str, str], BaseException] | None = None,
        size: int = 3,
    ) -> None:
        self.began, self.broken, self.size = began, broken or {}, size
        self.ran: list[tuple[str, str]] = []

    def _begins(self, patient: Patient, kind: str) -> None:
        self.ran.append((patient.name, kind))
        self.began(patient.name, kind)
        if (patient.name, kind) in self.broken:
            raise self.broken[patient.name, kind]

    def scene_facts(self, patient: Patient) -> dict[str, Any]:
        return {"scene": f"knee {patient.name}", "synthetic": 1}

    def fit(self, patient: Patient, tell: Tell) -> Estimate:
        self._begins(patient, "fit")
        tell(0.5)
        number = float(ord(patient.name[0]))
        return made_estimate({"K1": (number, 1.0), "L1": (0.1, 0.001)}, rmse={"position": 1e-4})

    def predict(self, patient: Patient, estimate: Estimate | None, tell: Tell) -> Any:
        from xarray import Dataset

        self._begins(patient, "prediction")
        if estimate is None:
            raise InputError("this work predicts from estimates", where=patient.name)
        axes = ("variant", "sample")
        force = estimate.values[0] + np.array([[0.0], [10.0]]) + np.linspace(0, 1, self.size)
        about = {"units": "N", "long_name": "largest normal contact force"}
        data = {
            "peak_contact_force": (axes, force, about),
            "dislocation_time": (axes, np.full(force.shape, np.nan), {"units": "s", "long_name": "time"}),
            "failed": (axes, np.zeros(force.shape, bool), {"units": "1", "long_name": "failed"}),
            "status_frames": ((*axes, "flag"), np.zeros((*force.shape, 2), int), {"flags": ["none", "beyond"]}),
        }
        coordinates = {
            "variant": (("variant",), [0, 1]),
            "scene": (("variant",), [f"knee {patient.name}"] * 2),
            "treatment": (("variant",), ["as it is", "10 mm medially"]),
            "medialisation": (("variant",), [0.0, 0.01], {"units": "m", "long_name": "medialisation"}),
            "sample": (("sample",), np.arange(self.size)),
            "flag": (("flag",), ["no_contact", "left_patch"]),
        }
        return Dataset(data, coordinates, {"title": "predicted outcomes"})
