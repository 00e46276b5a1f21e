"""Thousands of transfers of the tibial tuberosity, run by the processes of a SLURM job; see docs/batches.md.

    srun python cluster_batch.py PARTS -o result.nc            all processes of a job
    python cluster_batch.py PARTS --share 3 16                  one task of a job array, the fourth of 16
    python cluster_batch.py PARTS -o result.nc                  one process; parts in PARTS are not computed again

PARTS is a folder that all machines can access. A repeated command computes only the parts that are missing there.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

import pftwin
from pftwin import PftwinError
from pftwin.base.spatial import Vec3
from pftwin.files.result_files import save_dataset

FARTHEST_MEDIAL, FARTHEST_DISTAL = 0.015, 0.010  # [m]


def transferred(scene: pftwin.Scene, row: jax.Array) -> pftwin.Scene:
    """Moves the patellar tendon's origin on the tibia medially by row[0] and distally by row[1] [m]."""
    tendon: Any = scene.effect("patellar_tendon")
    place = Vec3(tendon.origin.x - row[1], tendon.origin.y - row[0], tendon.origin.z)
    return scene.with_effect(eqx.tree_at(lambda t: t.origin, tendon, place))


def amounts(count: int) -> np.ndarray:
    """Returns random transfers (count, 2) [m]; the seed is fixed, so that all processes use the same ones."""
    return np.random.default_rng(0).uniform(0, 1, (count, 2)) * (FARTHEST_MEDIAL, FARTHEST_DISTAL)


def joined_by_slurm() -> bool:
    """Whether srun started several processes for this job."""
    return int(os.environ.get("SLURM_NTASKS", "1")) > 1 and "SLURM_STEP_NODELIST" in os.environ


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", type=Path, help="folder for the parts, on a disk that all machines can access")
    parser.add_argument("--scene", type=Path, help="scene file; by default case 2 of the virtual rig")
    parser.add_argument("--members", type=int, default=100_000)
    parser.add_argument("--chunk", type=int, help="members of a part; by default 1,920 or more")
    parser.add_argument("--share", type=int, nargs=2, metavar=("K", "N"), help="only the K-th of N shares, from 0")
    parser.add_argument("-o", "--out", type=Path, help="NetCDF file for the whole batch")
    given = parser.parse_args(arguments)

    pftwin.configure(cpu_devices="all", cache_dir=os.environ.get("PFTWIN_CACHE"))
    jax.config.update("jax_enable_recoverability", True)  # a lost process does not stop the others
    if joined_by_slurm() and given.share is None:
        jax.distributed.initialize()  # finds the other processes from SLURM's variables
    me = f"process {jax.process_index()} of {jax.process_count()}"
    try:
        scene = pftwin.load_scene(given.scene) if given.scene else pftwin.rig.case(2, contact="P5")
        found = pftwin.simulate_batch(
            pftwin.Variants(scene, transferred, amounts(given.members)),
            dt=5e-3,
            integrator=pftwin.BDF2(),
            trajectories=False,
            parts=given.parts,
            share=given.share,
            chunk=given.chunk,
            progress=lambda done, of: print(f"{me}: {done:,} of its {of:,} members", flush=True),
        )
        print(f"{me}: {found.sizes['variant']:,} members, {int(found['failed'].sum())} failed", flush=True)
        if given.out and jax.process_index() == 0:
            save_dataset(found, given.out)
    except PftwinError as error:
        print(f"{me}: error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
