"""A temporary store returns its rows in the order and the lengths in which they were appended."""

import numpy as np
import pytest

from stillpoint.datasets.files import scratch
from stillpoint.datasets.files.scratch import ScratchStore


@pytest.mark.parametrize("in_memory", [1, 1 << 20])
def test_arrays_come_back_in_several_passes_side_by_side(in_memory: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scratch, "IN_MEMORY", in_memory)
    store, given = ScratchStore(), [np.arange(12.0).reshape(4, 3), np.empty((0, 3)), np.full((2, 3), np.nan)]
    for rows in given:
        store.append(rows)
    for one, other, rows in zip(store, store, given, strict=True):
        np.testing.assert_array_equal(one, rows)
        np.testing.assert_array_equal(other, rows)


def test_columns_of_several_types_come_back() -> None:
    store, rows = ScratchStore(), np.zeros(3, [("t_ns", np.int64), ("q_nb", np.float64, 4), ("moving", "?")])
    rows["t_ns"], rows["moving"] = [1, 2, 3], [True, False, True]
    store.append(rows)
    np.testing.assert_array_equal(next(iter(store)), rows)
