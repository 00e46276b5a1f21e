"""Runs the whole matrix in pieces, one file for each kind of contact and integrator; existing files are not rerun.

Contacts run in parallel processes, because nearly all the time is compilation, which uses one core. Scenes, equilibria
and converged runs of a contact are computed once for all integrators.
"""

from __future__ import annotations

import json
import multiprocessing
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from functools import partial
from pathlib import Path

import jax

from pftwin.base.runtime import configure, describe
from pftwin.base.text_files import write_text
from pftwin.studies.hard_cases.case import CaseIntegrator, catalogue
from pftwin.studies.hard_cases.matrix import Prepared, Selection, cells_of
from pftwin.studies.hard_cases.table import MatrixPiece

Say = Callable[[str], None]
_LOOK = 2.0  # time between two looks at what other processes have written [s]
LONGEST_FIRST = ("contours", "volume", "spline", "P5", "P8", "P5 cylinder", "P4", "P2")  # balances the processes


def piece_path(folder: Path, contact: str, method: CaseIntegrator) -> Path:
    """Returns the file of the cells of a kind of contact and an integrator."""
    return folder / f"{contact}_{method.name}.json".replace(" ", "-").replace(":", "-")


def missing(folder: Path, selection: Selection) -> dict[str, tuple[CaseIntegrator, ...]]:
    """Returns the integrators without a file by kind of contact, with the slowest contacts first."""
    found = {}
    for contact in sorted(selection.contacts, key=LONGEST_FIRST.index):
        if left := tuple(m for m in selection.able(contact) if not piece_path(folder, contact, m).exists()):
            found[contact] = left
    return found


def run_missing(
    folder: Path,
    selection: Selection,
    *,
    processes: int,
    cache_dir: str,
    say: Say = lambda _: None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> list[Path]:
    """Runs all combinations that are `missing`, and writes a file for each contact and integrator when it is done.

    Runs up to `processes` contacts in parallel, with a shared cache of compiled programs. Returns the written files.
    `progress` is called with the number of files written and of all.
    """
    folder.mkdir(parents=True, exist_ok=True)
    work = missing(folder, selection)
    files = [piece_path(folder, contact, method) for contact, methods in work.items() for method in methods]

    def tell() -> None:
        progress(sum(path.exists() for path in files), len(files))

    def say_and_tell(words: str) -> None:
        say(words)
        tell()

    tell()
    if processes == 1:
        for contact, methods in work.items():
            run_contact(folder, contact, methods, selection, say_and_tell)
            tell()
        return files
    context = multiprocessing.get_context("spawn")  # JAX hangs after a fork
    as_the_command = partial(configure, cache_dir=cache_dir)
    with ProcessPoolExecutor(processes, context, as_the_command, max_tasks_per_child=1) as pool:
        running = {pool.submit(run_contact, folder, c, m, selection): c for c, m in work.items()}
        left: set[Future[None]] = set(running)
        while left:
            ended, left = wait(left, timeout=_LOOK, return_when=FIRST_COMPLETED)
            tell()
            for one in ended:
                one.result()
                say(f"{running[one]}: done")
    return files


def run_contact(
    folder: Path, contact: str, methods: Sequence[CaseIntegrator], selection: Selection, say: Say = lambda _: None
) -> None:
    """Runs all cases with one kind of contact, one integrator after the other, and writes a file for each."""
    prepared = Prepared(catalogue(), contact, selection)
    for method in methods:
        began = time.perf_counter()
        cells = cells_of(prepared, method, say)
        seconds = time.perf_counter() - began
        piece = MatrixPiece(tuple(cells), seconds, describe(), not selection.derivatives, selection.truths)
        write_text(piece_path(folder, contact, method), json.dumps(piece.as_dict(), indent=1))
    jax.clear_caches()
