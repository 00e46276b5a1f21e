"""What a batch would take on a cluster, from what `tests.benchmarks.scaling` measured on one machine.

    python -m tests.benchmarks.extrapolation scaling.json

A process takes its start, then its own units: their steps are shared out among its devices, its host's work on them and
their writing are not. At the end it reads the parts of all processes. Processors as fast as the measured one, a file
system as fast as its disk, nobody else there: so these are bounds from below, and tell what grows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from pftwin.base.errors import InputError, PftwinError
from pftwin.dynamics.batch.batched import PIECE
from pftwin.dynamics.batch.simulate_batch import unit_for
from tests.benchmarks.row import Row
from tests.benchmarks.scaling import TOPIC

MEMBERS = (100_000, 1_000_000, 10_000_000)
_ROWS = "the rows of --only scaling"
CLUSTERS = ((1, 2), (1, 32), (4, 32), (16, 32), (64, 32))  # processes, devices of each


class Costs(NamedTuple):
    """Seconds."""

    start: float  # of a process
    call: float  # of a batch, however small
    steps: float  # of a variant on a device beside another
    host: float  # what the host does for it, in its own process
    written: tuple[float, float]  # a part, and besides for each of its variants
    read: tuple[float, float]  # the same, joined with the others


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
    alone, pair = ([r.details for r in mine.values() if r.details.get("devices") == n] for n in (1, 2))

    def value(what: str) -> float:
        found = [row.value for name, row in mine.items() if name.endswith(what)]
        if not found:
            raise InputError(f"no row '... {what}'", where="figures", expected=_ROWS)
        return found[0]

    def line(*what: str) -> tuple[float, float]:
        parts = sorted({r.details["part"] for r in mine.values() if "part" in r.details})
        if len(parts) < 2:
            raise InputError("no parts of two sizes", where="figures", expected=_ROWS)
        few, many = (sum(1e-3 * value(f"{n:,} variants: {w}") for w in what) for n in (parts[0], parts[-1]))
        slope = max(0.0, (many - few) / (parts[-1] - parts[0]))
        return few - slope * parts[0], slope

    if len(alone) < 2 or not pair:
        raise InputError("no batches on one device, or on two", where="figures", expected=_ROWS)
    few, many = (max(alone, key=lambda d, s=sign: s * d["members"]) for sign in (-1, 1))
    busy = max(pair, key=lambda d: d["members"])  # both cores compute, and share what a processor has but once
    host = (many["outside_s"] - few["outside_s"]) / (many["members"] - few["members"])
    return Costs(
        start=value("programs kept"),
        call=few["outside_s"],
        steps=2 * busy["programs_s"] / busy["members"],
        host=max(host, 0.0),
        written=line("written"),
        read=line("read", "joined"),
    )


def share_of(costs: Costs, members: int, processes: int, devices: int) -> Share:
    """Of so many processes, each with so many devices."""
    unit = unit_for(members, PIECE)
    units = math.ceil(members / unit)
    own_units = math.ceil(units / processes)
    own = min(members, own_units * unit)
    rounds = math.ceil(own / (PIECE * devices))
    return Share(
        start=costs.start + costs.call,
        steps=rounds * PIECE * costs.steps,
        host=own * costs.host,
        written=own_units * costs.written[0] + own * costs.written[1],
        read=units * costs.read[0] + members * costs.read[1],
    )


def serial_fraction(costs: Costs) -> float:
    """Of a variant's time on one device, what more devices in the same process do not share out."""
    return costs.host / (costs.host + costs.steps)


def markdown(costs: Costs) -> str:
    """The tables for docs/benchmarks.md."""
    lines = ["| what | measured |", "|---|---:|"]
    named = {
        "start of a process, programs kept": f"{costs.start:.1f} s",
        "a call, besides its variants": f"{1e3 * costs.call:.0f} ms",
        "a variant's steps, on a device beside another": f"{1e3 * costs.steps:.2f} ms",
        "a variant on its process's host": f"{1e6 * costs.host:.1f} us",
        "writing a part, and besides for each of its variants": _both(costs.written),
        "reading and joining it, and for each of its variants": _both(costs.read),
        "**serial fraction** of one process": f"**{100 * serial_fraction(costs):.2f} %**",
    }
    lines += [f"| {what} | {text} |" for what, text in named.items()]
    lines += ["", "| variants | processes x devices | time | of the devices' time spent on steps | longest |"]
    lines += ["|---:|---:|---:|---:|---|"]
    for members in MEMBERS:
        for processes, devices in CLUSTERS:
            share = share_of(costs, members, processes, devices)
            used = members * costs.steps / (share.whole * processes * devices)
            seconds = getattr(share, share.largest)
            most = f"{share.largest}, {seconds:,.0f} s" if seconds >= 100 else f"{share.largest}, {seconds:.3g} s"
            lines.append(
                f"| {members:,} | {processes} x {devices} | {share.whole:,.0f} s | {100 * used:.0f} % | {most} |"
            )
    return "\n".join(lines)


def _both(cost: tuple[float, float]) -> str:
    return f"{1e3 * cost[0]:.1f} ms, {1e6 * cost[1]:.1f} us"


app = typer.Typer(add_completion=False)


@app.command()
def main(file: Annotated[Path, typer.Argument(help="What `--only scaling --out FILE` wrote.")]) -> None:
    """The tables of docs/benchmarks.md, from a file of figures.

    Example: python -m tests.benchmarks.extrapolation scaling.json
    """
    from tests.benchmarks.report import from_json

    try:
        typer.echo(markdown(costs_of(from_json(file)[0])))
    except PftwinError as error:
        typer.echo(f"error: {error}", err=True)
        raise typer.Exit(2) from None


if __name__ == "__main__":
    app()
