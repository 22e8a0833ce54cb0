"""Normal equations by limbs equal those of all columns at once."""

from __future__ import annotations

import numpy as np
import pytest

from cmbrl.fitting.search.square_root import add_squares

LIMBS = {
    "one": [[1, 1, 1, 1]],
    "two and a shared one": [[1, 1, 0, 0], [0, 0, 1, 1], [1, 1, 1, 1]],
    "none": [[0, 0, 0, 0]],
}


@pytest.mark.parametrize("limbs", LIMBS)
def test_products_of_limbs_are_those_of_all_columns(limbs: str) -> None:
    rng, on = np.random.default_rng(0), np.repeat(np.array(LIMBS[limbs], dtype=float), 3, axis=0)  # (k, coordinates)
    rows, columns = rng.normal(size=(5, len(on), 7, 4)) * on[None, :, None], rng.permutation(12)[: len(on)]
    matrix = rng.normal(size=(12, 12))
    wanted, flat = matrix.copy(), np.moveaxis(rows, 1, -1).reshape(-1, len(on))
    wanted[np.ix_(columns, columns)] += flat.T @ flat
    add_squares(matrix, rows, columns)
    np.testing.assert_allclose(matrix, wanted, atol=1e-12)
