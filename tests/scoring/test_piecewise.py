"""A score in pieces has the bits of a score of the whole, wherever the pieces end."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Estimate, Reference, Truth
from stillpoint.datasets.errors import BadParameter, Unobservable
from stillpoint.datasets.files import scratch
from stillpoint.datasets.files.scratch import ScratchStore
from stillpoint.datasets.frames import quaternion
from stillpoint.scoring import blocks, score, score_row
from stillpoint.scoring.blocks import find_quantiles, join_rows
from stillpoint.scoring.piecewise import ALIGN_PIECES, score_pieces

RNG = np.random.default_rng(3)


def _swing(t_ns: np.ndarray, off_deg: float) -> np.ndarray:
    """Attitudes of a body that swings about all axes, wrong by some noise."""
    t_s = t_ns / 1e9
    true = Rotation.from_euler("ZYX", np.stack([np.sin(t_s), 0.5 * np.cos(0.7 * t_s), 0.3 * np.sin(1.3 * t_s)], axis=1))
    noise = Rotation.from_rotvec(np.deg2rad(off_deg) * RNG.normal(size=(len(t_ns), 3)))
    return quaternion(Rotation.from_euler("Z", 0.4) * true * noise) if off_deg else quaternion(true)


def _stamps(n: int, step_ns: int) -> np.ndarray:
    t_ns = np.arange(n, dtype=np.int64) * step_ns + RNG.integers(-step_ns // 20, step_ns // 20, n) + step_ns
    t_ns[n // 3 :] += 30 * step_ns  # a gap
    return t_ns


def _estimate(n: int = 1600, step_ns: int = 10_000_000, with_cov: bool = True) -> Estimate:
    t_ns = _stamps(n, step_ns)
    ready = np.arange(n) > 50
    cov = np.tile(np.diag([1e-4, 2e-4, 3e-4]), (n, 1, 1)) if with_cov else None
    return Estimate(t_ns, "ours", q_nb=_swing(t_ns, 1.0), cov_b_rad2=cov, ready=ready, recording="run")


def _truth(n: int = 1400, step_ns: int = 10_000_000) -> Truth:
    t_ns = _stamps(n, step_ns)
    return Truth(t_ns, _swing(t_ns, 0.0), moving=(np.arange(n) // 120) % 3 != 1)


def _reference(n: int = 1400) -> Reference:
    t_ns = _stamps(n, 10_000_000)
    cov = np.tile(np.eye(3) * 1e-5, (n, 1, 1)) * RNG.uniform(0.5, 2, n)[:, None, None]
    rests_ns = t_ns[[[100, 300], [800, 960]]]
    return Reference(t_ns, _swing(t_ns, 0.0), cov, np.zeros((n, 3)), "ours", name="run", rests_ns=rests_ns)


def _cut(thing: Any, edges: list[int]) -> Iterator[Any]:
    """Yield the samples of a trajectory between the edges."""
    columns = {name: value for name, value in vars(thing).items() if isinstance(value, np.ndarray) and
               len(value) == len(thing.t_ns)}  # fmt: skip
    for first, last in zip([0, *edges], [*edges, len(thing.t_ns)], strict=True):
        if last > first:
            yield replace(thing, **{name: value[first:last] for name, value in columns.items()})


@pytest.fixture(autouse=True)
def _small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make several blocks of few samples, and use a file from the first byte on."""
    monkeypatch.setattr(blocks, "BLOCK", 256)
    monkeypatch.setattr(scratch, "IN_MEMORY", 1)


@pytest.mark.slow
@pytest.mark.parametrize("align", ALIGN_PIECES)
@pytest.mark.parametrize("judge", [_truth, _reference], ids=["truth", "reference"])
@pytest.mark.parametrize("step_ns", [
    pytest.param(3_000_000, id="denser"), pytest.param(10_000_000, id="equal"),
    pytest.param(70_000_000, id="sparser"),
])  # fmt: skip
def test_pieces_give_the_bits_of_the_whole(align: Any, judge: Callable[[], Any], step_ns: int) -> None:
    estimate, truth = _estimate(step_ns=step_ns), judge()
    whole = score_row(score(estimate, truth, align))
    for ours, theirs, new_store in (
        ([], [], ScratchStore),
        ([1, 2, 700], [7, 360, 361, 1399], list),
        (list(range(9, 1600, 97)), [480], ScratchStore),
    ):
        assert score_row(score_pieces(_cut(estimate, ours), _cut(truth, theirs), align, new_store=new_store)) == whole


@pytest.mark.slow
def test_a_fixed_conversion_is_found_in_pieces_as_in_the_whole() -> None:
    estimate, truth = _estimate(with_cov=False), _truth()
    estimate = replace(estimate, q_nb=estimate.q_nb * [1.0, -1.0, -1.0, -1.0])
    whole = score(estimate, truth)
    assert "inverse" in str(whole.conversion)
    assert score_pieces(_cut(estimate, [1000]), _cut(truth, [50, 600])).conversion == whole.conversion


def test_what_cannot_be_scored_is_said_in_the_words_of_the_whole() -> None:
    estimate, truth = _estimate(), _truth()
    later = replace(estimate, t_ns=estimate.t_ns + 10**12)
    with pytest.raises(Unobservable) as whole:
        score(later, truth)
    with pytest.raises(Unobservable) as pieces:
        score_pieces(_cut(later, [100]), _cut(truth, [100]))
    assert str(pieces.value) == str(whole.value)
    with pytest.raises(Unobservable, match="no sample of it moves"):
        score_pieces(_cut(estimate, []), _cut(replace(truth, moving=np.zeros_like(truth.moving)), [10]))
    with pytest.raises(BadParameter, match="pieces"):
        score_pieces(_cut(estimate, []), _cut(truth, []), "heading+mounting+time")


@pytest.mark.parametrize("make", [
    lambda rng, n: rng.exponential(size=n), lambda _, n: np.full(n, 2.5), lambda rng, n: np.round(rng.uniform(0, 3, n)),
    lambda rng, n: rng.integers(0, 2**60, n), lambda _, n: np.concatenate([np.zeros(n - 1), [np.finfo(float).max]]),
], ids=["continuous", "constant", "few values", "whole numbers", "extremes"])  # fmt: skip
@pytest.mark.parametrize("count", [1, 2, 255, 256, 257, 1000, 2001])
def test_quantiles_over_blocks_are_those_of_numpy(
    make: Callable[[np.random.Generator, int], np.ndarray], count: int
) -> None:
    for seed in range(5):
        numbers, shares = make(np.random.default_rng(seed), count), (0.0, 0.5, 0.95, 0.99, 1.0)
        found = find_quantiles(list(join_rows(np.array_split(numbers, 3))), count, shares)
        assert found == [float(one) for one in np.quantile(numbers, shares)]
