"""Programs in WebAssembly, run in Node."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import fitting.cli
from fitting.cli.twin.emitter import Emitter

MODEL = Path(fitting.cli.__file__).parent / "templates" / "twin_model.js"
_ONE = """
const [file, facts, inputs] = process.argv.slice(1);
const read = (f) => JSON.parse(require('fs').readFileSync(f));
const { exports } = new WebAssembly.Instance(new WebAssembly.Module(require('fs').readFileSync(file)), { Math });
const { inputs: places, outputs } = read(facts), memory = exports.memory.buffer;
const slots = ([at, n, real]) => real ? new Float64Array(memory, at, n) : new Int32Array(memory, at, 2 * n);
read(inputs).forEach((values, i) => values.forEach((x, k) => {
    slots(places[i])[places[i][2] ? k : 2 * k] = x === null ? NaN : x;
}));
exports.run();
const found = outputs.map((o) => Array.from({ length: o[1] }, (_, k) => String(slots(o)[o[2] ? k : 2 * k])));
console.log(JSON.stringify(found));
"""
_TWIN = """
const [model, file, facts, asked] = process.argv.slice(1), fs = require('fs');
const read = (f) => JSON.parse(fs.readFileSync(f));
const twin = require(model).makeTwin(new WebAssembly.Module(fs.readFileSync(file)), read(facts));
console.log(JSON.stringify(read(asked).map((values) => {
    let last;
    for (const motion of twin.simulate(values)) { last = motion; }
    const plain = (name) => ({ [name]: [...last[name]] });
    return { ...last, ...plain('center'), ...plain('quaternion'), ...plain('force'), ...plain('status') };
})));
"""


def in_node(code: str, *arguments: Any) -> Any:
    """What a script prints as JSON; the test is skipped, with the reason, where there is no Node."""
    if (node := shutil.which("node")) is None:
        pytest.skip("no node on the path: apt-get install nodejs")
    command = [node, "-e", code, "--", *map(str, arguments)]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout)


def computed(folder: Path, function: Any, *arguments: Any) -> list[np.ndarray]:
    """The results of a function of arrays, emitted and run in Node, flat."""
    emitter = Emitter()
    description = emitter.program("run", lambda *a: jax.tree.leaves(function(*a)), *arguments)
    (folder / "one.wasm").write_bytes(emitter.module.binary())
    (folder / "one.json").write_text(json.dumps(description))
    given = [[None if x != x else x for x in np.asarray(a).reshape(-1).tolist()] for a in arguments]
    (folder / "inputs.json").write_text(json.dumps(given))
    found = in_node(_ONE, folder / "one.wasm", folder / "one.json", folder / "inputs.json")
    return [np.array([float(x) for x in row]) for row in found]


def simulated(folder: Path, made: Any, facts: dict[str, Any], values: list[list[float]]) -> list[dict[str, Any]]:
    """The finished motions of a twin for values of its sliders."""
    (folder / "twin.wasm").write_bytes(made.binary)
    (folder / "facts.json").write_text(json.dumps(facts))
    (folder / "asked.json").write_text(json.dumps(values))
    return in_node(_TWIN, MODEL, folder / "twin.wasm", folder / "facts.json", folder / "asked.json")
