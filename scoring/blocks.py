"""Sums and quantiles over columns of any length, taken block by block: the same bits whole or in pieces.

A sum of floating-point numbers depends on the order of its terms. Here a column is cut at multiples of :data:`BLOCK`
rows, each block is summed by numpy, and the blocks are added up from the first to the last. Quantiles are exact: they
are found digit by digit of the numbers' bits, in passes that hold one block and a few histograms.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

BLOCK = 1 << 17  # rows
_DIGIT_BITS = 16
_DIGITS = 1 << _DIGIT_BITS


class Store(Protocol):
    """Keeps arrays and gives them again, in their order: a list, or a temporary file."""

    def append(self, rows: NDArray[Any], /) -> None:
        """Keep one more array."""

    def __iter__(self) -> Iterator[NDArray[Any]]:
        """Yield all arrays, from the first."""


def list_blocks(count: int) -> list[slice]:
    """Return the rows of each block of a column of ``count`` rows."""
    return [slice(first, min(first + BLOCK, count)) for first in range(0, count, BLOCK)]


def split_rows(values: NDArray[Any]) -> list[NDArray[Any]]:
    """Return the blocks of a column (N, ...)."""
    return [values[rows] for rows in list_blocks(len(values))]


def join_rows(arrays: Iterable[NDArray[Any]]) -> Iterator[NDArray[Any]]:
    """Yield the rows of arrays of any lengths as blocks of exactly :data:`BLOCK` rows; the last may be shorter."""
    waiting: list[NDArray[Any]] = []
    count = 0
    for array in arrays:
        waiting.append(array)
        count += len(array)
        while count >= BLOCK:
            rows = np.concatenate(waiting)
            yield rows[:BLOCK]
            waiting, count = [rows[BLOCK:]], count - BLOCK
    if count:
        yield np.concatenate(waiting)


def sum_blocks(blocks: Iterable[NDArray[Any]]) -> Any:
    """Return the sum over the rows of all blocks: a number, or an array of the shape of a row."""
    total: Any = 0.0
    for block in blocks:
        total = total + block.sum(axis=0)
    return total


def find_quantiles(blocks: Iterable[NDArray[Any]], count: int, shares: Sequence[float]) -> list[float]:
    """Return quantiles of ``count`` numbers >= 0, as ``np.quantile`` does; ``blocks`` is gone through up to four times.

    The numbers are float64 or int64, whose bits, read as whole numbers, have the order of the numbers.
    """
    if count <= BLOCK:
        return [float(found) for found in np.quantile(np.concatenate(list(blocks)), shares)]
    places = [(count - 1) * share for share in shares]
    ranks = sorted({rank for place in places for rank in (int(place), min(int(place) + 1, count - 1))})
    value_at = dict(zip(ranks, _find_ranks(blocks, ranks), strict=True))
    return [
        float(np.quantile([value_at[int(place)], value_at[min(int(place) + 1, count - 1)]], place - int(place)))
        for place in places
    ]


def _find_ranks(blocks: Iterable[NDArray[Any]], ranks: Sequence[int]) -> list[Any]:
    """Return the numbers at these places of the sorted column, in its type: whole numbers beyond 2^53 stay exact."""
    begins = {rank: (0, rank) for rank in ranks}  # rank -> the leading bits of its number, and its place among theirs
    kind = np.dtype(np.float64)
    for shift in range(64 - _DIGIT_BITS, -1, -_DIGIT_BITS):
        counts = {leading: np.zeros(_DIGITS, np.int64) for leading, _ in begins.values()}
        for block in blocks:
            kind = block.dtype
            bits = np.ascontiguousarray(block).view(np.uint64)
            digits = bits >> np.uint64(shift)
            leads = digits >> np.uint64(_DIGIT_BITS)
            digits &= np.uint64(_DIGITS - 1)
            for leading, histogram in counts.items():
                same = digits if shift == 64 - _DIGIT_BITS else digits[leads == leading]
                histogram += np.bincount(same.astype(np.int64), minlength=_DIGITS)
        for rank, (leading, place) in begins.items():
            upto = np.cumsum(counts[leading])
            digit = int(np.searchsorted(upto, place, side="right"))
            before = int(upto[digit - 1]) if digit else 0
            begins[rank] = ((leading << _DIGIT_BITS) | digit, place - before)
    return [np.uint64(begins[rank][0]).view(kind) for rank in ranks]
