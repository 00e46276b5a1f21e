"""Whether pftwin runs, fast and precise, on the oldest and the newest JAX that pyproject.toml allows.

    python tests/environments/check_jax_versions.py                                   # the oldest and the newest
    python tests/environments/check_jax_versions.py 0.8.0                             # or any others
    python tests/environments/check_jax_versions.py --python python3.11 python3.14 --suite   # the default tests on each

Each version gets a fresh virtual environment with pftwin's own dependencies. In it one process simulates a case of the
rig without calling `configure()`, and two more do so with a cache folder: XLA must take the switches, all three must
give the same motion, and the second must find the first one's programs. With `--suite` the default tests run there too.
pip and a package index are needed.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import tomllib
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


def python_with(interpreter: str, jax: str, folder: Path, extras: str) -> Path:
    """The interpreter of a new environment with this JAX; of several that fit "==0.6.*", the oldest."""
    subprocess.run([interpreter, "-m", "venv", folder], check=True)
    python = folder / ("Scripts" if os.name == "nt" else "bin") / "python"
    if jax.endswith(".*"):
        jax = f"{jax.removesuffix('.*')}.0"
    subprocess.run([python, "-m", "pip", "install", "-q", f"jax{jax}", f"{ROOT}{extras}"], check=True)
    return python


def checked(python: Path, cache: str) -> list:
    """What a fresh process says."""
    bare = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "JAX_ENABLE_X64", "PYTHONPATH")}
    done = subprocess.run([python, "-c", CHECK, cache], capture_output=True, text=True, check=True, env=bare)
    return json.loads(done.stdout.splitlines()[-1])


def passed(python: Path) -> bool:
    """Whether the default tests pass there; the package that they test is the installed one."""
    bare = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "JAX_ENABLE_X64", "PYTHONPATH")}
    with tempfile.TemporaryDirectory() as cache:
        command = [python, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
        return subprocess.run(command, cwd=ROOT, env={**bare, "PFTWIN_TEST_CACHE": cache}, check=False).returncode == 0


def tried(interpreter: str, jax: str, suite: bool) -> bool:
    """Prints a line for one interpreter and version of JAX; whether all is good."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            python = python_with(interpreter, jax, Path(folder) / "env", "[test]" if suite else "")
            cache = str(Path(folder) / "cache")
            runs = [checked(python, c) for c in ("", cache, cache)]
        except (subprocess.CalledProcessError, OSError) as error:
            said = getattr(error, "stderr", None) or str(error)
            print(f"{interpreter}, jax{jax}: failed: {said.strip()[-1500:]}", flush=True)
            return False
        installed, double, flags, center, first, _ = runs[0]
        good = double and "while_loop" in flags and all(r[3] == center for r in runs) and runs[1][5] == runs[2][5] == 2
        times = f"compiled in {first:.1f} s, loaded in {runs[2][4]:.1f} s"
        print(f"{interpreter}, jax {installed}: {'good' if good else f'NOT GOOD: {runs}'}; {times}", flush=True)
        if suite and good:
            good = passed(python)
            print(f"{interpreter}, jax {installed}: tests {'passed' if good else 'FAILED'}", flush=True)
        return good


def main() -> int:
    """The number of environments in which something failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("versions", nargs="*", help="of JAX; by default the oldest and the newest allowed")
    parser.add_argument("--python", nargs="+", default=[sys.executable], help="interpreters")
    parser.add_argument("--suite", action="store_true", help="run the default tests as well")
    given = parser.parse_args()
    versions = [f"=={v}" for v in given.versions] or bounds()
    return sum(not tried(python, jax, given.suite) for python in given.python for jax in versions)


if __name__ == "__main__":
    sys.exit(main())
