"""Names for the arrays that pass between the rooms.

Shapes stand in the docstrings; ``...`` in a shape means any leading batch axes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[Any]
"""A float64 array, or an array of recorded scalars while a function is being recorded."""

FloatArray = NDArray[np.float64]
"""A float64 array that is never recorded."""

__all__ = ["Array", "ArrayLike", "FloatArray"]
