"""The setting in which effects are built: where files lie, which side, and what the guided bodies do."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.files.scene_file.document import Document
from pftwin.files.scene_file.side import HostPose, Side
from pftwin.model.motion import KneeMotion

if TYPE_CHECKING:
    from pftwin.geometry.patch.sphere import SphereFit


@dataclass(frozen=True)
class Setting:
    """What an effect's table needs to become an effect."""

    document: Document
    side: Side
    mass: float  # of the patella [kg]
    motion: KneeMotion
    fixed_femur: HostPose | None  # its pose in the world (mirrored); the scene's world is then the femur's frame
    start: HostPose  # the patella's frame in the femur's at the first frame
    contact: str | None = None  # polynomial asked for on the command line, in place of the file's
    buttons: dict[str, SphereFit] = field(default_factory=dict)  # fitted spheres by contact, patella frame
    notes: list[str] = field(default_factory=list)  # for the user to read

    def path(self, name: str) -> str:
        """A file's path; relative ones start at the scene file.

        Raises:
            InputError: it leads out of the scene's folder, and that is not allowed.
        """
        return str(self.document.file(name))

    def points(self, frame: str, values: ArrayLike) -> NDArray[np.float64]:
        """Points (..., 3) of a body's frame, mirrored where the knee is a left one, in the scene's frames."""
        mirrored = self.side.points(frame, values)
        if frame == "ground" and self.fixed_femur is not None:
            return self.fixed_femur.inverse().apply(mirrored)
        return mirrored

    def world_direction(self, values: ArrayLike) -> NDArray[np.float64]:
        """A direction of the world in the scene's world."""
        mirrored = self.side.points("world", values)
        return mirrored if self.fixed_femur is None else mirrored @ self.fixed_femur.matrix
