"""What a batch would take on a cluster, from what `pftwin.benchmarks.scaling` measured on one machine.

    python -m pftwin.benchmarks.extrapolation scaling.json

A process takes its start, then its own units: their steps are shared out among its devices, its host's work on them and
their writing are not. At the end it reads the parts of all processes. Processors as fast as the measured one, a file
system as fast as its disk, nobody else there: so these are bounds from below, and tell what grows.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from pftwin.batch.simulate_batch import unit_for
from pftwin.batches import PIECE
from pftwin.benchmarks.row import Row
from pftwin.benchmarks.scaling import PART, TOPIC
from pftwin.errors import InputError

MEMBERS = (100_000, 1_000_000, 10_000_000)
CLUSTERS = ((1, 2), (1, 32), (4, 32), (16, 32), (64, 32), (256, 32))  # processes, devices of each


class Costs(NamedTuple):
    """Seconds; of a variant where nothing else is said."""

    start: float  # of a process
    call: float  # of a batch, however small
    steps: float  # on one device
    host: float  # what the host does for it, in its own process
    written: float  # of a part of PART variants
    read: float  # of such a part
    joined: float


class Share(NamedTuple):
    """Where the slowest process's seconds go."""

    start: float
    steps: float
    host: float
    written: float
    read: float  # of all parts, by every process

    @property
    def whole(self) -> float:
        """All of it."""
        return sum(self)

    @property
    def largest(self) -> str:
        """The name of what takes most."""
        return max(self._fields, key=lambda name: getattr(self, name))


def costs_of(rows: Sequence[Row]) -> Costs:
    """The model's constants.

    Raises:
        InputError: rows are missing.
    """
    mine = {row.what: row for row in rows if row.topic == TOPIC}
    alone = [r.details for r in mine.values() if r.details.get("devices") == 1 and "members" in r.details]

    def value(what: str) -> float:
        found = [row.value for name, row in mine.items() if name.endswith(what)]
        if not found:
            raise InputError(f"no row '... {what}'", where="figures", expected="the rows of --only scaling")
        return found[0]

    if len(alone) < 2:
        raise InputError("no batches on one device", where="figures", expected="the rows of --only scaling")
    few, many = (max(alone, key=lambda d, s=sign: s * d["members"]) for sign in (-1, 1))
    host = (many["outside_s"] - few["outside_s"]) / (many["members"] - few["members"])
    return Costs(
        start=value("programs kept"),
        call=few["outside_s"],
        steps=many["programs_s"] / many["members"],
        host=max(host, 0.0),
        written=1e-3 * value(": written"),
        read=1e-3 * value(": read"),
        joined=1e-6 * value("joined: time per variant"),
    )


def share_of(costs: Costs, members: int, processes: int, devices: int) -> Share:
    """Of so many processes, each with so many devices."""
    unit = unit_for(members, PIECE)
    units = math.ceil(members / unit)
    own = min(members, math.ceil(units / processes) * unit)
    rounds = math.ceil(own / (PIECE * devices))
    as_parts = unit / PART  # a part's cost goes with what it holds
    return Share(
        start=costs.start + costs.call,
        steps=rounds * PIECE * costs.steps,
        host=own * costs.host,
        written=own / unit * as_parts * costs.written,
        read=units * as_parts * costs.read + members * costs.joined,
    )


def serial_fraction(costs: Costs) -> float:
    """Of a variant's time on one device, what more devices in the same process do not share out."""
    return costs.host / (costs.host + costs.steps)


def markdown(costs: Costs) -> str:
    """The tables for docs/scaling.md."""
    lines = ["| what | measured |", "|---|---:|"]
    named = {
        "start of a process, programs kept": f"{costs.start:.1f} s",
        "a call, besides its variants": f"{1e3 * costs.call:.0f} ms",
        "a variant's steps, on a device": f"{1e3 * costs.steps:.2f} ms",
        "a variant on its process's host": f"{1e6 * costs.host:.1f} us",
        f"a part of {PART:,} variants, written": f"{1e3 * costs.written:.0f} ms",
        f"a part of {PART:,} variants, read": f"{1e3 * costs.read:.1f} ms",
        "joining, a variant": f"{1e6 * costs.joined:.2f} us",
        "**serial fraction** of one process": f"**{100 * serial_fraction(costs):.2f} %**",
    }
    lines += [f"| {what} | {text} |" for what, text in named.items()]
    lines += ["", "| variants | processes x devices | time | of the devices' time spent on steps | longest |"]
    lines += ["|---:|---:|---:|---:|---|"]
    for members in MEMBERS:
        for processes, devices in CLUSTERS:
            share = share_of(costs, members, processes, devices)
            used = members * costs.steps / (share.whole * processes * devices)
            most = f"{share.largest}, {getattr(share, share.largest):.3g} s"
            lines.append(
                f"| {members:,} | {processes} x {devices} | {share.whole:,.0f} s | {100 * used:.0f} % | {most} |"
            )
    return "\n".join(lines)


def main(name: str) -> None:
    """Prints the tables of a file of figures."""
    from pftwin.benchmarks.report import from_json

    print(markdown(costs_of(from_json(Path(name))[0])))


if __name__ == "__main__":
    main(sys.argv[1])
