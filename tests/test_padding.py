"""Few lengths, none too long, and padding with copies of a row."""

import numpy as np
import pytest

from tirefit.padding import pad_rows, padded_size


@pytest.mark.parametrize("least", [8, 256])
def test_padded_sizes_are_few_and_close(least):
    sizes = {n: padded_size(n, least) for n in range(1, 5000)}
    assert all(size >= n for n, size in sizes.items())
    assert all(size <= 1.5 * n for n, size in sizes.items() if n > least)
    assert {size for n, size in sizes.items() if n <= least} == {least}
    steps = np.unique([size for size in sizes.values()])
    ratio = steps[1:] / steps[:-1]
    assert (ratio > 1.3).all() and (ratio <= 1.5).all()


@pytest.mark.parametrize("array", [np.arange(3), np.arange(6.0).reshape(3, 2)])
def test_padding_repeats_the_first_row(array):
    padded = pad_rows(array, 5)
    assert padded.dtype == array.dtype and len(padded) == 5
    assert np.array_equal(padded[:3], array)
    assert np.array_equal(padded[3:], array[[0, 0]])
    assert np.array_equal(pad_rows(array, 3), array)
