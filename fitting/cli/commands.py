"""The commands that fitting brings to the program `pftwin`."""

from __future__ import annotations

from fitting.cli import calibrate, cohort, demo, fit, predict, treat
from fitting.cli.live import command as live
from fitting.cli.report import command as report
from fitting.cli.twin import command as twin
from pftwin.cli.plugins import Command, Job

FIT = Job("Fit its tendons to the recording", "pftwin fit knee/scene.toml -o fit.json")
TREAT = Job(
    "See what a treatment would do",
    "pftwin treat knee/scene.toml --estimate fit.json --tto-medial 0:20:4 -o out.nc",
)
COMMANDS = (
    Command("demo", demo.demo, "The whole story on the virtual rig, beside the paper", "Start", 10),
    Command("fit", fit.fit, "Tendons from motion capture, with intervals", "Fit", 10, FIT),
    Command("predict", predict.predict, "A fitted knee in another recording, with bands", "Fit", 15),
    Command("plan-experiment", fit.plan_experiment, "What an experiment can tell, before it is made", "Fit", 20),
    Command("train-posterior", fit.train_posterior, "Once for a set-up: a posterior that answers at once", "Fit", 30),
    Command("calibrate", calibrate.calibrate, "Do its intervals hold the truth? On simulated knees", "Fit", 40),
    Command("treat", treat.treat, "Predict outcomes of treatments, with bands", "Treat", 10, TREAT),
    Command("optimise", treat.optimise, "The smallest treatment that meets stated limits", "Treat", 20),
    Command("cohort", cohort.cohort, "Many patients: fits, treatments, one summary", "Treat", 30),
    Command("app", live.app, "Treatments by sliders, live in the browser", "Treat", 40),
    Command("twin", twin.twin, "The twin in one page that needs no Python", "Treat", 50),
    Command("report", report.report, "One offline page that a clinician can read", "Look", 20),
)
