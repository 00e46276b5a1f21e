"""Types of NumPy's arrays on the host, for annotations; shapes are told where they are used."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Rows = NDArray[np.float32]  # recordings and the like, of which there are many
