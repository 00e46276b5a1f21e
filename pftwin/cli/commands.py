"""The commands of pftwin alone."""

from __future__ import annotations

from pftwin.cli import (
    accuracy,
    audit,
    contact_map,
    doctor,
    doctor_mesh,
    equilibrium,
    explain,
    export,
    fit_surface,
    hard_cases,
    import_model,
    init,
    simulate,
    validate,
    view,
)
from pftwin.cli.plugins import Command

COMMANDS = (
    Command("init", init.init, "Write a commented scene with a laboratory's files", "Start", 20),
    Command("doctor", doctor.doctor, "Is this installation sound? Versions and a self-test", "Start", 30),
    Command("simulate", simulate.simulate, "The patella through the recorded motion", "Simulate", 10),
    Command("equilibrium", equilibrium.equilibrium, "Where the patella rests at the first frame", "Simulate", 20),
    Command("validate", validate.validate, "Simulate, and compare with measurements", "Simulate", 30),
    Command("contact-map", contact_map.contact_map, "Pressures where recorded poses press two meshes", "Simulate", 40),
    Command("fit-surface", fit_surface.fit_surface, "Trochlear patches from a mesh of the implant", "Fit", 30),
    Command("view", view.view, "Results in three dimensions: a page, offline", "Look", 10),
    Command("explain", explain.explain, "What each effect of a scene adds", "Look", 30),
    Command("audit", audit.audit, "What each effect is worth, left out in turn", "Look", 40),
    Command("doctor-mesh", doctor_mesh.doctor_mesh, "What is wrong with a mesh; repair what is safe", "Check", 10),
    Command("accuracy", accuracy.accuracy, "What accuracy costs in time", "Check", 20),
    Command("hard-cases", hard_cases.hard_cases, "Scenes that break simulators, judged", "Check", 30),
    Command("export", export.export, "A result as .mot, .sto, .glb or .csv", "Exchange", 10),
    Command("import", import_model.import_model, "An OpenSim model as a scene folder", "Exchange", 20),
)
