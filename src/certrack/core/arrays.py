"""The one name that signatures have for arrays."""

import numpy as np

#: Numbers in an array; the docstring says its shape and unit.
Array = np.ndarray
