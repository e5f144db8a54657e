"""LINEAR SIMPLEX: constant weights that are shares: none is negative and they sum to one."""

from __future__ import annotations

import numpy as np

from mixo_env.fusion import FloatArray
from mixo_env.policies.linear import Linear
from mixo_env.recordings.collection import Recordings


class LinearSimplex(Linear):
    """LINEAR with its weights confined to the simplex.

    The paper's printed weights sum to 1.037, so this is not its LINEAR. With the sum fixed a common error of all
    experts cannot be scaled away, and in return standing still stays standing still for any expert.
    """

    name = "LINEAR SIMPLEX"

    def fit(self, training: Recordings, track: str, *, seed: int = 0) -> None:
        """Solve for the weights on the same steps as LINEAR."""
        self.start(training.voters(track))
        self.weights = simplex_weights(*self._samples(training, track))


def simplex_weights(increments_rad: FloatArray, truth_rad: FloatArray) -> FloatArray:
    """Shares ``(N,)`` of least squared error: the point nearest zero in the convex hull of the error columns.

    Minimising |E u|^2 + (1 - sum u)^2 over u >= 0 gives u in the direction of that point, because at fixed direction
    the minimum over the length grows with |E w|^2 (Lawson and Hanson 1974, chapter 23).

    Args:
        increments_rad: ``(T, N)``, finite.
        truth_rad: ``(T,)``.
    """
    from scipy.optimize import nnls

    error = np.asarray(increments_rad, dtype=np.float64) - np.asarray(truth_rad, dtype=np.float64)[:, None]
    triangle = np.linalg.qr(error).R
    size = float(np.sqrt(np.mean(triangle**2))) or 1.0
    rows = np.vstack([triangle / size, np.ones(error.shape[1])])
    found, _ = nnls(rows, np.concatenate([np.zeros(len(triangle)), [1.0]]))
    return found / found.sum()
