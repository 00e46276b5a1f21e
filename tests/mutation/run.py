"""A mutation run: deliberate one-line bugs, and whether the tests that guard a file notice them.

    python tests/mutation/run.py --sample 30 --seed 1 --only 'fitting.*' --table mutants.md

Bugs are made in a copy of the tree, so nothing here changes. Each runs the tests that `guards.toml` names for its
module, in a process of its own, up to a time limit; the first failure, an error or running out of time counts as
caught. Mutants known to change nothing stand in `equivalent.txt` with the reason, and do not count.
"""

from __future__ import annotations

import argparse
import fnmatch
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path
from typing import NamedTuple

from mutate import Mutant, mutants

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PACKAGES = ("pftwin", "fitting")
MUTATED = (*PACKAGES, "tests/verification/rig_plant")
_FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)


class Outcome(NamedTuple):
    """What came of one mutant."""

    module: str
    mutant: Mutant
    caught_by: str  # "" where nothing noticed
    seconds: float
    equivalent: str  # the reason, where it is one


def guarded() -> dict[str, list[str]]:
    """Modules with the tests that guard them.

    Raises:
        SystemExit: a module or a test that does not exist.
    """
    tables = tomllib.loads((HERE / "guards.toml").read_text(encoding="utf-8"))
    known = {".".join(p.relative_to(ROOT).with_suffix("").parts): p for k in MUTATED for p in (ROOT / k).rglob("*.py")}
    found: dict[str, list[str]] = {}
    wrong = []
    for table in tables.values():
        for pattern, tests in table.items():
            names = fnmatch.filter(known, pattern)
            wrong += [] if names else [pattern]
            wrong += [t for t in tests if not (ROOT / t).exists()]
            for name in names:
                found.setdefault(name, []).extend(t for t in tests if t not in found.get(name, []))
    if wrong:
        raise SystemExit(f"guards.toml names what is not there: {', '.join(wrong)}")
    return found


def equivalents() -> dict[tuple[str, str, str], str]:
    """Reasons by module, label and the line that the mutant is in."""
    out = {}
    for line in (HERE / "equivalent.txt").read_text(encoding="utf-8").splitlines():
        if line.strip() and not line.startswith("#"):
            module, label, text, reason = (part.strip() for part in line.split(" :: "))
            out[module, label, text] = reason
    return out


def path_of(module: str) -> Path:
    """Of a module's file, from the root."""
    plain = Path(*module.split("."))
    return plain.with_suffix(".py") if (ROOT / plain.with_suffix(".py")).exists() else plain / "__init__.py"


def drawn(modules: list[str], count: int, seed: int) -> list[tuple[str, Mutant]]:
    """A sample without repetition; modules are drawn first, so that a long file does not fill it."""
    source = random.Random(seed)
    left = {m: mutants((ROOT / path_of(m)).read_text(encoding="utf-8")) for m in modules}
    for found in left.values():
        source.shuffle(found)
    out: list[tuple[str, Mutant]] = []
    while len(out) < count and any(left.values()):
        rest = [m for m in modules if left[m]]
        source.shuffle(rest)
        out += [(m, left[m].pop()) for m in rest[: count - len(out)]]
    return sorted(out, key=lambda item: (item[0], item[1].start, item[1].after))


def copied(folder: Path) -> Path:
    """A copy of the tree, as far as tests need it."""
    kept_out = shutil.ignore_patterns("__pycache__", ".*", "site", "*.egg-info")
    for name in (*PACKAGES, "tests", "docs", "notebooks", "examples"):
        shutil.copytree(ROOT / name, folder / name, ignore=kept_out)
    for name in ("pyproject.toml", "README.md", "CONTRIBUTING.md", "mkdocs.yml"):
        shutil.copy(ROOT / name, folder / name)
    return folder


def tested(tree: Path, tests: list[str], limit: float) -> str:
    """The first test that fails, "time" where the limit was reached; "" where all pass."""
    cache = os.environ.get("PFTWIN_TEST_CACHE", str(ROOT / ".jax_cache"))
    environment = {
        **os.environ,
        "PYTHONPATH": str(tree),
        "PFTWIN_TEST_CACHE": cache,
        "PYTHONDONTWRITEBYTECODE": "1",
        "MPLBACKEND": "Agg",
    }
    command = [sys.executable, "-m", "pytest", "-n", "0", "-x", "-q", "--no-header", "-p", "no:cacheprovider"]
    with subprocess.Popen(
        [*command, *tests], cwd=tree, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        try:
            said, _ = process.communicate(timeout=limit)
        except subprocess.TimeoutExpired:
            process.kill()
            return "time"
    if process.returncode == 0:
        return ""
    failed = _FAILED.search(said)
    return failed[1] if failed else said.strip().splitlines()[-1][:80]


def outcomes(chosen: list[tuple[str, Mutant]], guards: dict[str, list[str]], limit: float) -> list[Outcome]:
    """Each mutant in turn."""
    reasons, out = equivalents(), []
    with tempfile.TemporaryDirectory() as folder:
        tree = copied(Path(folder))
        if failed := tested(tree, sorted({test for module, _ in chosen for test in guards[module]}), 20 * limit):
            raise SystemExit(f"without a bug {failed} fails: mend it first")
        for i, (module, mutant) in enumerate(chosen, start=1):
            file, began, by = tree / path_of(module), time.perf_counter(), ""
            text = file.read_text(encoding="utf-8")
            reason = reasons.get((module, mutant.label(), mutant.text_of_line(text)), "")
            if not reason:
                try:
                    file.write_text(mutant.applied(text), encoding="utf-8")
                    by = tested(tree, guards[module], limit)
                finally:
                    file.write_text(text, encoding="utf-8")
            out.append(Outcome(module, mutant, by, time.perf_counter() - began, reason))
            print(f"{i}/{len(chosen)} {row(out[-1])}", file=sys.stderr, flush=True)
    return out


def row(o: Outcome) -> str:
    """Of the table."""
    by = f"equivalent: {o.equivalent}" if o.equivalent else o.caught_by.replace("tests/", "", 1) or "**nothing**"
    label = o.mutant.label().replace("|", "\\|")
    return f"| {o.module}:{o.mutant.line} | {o.mutant.what} | `{label}` | {by} | {o.seconds:.0f} |"


def report(found: list[Outcome]) -> str:
    """The table, and what share was caught."""
    counted = [o for o in found if not o.equivalent]
    caught = sum(bool(o.caught_by) for o in counted)
    share = f"{caught} of {len(counted)} mutants that change behaviour caught ({caught / max(len(counted), 1):.0%})"
    head = "| where | what | mutant | caught by | seconds |\n|---|---|---|---|---|"
    return "\n".join([head, *map(row, found), "", f"{share}; {len(found) - len(counted)} equivalent."])


def main() -> int:
    """Returns 1 where less was caught than was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sample", type=int, default=100, help="how many mutants (default 100)")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--only", nargs="+", default=["*"], metavar="MODULE", help="dotted names or patterns")
    parser.add_argument("--limit", type=float, default=120, help="seconds for each mutant (default 120)")
    parser.add_argument("--at-least", type=float, default=0.95, help="share to be caught (default 0.95)")
    parser.add_argument("--table", type=Path, help="a Markdown file for the table")
    parser.add_argument("--check", action="store_true", help="only whether guards.toml names what exists")
    given = parser.parse_args()
    guards = guarded()
    if given.check:
        return 0
    modules = sorted(m for m in guards if any(fnmatch.fnmatchcase(m, p) for p in given.only))
    if not modules:
        raise SystemExit(f"no module of guards.toml is called {' or '.join(given.only)}")
    found = outcomes(drawn(modules, given.sample, given.seed), guards, given.limit)
    text = report(found)
    print(text)
    if given.table:
        given.table.write_text(text + "\n", encoding="utf-8")
    counted = [o for o in found if not o.equivalent]
    return int(sum(bool(o.caught_by) for o in counted) < given.at_least * len(counted))


if __name__ == "__main__":
    raise SystemExit(main())
