"""The commands that the package fitting adds to the program `pftwin`."""

from __future__ import annotations

from fitting.cli import calibrate, cohort, demo, fit, predict, treat
from fitting.cli.live import command as live
from fitting.cli.report import command as report
from fitting.cli.twin import command as twin
from pftwin.cli.plugins import Command, Job

FIT = Job("Fit its tendons to the recording", "pftwin fit knee/scene.toml -o fit.json")
TREAT = Job(
    "See what a treatment would do", "pftwin treat knee/scene.toml --estimate fit.json --tto-medial 0:20:4 -o out.nc"
)
COMMANDS = (
    Command("demo", demo.demo, "Simulate, fit and treat the virtual rig; compare to paper", "Start", 10),
    Command("fit", fit.fit, "Fit tendons to motion capture, with intervals", "Fit", 10, FIT),
    Command("predict", predict.predict, "Predict a fitted knee in another recording, with bands", "Fit", 15),
    Command("plan-experiment", fit.plan_experiment, "Predict how well an experiment determines parameters", "Fit", 20),
    Command("train-posterior", fit.train_posterior, "Train a posterior once, to fit recordings in seconds", "Fit", 30),
    Command("calibrate", calibrate.calibrate, "Measure coverage of intervals on simulated knees", "Fit", 40),
    Command("treat", treat.treat, "Predict outcomes of treatments, with bands", "Treat", 10, TREAT),
    Command("optimise", treat.optimise, "Find the smallest treatment that meets stated limits", "Treat", 20),
    Command("cohort", cohort.cohort, "Fit and treat many patients, with one summary", "Treat", 30),
    Command("app", live.app, "Try treatments with sliders, live in the browser", "Treat", 40),
    Command("twin", twin.twin, "Write the twin as one page that needs no Python", "Treat", 50),
    Command("report", report.report, "Write one offline page that a clinician can read", "Look", 20),
)
