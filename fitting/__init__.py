"""Estimates a knee model's parameters from measurements, with their uncertainty, and predicts effects of treatments.

    estimate = fitting.fit_tendons(scene, measured)
    print(estimate.sentence())
    estimate.save("fit.json")

`fitting` builds on `pftwin`. Names are imported on first use, so that `import fitting` is fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # `as` marks names that are exported
    from fitting import treatments as treatments
    from fitting.calibration.calibrate import calibrate as calibrate
    from fitting.calibration.quick_fit import QuickFit as QuickFit
    from fitting.estimate import Estimate as Estimate
    from fitting.fit import fit_tendons as fit_tendons
    from fitting.identifiability import plan_experiment as plan_experiment
    from fitting.identifiability import profile_likelihood as profile_likelihood
    from fitting.nuisance import Nuisance as Nuisance
    from fitting.objective import Objective as Objective
    from fitting.parameters import Parameter as Parameter
    from fitting.parameters import Parameters as Parameters
    from fitting.parameters import free_parameters as free_parameters
    from fitting.posterior.result import Posterior as Posterior
    from fitting.posterior.sampling import sample_posterior as sample_posterior
    from fitting.prediction import outcomes as outcomes
    from fitting.prediction.derived import derived as derived
    from fitting.prediction.motion import predict_motion as predict_motion
    from fitting.prediction.predicting import predict as predict
    from fitting.programs import channels_of as channels_of
    from fitting.trained import TrainedPosterior as TrainedPosterior
    from fitting.training import train_posterior as train_posterior
    from fitting.treatments.optimise import optimise_treatment as optimise_treatment

_HOME = {
    "Estimate": "estimate",
    "Nuisance": "nuisance",
    "Objective": "objective",
    "Parameter": "parameters",
    "Parameters": "parameters",
    "Posterior": "posterior.result",
    "QuickFit": "calibration.quick_fit",
    "calibrate": "calibration.calibrate",
    "channels_of": "programs",
    "derived": "prediction.derived",
    "fit_tendons": "fit",
    "free_parameters": "parameters",
    "optimise_treatment": "treatments.optimise",
    "plan_experiment": "identifiability",
    "predict": "prediction.predicting",  # a module named `predict` would hide the function
    "predict_motion": "prediction.motion",
    "profile_likelihood": "identifiability",
    "sample_posterior": "posterior.sampling",
    "train_posterior": "training",
    "TrainedPosterior": "trained",
}
_MODULES = {"outcomes": "prediction.outcomes", "treatments": "treatments"}

if not TYPE_CHECKING:  # so that type checkers report names that do not exist
    __all__ = list(_HOME | _MODULES)

    def __getattr__(name: str) -> Any:
        if name not in __all__:
            raise AttributeError(f"module 'fitting' has no attribute {name!r}")
        from pftwin.base.runtime import use_defaults

        use_defaults()
        if name in _HOME:
            value = getattr(import_module(f"fitting.{_HOME[name]}"), name)
        else:
            value = import_module(f"fitting.{_MODULES[name]}")
        globals()[name] = value
        return value

    def __dir__() -> list[str]:
        return __all__
