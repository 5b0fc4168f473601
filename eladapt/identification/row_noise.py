"""How the noise of a log's rows hangs together in time and between joints, told by what a fit leaves.

A fit takes some of the noise: what is left, r = M e with M = 1 - A F A', is smaller, and less alike from row
to row. With C_j(l) the covariance of joint j's noise at lag l and D_i(m) the matrix that pairs joint i's rows
m apart, E[r' D_i(m) r] = sum over j, l of tr(D_i(m) M D_j(l) M) C_j(l): equations for C, whose traces need
nothing but the sums X_i(m) = A' D_i(m) A.
"""

from __future__ import annotations

import numpy as np

from eladapt.identification.rows import OVERLAP

LONGEST = 3  # windows, over which noise may last beyond its own
SIGNIFICANT = 4.0  # standard deviations of a correlation that is none


def noise_covariances(
    residual: np.ndarray, seen: np.ndarray, weight: np.ndarray, holds: np.ndarray
) -> np.ndarray:
    """C (lags, nv, nv) of the noise of rows, lags counted from window to window.

    residual (n, nv), 0 where a row does not hold; seen (n, nv, k): the rows in directions in which F is
    diagonal, and weight (k,) that diagonal. Lags go on as long as residuals are alike beyond chance, at least
    over the windows that overlap. Between joints, covariances are those of the residuals.
    """
    n, nv = residual.shape
    lags = _lags(residual, holds)
    products = _products(seen, weight, 2 * lags)
    statistics, system = np.zeros((nv, lags)), np.zeros((nv, lags, nv, lags))
    for m in range(lags):
        pairs = holds[: n - m] & holds[m:]
        both = 1 if m == 0 else 2
        statistics[:, m] = both * np.sum(residual[: n - m] * residual[m:], axis=0)
        for i in range(nv):
            system[i, m, i, m] += both * pairs[:, i].sum()
            for j in range(lags):  # D(j) D(m) = D(j + m) + D(|j - m|), D(0) counted twice
                trace = np.trace(products[i, j + m]) if not j or not m else (
                    np.trace(products[i, j + m]) + np.trace(products[i, abs(j - m)]) * (2 if j == m else 1)
                )  # fmt: skip
                system[i, m, i, j] -= 2 * trace
    flat = products[:, :lags].reshape(nv * lags, -1)
    turned = products[:, :lags].transpose(0, 1, 3, 2).reshape(nv * lags, -1)
    system = system.reshape(nv * lags, nv * lags) + flat @ turned.T
    own = np.linalg.lstsq(system, statistics.ravel(), rcond=1e-10)[0].reshape(nv, lags)
    found = np.zeros((lags, nv, nv))
    for m in range(lags):
        pairs = holds[: n - m].astype(float).T @ holds[m:]
        found[m] = residual[: n - m].T @ residual[m:] / np.maximum(pairs, 1)
        found[m, range(nv), range(nv)] = own[:, m]
    return found


def _products(seen: np.ndarray, weight: np.ndarray, lags: int) -> np.ndarray:
    """(nv, lags, k, k): F^1/2 X_i(m) F^1/2."""
    n, nv, size = seen.shape
    scaled = seen * np.sqrt(weight)
    found = np.zeros((nv, lags, size, size))
    for i in range(nv):
        rows = np.ascontiguousarray(scaled[:, i])
        for m in range(min(lags, n)):
            part = rows[: n - m].T @ rows[m:]
            found[i, m] = part if m == 0 else part + part.T
    return found


def _lags(residual: np.ndarray, holds: np.ndarray) -> int:
    """How many lags to look at."""
    n = len(residual)
    longest = max(1, min((1 + LONGEST) * OVERLAP, n // 4))
    variance = np.maximum(np.sum(residual**2, axis=0), 1e-300)
    for lag in range(OVERLAP, longest):
        alike = np.abs(np.sum(residual[: n - lag] * residual[lag:], axis=0)) / variance
        if np.all(alike < SIGNIFICANT / np.sqrt(np.maximum(holds.sum(axis=0), 1))):
            return lag
    return longest
