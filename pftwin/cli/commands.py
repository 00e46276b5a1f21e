"""The commands of pftwin alone."""

from __future__ import annotations

from pftwin.cli import audit, doctor, exchange, meshes, simulate, studies, view
from pftwin.cli.contact_map import contact_map
from pftwin.cli.doctor_mesh import doctor_mesh
from pftwin.cli.plugins import Command, Job

OWN_KNEE = Job("Begin a knee of your own, from an example", "pftwin init knee")
SIMULATE = Job("Simulate it", "pftwin simulate knee/scene.toml -o knee.nc")
COMMANDS = (
    Command("init", exchange.init, "Write a commented scene with a laboratory's files", "Start", 20, OWN_KNEE),
    Command("doctor", doctor.doctor, "Is this installation sound? Versions and a self-test", "Start", 30),
    Command("simulate", simulate.simulate, "The patella through the recorded motion", "Simulate", 10, SIMULATE),
    Command("equilibrium", simulate.equilibrium, "Where the patella rests at the first frame", "Simulate", 20),
    Command("validate", simulate.validate, "Simulate, and compare with measurements", "Simulate", 30),
    Command("contact-map", contact_map, "Pressures where recorded poses press two meshes", "Simulate", 40),
    Command("fit-surface", meshes.fit_surface, "Trochlear patches from a mesh of the implant", "Fit", 30),
    Command("view", view.view, "Results in three dimensions: a page or a film", "Look", 10),
    Command("explain", audit.explain, "What each effect of a scene adds", "Look", 30),
    Command("audit", audit.audit, "What each effect is worth, left out in turn", "Look", 40),
    Command("doctor-mesh", doctor_mesh, "What is wrong with a mesh; repair what is safe", "Check", 10),
    Command("accuracy", studies.accuracy, "What accuracy costs in time", "Check", 20),
    Command("hard-cases", studies.hard_cases, "Scenes that break simulators, judged", "Check", 30),
    Command("export", exchange.export, "A result as .mot, .sto, .glb or .csv", "Exchange", 10),
    Command("import", exchange.import_model, "An OpenSim model as a scene folder", "Exchange", 20),
)
