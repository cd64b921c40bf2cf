"""Unique rows against NumPy's own."""

import numpy as np
import pytest

from cloth_core.unique_rows import unique_rows


@pytest.mark.parametrize("shape", [(0, 2), (1, 3), (1000, 2), (5000, 3)])
def test_unique_rows_are_those_of_numpy(shape):
    table = np.random.default_rng(1).integers(-5, 20, shape, dtype=np.int32)
    found = unique_rows(table)
    rows, first, inverse, count = np.unique(table, axis=0, return_index=True, return_inverse=True, return_counts=True)
    assert found.rows.dtype == table.dtype
    for mine, expected in zip(found, (rows, first, inverse.ravel(), count), strict=True):
        assert (mine == expected).all()
        assert mine.shape == expected.shape
