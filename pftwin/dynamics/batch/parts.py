"""Reads a batch that was computed in parts: the whole, or the parts that exist."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pftwin.base.errors import InputError
from pftwin.dynamics.batch.part_files import BatchIndex, part_file, read_index, read_part

if TYPE_CHECKING:
    from xarray import Dataset

_NAMED = 5  # parts in a message


def read_parts(folder: str | os.PathLike[str], *, incomplete: bool = False) -> Dataset:
    """The dataset of a batch that `pftwin.simulate_batch(..., parts=folder)` computes, or has computed.

    Args:
        folder: of the parts.
        incomplete: take what is there; `variant` says which members those are.

    Returns:
        What `simulate_batch` returns.

    Raises:
        InputError: no such batch; parts that are missing or damaged, unless `incomplete` is given; none at all.
    """
    place = Path(folder)
    index = read_index(place)
    there, wrong = _looked_through(place, index)
    if wrong and not (incomplete and there):
        first = next(iter(wrong.values()))
        named = ", ".join(part_file(place, u).name for u in list(wrong)[:_NAMED])
        more = f" and {len(wrong) - _NAMED} more" if len(wrong) > _NAMED else ""
        raise InputError(
            f"{len(wrong)} of {len(index.units)} parts are missing or damaged: {named}{more} ({first})",
            where=place,
            remedy="simulate_batch again with the same folder: it computes only these"
            + ("; or incomplete=True for the others" if there else ""),
        )
    return concatenated_parts(list(there.values()))


def missing_parts(folder: str | os.PathLike[str]) -> dict[int, str]:
    """Which units of a batch are still to be computed, each with what is wrong. Reads all parts.

    Raises:
        InputError: no such batch.
    """
    place = Path(folder)
    return _looked_through(place, read_index(place))[1]


def _looked_through(folder: Path, index: BatchIndex) -> tuple[dict[int, Dataset], dict[int, str]]:
    there: dict[int, Dataset] = {}
    wrong: dict[int, str] = {}
    for unit in range(len(index.units)):
        try:
            there[unit] = read_part(folder, unit, index, like=next(iter(there.values()), None))
        except InputError as error:
            wrong[unit] = str(error)
    return there, wrong


def concatenated_parts(parts: Sequence[Dataset]) -> Dataset:
    """Members of several units, in the order in which the batch has them."""
    from xarray import concat

    from pftwin.dynamics.batch.batch_dataset import summed_up

    common = set(parts[0].data_vars).intersection(*(part.data_vars for part in parts))
    whole = concat(
        [part.drop_vars(set(part.data_vars) - common) for part in parts],
        dim="variant",
        data_vars="minimal",
        coords="minimal",
        compat="override",
        join="override",
        combine_attrs="override",
    )
    if not whole.indexes["variant"].is_monotonic_increasing:  # scenes of several structures
        whole = whole.sortby("variant")
    return whole.assign_attrs(summed_up(whole))
