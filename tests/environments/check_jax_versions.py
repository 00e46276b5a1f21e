"""Whether pftwin runs, fast and precise, on the oldest and the newest JAX that pyproject.toml allows.

    python tests/environments/check_jax_versions.py            # the oldest and the newest
    python tests/environments/check_jax_versions.py 0.8.0      # or any others

Each version gets a fresh virtual environment with pftwin's own dependencies. In it one process simulates a case of the
rig without calling `configure()`, and two more do so with a cache folder: XLA must take the switches, all three must
give the same motion, and the second must find the first one's programs. pip and a package index are needed.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CHECK = """
import json, os, sys, warnings
warnings.simplefilter("error")
import pftwin
if sys.argv[1]:
    pftwin.configure(cache_dir=sys.argv[1])
result = pftwin.simulate(pftwin.rig.case(2, contact="P5"), dt=5e-3)
import jax
hits = len(os.listdir(os.path.join(sys.argv[1], "programs"))) if sys.argv[1] else 0
print(json.dumps([jax.__version__, jax.config.jax_enable_x64, os.environ["XLA_FLAGS"], result.center[-1].tolist(),
                  result.timing["compile_s"], hits]))
"""


def bounds() -> tuple[str, str]:
    """The oldest version and the newest that pip finds below the ceiling."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    (pin,) = [d.removeprefix("jax") for d in project["dependencies"] if d.startswith("jax>")]
    floor = pin.split(",")[0].removeprefix(">=")
    return f"=={floor}.*", pin


def python_with(jax: str, folder: Path) -> Path:
    """The interpreter of a new environment with this JAX; of several that fit "==0.6.*", the oldest."""
    venv.create(folder, with_pip=True)
    python = folder / ("Scripts" if os.name == "nt" else "bin") / "python"
    if jax.endswith(".*"):
        jax = f"{jax.removesuffix('.*')}.0"
    subprocess.run([python, "-m", "pip", "install", "-q", f"jax{jax}", f"{ROOT}"], check=True)
    return python


def checked(python: Path, cache: str) -> list:
    """What a fresh process says."""
    bare = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "JAX_ENABLE_X64", "PYTHONPATH")}
    done = subprocess.run([python, "-c", CHECK, cache], capture_output=True, text=True, check=True, env=bare)
    return json.loads(done.stdout.splitlines()[-1])


def main(versions: list[str]) -> int:
    """Prints a line for each version; the number of those that failed."""
    failed = 0
    for jax in [f"=={v}" for v in versions] or bounds():
        with tempfile.TemporaryDirectory() as folder:
            try:
                python, cache = python_with(jax, Path(folder) / "env"), str(Path(folder) / "cache")
                runs = [checked(python, c) for c in ("", cache, cache)]
            except subprocess.CalledProcessError as error:
                print(f"jax{jax}: failed: {(error.stderr or str(error)).strip()[-1500:]}")
                failed += 1
                continue
        installed, double, flags, center, first, _ = runs[0]
        good = double and "while_loop" in flags and all(r[3] == center for r in runs) and runs[1][5] == runs[2][5] == 2
        failed += not good
        times = f"compiled in {first:.1f} s, loaded in {runs[2][4]:.1f} s"
        print(f"jax {installed}: {'good' if good else 'NOT GOOD'}; {times}; {runs if not good else ''}", flush=True)
    return failed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
