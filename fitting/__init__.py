"""Estimates a knee model's parameters from measurements, with their uncertainty, and predicts effects of treatments.

    estimate = fitting.fit_tendons(scene, measured)
    print(estimate.sentence())
    estimate.save("fit.json")

`fitting` builds on `pftwin`. Names are imported on first use, so that `import fitting` is fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fitting import treatments
    from fitting.calibration.calibrate import calibrate
    from fitting.calibration.quick_fit import QuickFit
    from fitting.estimate import Estimate
    from fitting.fit import fit_tendons
    from fitting.identifiability import plan_experiment, profile_likelihood
    from fitting.nuisance import Nuisance
    from fitting.objective import Objective
    from fitting.parameters import Parameter, Parameters, free_parameters
    from fitting.posterior.result import Posterior
    from fitting.posterior.sampling import sample_posterior
    from fitting.prediction import outcomes
    from fitting.prediction.derived import derived
    from fitting.prediction.motion import predict_motion
    from fitting.prediction.predicting import predict
    from fitting.programs import channels_of
    from fitting.trained import TrainedPosterior
    from fitting.training import train_posterior
    from fitting.treatments.optimise import optimise_treatment

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

__all__ = [
    "Estimate",
    "Nuisance",
    "Objective",
    "Parameter",
    "Parameters",
    "Posterior",
    "QuickFit",
    "TrainedPosterior",
    "calibrate",
    "channels_of",
    "derived",
    "fit_tendons",
    "free_parameters",
    "optimise_treatment",
    "outcomes",
    "plan_experiment",
    "predict",
    "predict_motion",
    "profile_likelihood",
    "sample_posterior",
    "train_posterior",
    "treatments",
]


if not TYPE_CHECKING:  # so that type checkers report names that do not exist

    def __getattr__(name: str) -> Any:
        if name in __all__:
            from pftwin.base.runtime import use_defaults

            use_defaults()
        if name in _HOME:
            value = getattr(import_module(f"fitting.{_HOME[name]}"), name)
        elif name in _MODULES:
            value = import_module(f"fitting.{_MODULES[name]}")
        else:
            raise AttributeError(f"module 'fitting' has no attribute {name!r}")
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return __all__
