"""The kernels' equations once more, by LAPACK and numpy, matrix by matrix: what the loops are judged by."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from eladapt.estimation.extensions import Information


def triangle_of(matrix: np.ndarray) -> np.ndarray:
    """The upper triangle of a QR factorisation, with as many rows as columns and a positive diagonal."""
    size = matrix.shape[1]
    padded = np.vstack([matrix, np.zeros((max(0, size - len(matrix)), size))])
    upper = np.linalg.qr(padded, mode="r")[:size]
    return upper * np.where(np.diag(upper) < 0, -1.0, 1.0)[:, None]


def updated(triangle: np.ndarray, kept: float, weight: float, omega: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The triangle of [sqrt(kept) T; sqrt(weight) [Omega | y]]."""
    rows = np.sqrt(weight) * np.column_stack([omega, y])
    return triangle_of(np.vstack([np.sqrt(kept) * triangle, rows]))


def subspace_step(
    matrix: np.ndarray, vector: np.ndarray, omega: np.ndarray, y: np.ndarray, weight: float, share: float
) -> tuple[np.ndarray, np.ndarray]:
    """R and s after R <- R - share R V (V'R V)^-1 V'R + weight Omega'Omega, V spanning the rows of Omega."""
    V = np.linalg.svd(omega, full_matrices=False)[2].T
    inner = np.linalg.pinv(V.T @ matrix @ V, hermitian=True)
    gone = share * matrix @ V @ inner @ V.T
    return (
        matrix - gone @ matrix + weight * omega.T @ omega,
        vector - gone @ vector + weight * omega.T @ y,
    )


def gain(information: Information) -> np.ndarray:
    """Phi = (prior I + R)^-1 R of (488), or R itself where there is no prior (832)."""
    matrix, prior = information.matrix, information.prior
    return np.linalg.solve(prior * np.eye(len(matrix)) + matrix, matrix) if prior else matrix


def prediction_error(information: Information, theta: np.ndarray) -> np.ndarray:
    """r = Y - Phi theta."""
    matrix, vector, prior = information.matrix, information.vector, information.prior
    full = prior * np.eye(len(matrix)) + matrix
    return (np.linalg.solve(full, vector) if prior else vector) - gain(information) @ theta


def told(information: Information, rows: np.ndarray) -> np.ndarray:
    """1 - prior c'F c / c'c of each row c."""
    solved = solve_triangular(information.triangle[:-1, :-1], rows.T, trans="T")
    return 1 - information.prior * np.sum(solved**2, axis=0) / np.sum(rows**2, axis=1)
