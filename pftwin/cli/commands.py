"""The commands of the package pftwin, without those of other packages."""

from __future__ import annotations

from pftwin.cli import doctor, exchange, look, meshes, simulate, studies
from pftwin.cli.contact_map import contact_map
from pftwin.cli.doctor_mesh import doctor_mesh
from pftwin.cli.plugins import Command, Job

OWN_KNEE = Job("Start your own knee from an example", "pftwin init knee")
SIMULATE = Job("Simulate it", "pftwin simulate knee/scene.toml -o knee.nc")
COMMANDS = (
    Command("init", exchange.init, "Write a commented example scene with its files", "Start", 20, OWN_KNEE),
    Command("doctor", doctor.doctor, "Check the installation: versions and a self-test", "Start", 30),
    Command("simulate", simulate.simulate, "Simulate the patella in a recorded motion", "Simulate", 10, SIMULATE),
    Command("equilibrium", simulate.equilibrium, "Find the equilibrium at the first frame", "Simulate", 20),
    Command("validate", simulate.validate, "Simulate, and compare with measurements", "Simulate", 30),
    Command("contact-map", contact_map, "Compute contact pressures at recorded poses", "Simulate", 40),
    Command("fit-surface", meshes.fit_surface, "Fit trochlear patches to an implant's mesh", "Fit", 30),
    Command("view", look.view, "Show results in 3D: a page or a film", "Look", 10),
    Command("explain", look.explain, "Show the cost of each effect of a scene", "Look", 30),
    Command("audit", look.audit, "Test the influence of each effect", "Look", 40),
    Command("doctor-mesh", doctor_mesh, "Find defects of a mesh; repair where safe", "Check", 10),
    Command("accuracy", studies.accuracy, "Measure errors and run times of settings", "Check", 20),
    Command("hard-cases", studies.hard_cases, "Run scenes that are hard to simulate", "Check", 30),
    Command("export", exchange.export, "Convert a result to .mot, .sto, .glb or .csv", "Exchange", 10),
    Command("import", exchange.import_model, "Convert an OpenSim model to a scene folder", "Exchange", 20),
)
