"""Values that depend on others, which depend on others, without cycles."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    from scipy.sparse import csr_array


def resolve(step: "csr_array", is_free: Float[np.ndarray, "n"]) -> "csr_array":
    """From what every dependent value is made of to what it is made of in the end: free values alone."""
    from scipy.sparse import csr_array, diags_array

    step = csr_array(step + diags_array(is_free))
    while step[:, np.flatnonzero(is_free == 0)].nnz:
        step = csr_array(step @ step)
        step.eliminate_zeros()
    return step
