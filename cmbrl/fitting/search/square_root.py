"""Square roots of information: matrices R with R^T R = H, in which what a log hardly tells is not lost in rounding.

A log without noise tells some combinations of parameters 1e15 times as well as the prior does, or better, and others
not at all. H holds both in doubles only where they differ by less than 1e16; R holds the roots of both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_ROWS = 4  # times as many as columns, before they become a triangle again


class Rows:
    """Collects rows (m, n) of R, as a triangle (n, n) and what has come since."""

    def __init__(self, columns: int) -> None:
        self.columns, self.parts = columns, [np.zeros((0, columns))]

    def add(self, rows: np.ndarray, told: np.ndarray) -> None:
        """Takes ``rows`` (m, k) of the columns ``told`` (k,) alone."""
        whole = np.zeros((len(rows), self.columns))
        whole[:, told] = rows
        self.parts.append(whole)
        if sum(map(len, self.parts)) > _ROWS * self.columns:
            self.parts = [self.root()]

    def root(self) -> np.ndarray:
        """R (at most n, n) of all rows so far."""
        return np.asarray(np.linalg.qr(np.vstack(self.parts), mode="r"))


def root_of(matrix: np.ndarray) -> np.ndarray:
    """R (n, n) of a positive semidefinite ``matrix`` (n, n), as well as its doubles tell."""
    diagonal = np.diag(matrix)
    size = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    return (np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T) * size


def add_squares(matrix: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> None:
    """Adds R^T R of ``rows`` (s, k, steps, c), by column first, to those ``columns`` (k,) of ``matrix`` (n, n).

    Coordinates c of limbs that do not touch depend on parameters of their own: only products of columns that some
    coordinate has together are formed.
    """
    supports, part = np.unique((rows != 0.0).any(axis=(0, 2)), axis=1, return_inverse=True)  # columns by coordinate
    for k, support in enumerate(supports.T):
        told, own = np.flatnonzero(support), np.flatnonzero(part.ravel() == k)
        place = np.ix_(columns[told], columns[told])
        for window in rows:
            some = (
                window[told]
                if supports.shape[1] == 1
                else window[told[:, None, None], np.arange(window.shape[1])[:, None], own]
            )
            flat = some.reshape(len(told), window.shape[1] * len(own))
            matrix[place] += flat @ flat.T


def without(root: np.ndarray, silent: np.ndarray) -> np.ndarray:
    """P (n, n) such that R P tells nothing of the directions ``silent`` (n, k), and else what R (m, n) tells."""
    size = np.linalg.norm(root, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    basis = np.linalg.qr(size[:, None] * silent)[0]
    return np.asarray(np.eye(len(size)) - ((basis @ basis.T) * size) / size[:, None])


@dataclass(frozen=True)
class Inverse:
    """The inverse A^-1 = T T^T of A = R^T R, by its factor ``half`` T (n, n)."""

    half: np.ndarray

    @classmethod
    def of(cls, root: np.ndarray) -> Inverse:
        """Of ``root`` R (m, n) of full rank. Raises LinAlgError where rounding has left it less."""
        size = np.linalg.norm(root, axis=0)
        _, values, vectors = np.linalg.svd(root / size, full_matrices=False)
        if not values[-1] > 0.0:
            raise np.linalg.LinAlgError("a matrix without an inverse")
        return cls(vectors.T / values / size[:, None])

    @property
    def matrix(self) -> np.ndarray:
        """A^-1 (n, n)."""
        return np.asarray(self.half @ self.half.T)

    def around(self, root: np.ndarray) -> np.ndarray:
        """A^-1 R^T R A^-1 (n, n) of another ``root`` (m, n), positive semidefinite also in rounding."""
        rows = (root @ self.half) @ self.half.T
        return np.asarray(rows.T @ rows)
