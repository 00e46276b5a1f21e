"""A living knee, measured by dynamic MRI: fitted to each half of its motion, and predicted in the other half.

    python examples/living_knee.py FOLDER_OF_HEALTHY_KNEE [-o OUT]

The folder may be omitted if PFTWIN_DATA names the folder that contains healthy_knee. docs/worked_knees.md has the
results, and three commands that do the same. Data: Lenhart et al. 2015, Ann Biomed Eng 43:2675.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import fitting
import pftwin
from fitting.prediction.predicted_motion import PredictedMotion
from pftwin.files.interchange.osim_scene import import_osim

Spans = list[tuple[float, float]]
BENDING, STRAIGHTENING = [(0.0, 0.51), (1.45, 2.0)], [(0.52, 1.44)]  # [s]
BOUNDS = {
    "pt.slack_length[:]": (0.040, 0.068),
    "quadriceps.tension[:]": (0.1, 14.0),
    "lpfl.slack_length[:]": (0.022, 0.050),
    "mpfl.slack_length[:]": (0.030, 0.070),
}
ATTACHMENTS = 2e-3  # standard deviation of each coordinate, as in the preset "mri" [m]
PLACEMENT = {f"contact.placement.{axis}": 3e-3 for axis in "xyz"}  # [m]
NOISE = {"position": 3e-4, "orientation": 0.01}  # of the measurement [m], [rad]


def imported(data: Path, folder: Path) -> pftwin.Scene:
    """Imports the generic model with the measured motion and a guess of 20 N for the quadriceps."""
    model, motion = data / "lenhart2015.osim", data / "passive_body_transformations.sto"
    options = {"rate": 30.0, "quadriceps": 20.0, "side": "right", "geometry": [data / "geometry"]}
    return pftwin.load_scene(import_osim(model, folder, motion=motion, **options).scene)


def study(
    scene: pftwin.Scene, samples: int = 50, fitted: Spans = BENDING, unseen: Spans = STRAIGHTENING
) -> tuple[fitting.Estimate, PredictedMotion]:
    """Returns the estimate from one half of the motion, and the prediction of the other."""
    measured = scene.measured
    assert measured is not None
    estimate = fitting.fit_tendons(
        scene,
        measured.during(fitted),
        free=tuple(BOUNDS),
        bounds=BOUNDS,
        nuisance=fitting.Nuisance(attachments=ATTACHMENTS, others=PLACEMENT),
        use=("position", "orientation"),
        noise=NOISE,
        starts=4,
    )
    return estimate, fitting.predict_motion(scene, estimate, measured.during(unseen), samples=samples)


def main() -> None:
    """Runs the study and writes the estimate and the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", nargs="?", type=Path, default=Path(os.environ.get("PFTWIN_DATA", ".")) / "healthy_knee")
    parser.add_argument("-o", "--output", type=Path, default=Path("living_knee"))
    given = parser.parse_args()
    pftwin.configure()
    scene = imported(given.data, given.output)
    estimate, motion = study(scene)
    print(estimate.summary())
    print(motion.sentence())
    print("files:", estimate.save(given.output / "fit.json"), given.output / "straightening.png")
    motion.figure().savefig(given.output / "straightening.png")
    print("the other way round:", study(scene, fitted=STRAIGHTENING, unseen=BENDING)[1].sentence())


if __name__ == "__main__":
    main()
