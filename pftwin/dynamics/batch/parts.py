"""Reading of a batch that was computed in parts, completely or as far as parts exist."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pftwin.base.errors import InputError
from pftwin.dynamics.batch.part_files import BatchIndex, part_file, read_index, read_part

if TYPE_CHECKING:
    from xarray import Dataset

_NAMED = 5  # largest number of parts listed in a message


def read_parts(folder: str | os.PathLike[str], *, incomplete: bool = False) -> Dataset:
    """Reads the dataset of a batch from `pftwin.simulate_batch(..., parts=folder)`, also while it runs.

    Args:
        folder: folder of the parts.
        incomplete: whether to read only the existing parts; `variant` then identifies the variants.

    Returns:
        The dataset, as from `simulate_batch`.

    Raises:
        InputError: the folder contains no batch, or parts are missing or damaged: any part or, with `incomplete`, all.
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
    """Units of a batch that remain to be computed, each with the reason. Reads all parts.

    Raises:
        InputError: the folder contains no batch.
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
    """Concatenates the variants of several units, in the order of the batch."""
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
