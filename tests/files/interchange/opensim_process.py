"""OpenSim's own Python package, asked in a process of its own: what it does with memory cannot end the tests."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest

POSES = """
import json, sys
import opensim as osim

osim.Logger.setLevelString("Error")
model = osim.Model(sys.argv[1])
state = model.initSystem()
found = []
for row in json.loads(sys.argv[2]):
    for name, value in row.items():
        model.getCoordinateSet().get(name).setValue(state, value, False)
    model.assemble(state)
    model.realizePosition(state)
    poses = {}
    for body in json.loads(sys.argv[3]):
        pose = model.getBodySet().get(body).getTransformInGround(state)
        turn = [[pose.R().get(i, j) for j in range(3)] for i in range(3)]
        poses[body] = [turn, [pose.p().get(i) for i in range(3)]]
    found.append(poses)
print(json.dumps(found))
"""
TABLE = """
import json, sys
import opensim as osim

osim.Logger.setLevelString("Error")
table = osim.TimeSeriesTable(sys.argv[1])
storage = osim.Storage(sys.argv[1])
columns = {name: list(table.getDependentColumn(name).to_numpy()) for name in table.getColumnLabels()}
print(json.dumps({"columns": columns, "degrees": storage.isInDegrees(), "rows": storage.getSize()}))
"""


def ask(script: str, *arguments: str | Path) -> Any:
    """What a script prints as JSON; the test is skipped where OpenSim is not installed."""
    if importlib.util.find_spec("opensim") is None:
        pytest.skip("OpenSim's Python package is not installed: pip install opensim")
    command = [sys.executable, "-c", script, *(str(a) for a in arguments)]
    with tempfile.TemporaryDirectory() as place:  # for its log
        done = subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def poses(model: Path, rows: list[dict[str, float]], bodies: tuple[str, ...]) -> list[dict[str, Any]]:
    """Turn (3, 3) and place (3,) in ground of bodies, for rows of coordinates [rad, m]."""
    return ask(POSES, model, json.dumps(rows), json.dumps(bodies))
