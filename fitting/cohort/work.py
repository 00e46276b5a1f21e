"""What a unit computes: the fit of a patient, and what treatments would do to it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

from fitting.cohort.description import Cohort, Patient
from pftwin.base.errors import InputError

if TYPE_CHECKING:
    from xarray import Dataset

    from fitting.estimate import Estimate
    from pftwin.model.scene import Scene

Tell = Callable[[float], None]  # how far a unit is: the share that is done


class Work(Protocol):
    """What the loop over units needs to have done; `ByPftwin` does it."""

    def about(self, patient: Patient) -> dict[str, Any]:
        """`scene`, its name, and `synthetic`, whether its motion or measurements are: 0 or 1."""
        ...

    def fit(self, patient: Patient, tell: Tell) -> Estimate:
        """The patient's parameters."""
        ...

    def predict(self, patient: Patient, estimate: Estimate | None, tell: Tell) -> Dataset | None:
        """Outcomes of the cohort's treatments; None if it has none."""
        ...


class ByPftwin:
    """By `fitting.fit_tendons` and `fitting.predict`."""

    def __init__(self, cohort: Cohort) -> None:
        self.cohort = cohort
        self._last: tuple[Patient, Scene] | None = None  # a patient's units follow each other

    def about(self, patient: Patient) -> dict[str, Any]:
        """See `Work`."""
        scene = self._scene(patient)
        measured = scene.measured is not None and scene.measured.synthetic
        return {"scene": scene.name, "synthetic": int(scene.synthetic or measured)}

    def fit(self, patient: Patient, tell: Tell) -> Estimate:
        """See `Work`.

        Raises:
            InputError: what `fitting.fit_tendons` refuses.
            KeyboardInterrupt: Ctrl-C; half a fit is none.
        """
        from fitting.fit import fit_tendons, measured_of

        scene = self._scene(patient)
        estimate = fit_tendons(
            scene, measured_of(scene), progress=lambda p: tell(p.iteration / max(p.of, 1)), **(patient.fit or {})
        )
        if estimate.reason.startswith("interrupted"):
            raise KeyboardInterrupt
        return estimate

    def predict(self, patient: Patient, estimate: Estimate | None, tell: Tell) -> Dataset | None:
        """See `Work`.

        Raises:
            InputError: what `fitting.predict` refuses; no variant that could be simulated.
        """
        if not self.cohort.treatments:
            return None
        from fitting.prediction.predicting import predict
        from fitting.prediction.variants import combinations

        settings = dict(self.cohort.predict)
        if estimate is None:
            settings["samples"] = 0  # nothing is uncertain
        variants = [combinations(amounts) for amounts in self.cohort.treatments]
        scene = self._scene(patient)
        data = predict(scene, variants, estimate, progress=lambda done, of: tell(done / max(of, 1)), **settings)
        if bool(data["failed"].all()):
            raise InputError(
                "no variant could be simulated: no equilibrium to start from, or no finite motion",
                where=patient.name,
                remedy="pftwin simulate, which says more",
            )
        return data

    def _scene(self, patient: Patient) -> Scene:
        if self._last is None or self._last[0] != patient:
            self._last = None  # what is not needed any more goes before what comes
            self._last = patient, self._loaded(patient)
        return self._last[1]

    def _loaded(self, patient: Patient) -> Scene:
        if patient.scene is None:
            from pftwin import rig

            assert patient.case is not None
            return rig.case(patient.case, contact=patient.contact or "P5")
        from pftwin.files.scene_file import load_scene

        return load_scene(patient.scene, contact=patient.contact, allow_outside=self.cohort.allow_outside)
