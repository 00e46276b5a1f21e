"""Types of NumPy arrays for annotations; shapes are documented where they are used."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Rows = NDArray[np.float32]  # large data such as recordings
