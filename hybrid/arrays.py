"""The array type that every annotation of this package uses."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
