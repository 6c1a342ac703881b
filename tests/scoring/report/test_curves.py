"""Curves of a page: reduced without losing a peak, broken at gaps and wraps, encoded to the stated precision."""

import base64

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillpoint.scoring.report.curves import LOWEST_DEG, coarsen_curve, encode_curve, reduce_angle, reduce_series


def decode(encoded):
    """The inverse of the encoding, as the page's script does it."""
    whole = np.frombuffer(base64.b64decode(encoded["data"]), dtype="<u2").astype(float)
    values = encoded["low"] + (whole - 1) * (encoded["high"] - encoded["low"]) / 65533
    if encoded["scale"] == "log":
        values = np.exp(values)
    values[whole == 0] = np.nan
    return values.reshape(3, -1)


@given(st.integers(2, 3000), st.integers(1, 400), st.integers(0, 2**32 - 1))
def test_every_sample_lies_in_the_band_of_its_stretch(n, columns, seed) -> None:
    """And each stretch with samples reaches exactly from their least to their greatest."""
    rng = np.random.default_rng(seed)
    t_ns = np.cumsum(rng.integers(1, 10**8, n))
    value = rng.normal(size=n)
    curve = reduce_series(t_ns, value, int(t_ns[0]), columns)
    at = np.minimum(((t_ns - t_ns[0]) / 1e9 / curve.step_s).astype(int), len(curve.least) - 1)
    for column in np.unique(at):
        inside = value[at == column]
        near = slice(max(column - 1, 0), column + 2)  # rounding may move a sample on a border by one stretch
        assert np.nanmin(curve.least[near]) <= inside.min()
        assert np.nanmax(curve.greatest[near]) >= inside.max()
    assert np.nanmin(curve.least) == value.min()
    assert np.nanmax(curve.greatest) == value.max()


def test_the_middle_is_the_root_mean_square_of_errors_and_the_mean_of_other_series() -> None:
    t_ns = np.arange(8) * 1_000_000_000
    value = np.array([3.0, 4.0, 3.0, 4.0, -1.0, 1.0, -1.0, 1.0])
    assert reduce_series(t_ns, value, 0, 2, "rms").middle == pytest.approx([np.sqrt(12.5), 1.0])
    assert reduce_series(t_ns, value, 0, 2, "mean").middle == pytest.approx([3.5, 0.0])


def test_sparse_samples_are_joined_and_gaps_stay_open() -> None:
    """Poses every 2 s are a line; 60 s without one are a gap."""
    t_ns = np.concatenate([np.arange(0, 100, 2), np.arange(160, 260, 2)]) * 1_000_000_000
    curve = reduce_series(t_ns, t_ns / 1e9, 0, 1000)
    assert len(curve.middle) == 100  # never more stretches than samples
    centre_s = curve.start_s + (np.arange(100) + 0.5) * curve.step_s
    gap = (centre_s > 98 + curve.step_s) & (centre_s < 160 - curve.step_s)
    assert np.isnan(curve.middle[gap]).all()
    assert not np.isnan(curve.middle[(centre_s < 98) | (centre_s > 160)]).any()


def test_an_angle_is_broken_where_it_jumps_and_nowhere_else() -> None:
    t_ns = np.arange(10_000) * 10_000_000
    angle_deg = (np.arange(10_000) * 0.09 + 180) % 360 - 180  # 2.5 turns
    curve = reduce_angle(t_ns, angle_deg, 0, 500)
    assert np.isnan(curve.middle).sum() == 2
    assert np.nanmax(np.abs(np.diff(curve.middle))) < 5


@pytest.mark.parametrize(("scale", "relative"), [("log", 2e-4), ("linear", 0.0)])
def test_encoding_keeps_the_stated_precision(scale, relative) -> None:
    t_ns = np.arange(5000) * 10_000_000
    value = np.random.default_rng(3).lognormal(sigma=2.0, size=5000)
    curve = reduce_series(t_ns, value, 0, 5000)
    least, greatest, middle = decode(encode_curve(curve, scale))
    tolerance = {"rel": relative, "abs": 0.0} if relative else {"abs": np.ptp(value) / 65534, "rel": 0.0}
    assert greatest == pytest.approx(curve.greatest, **tolerance)
    assert least == pytest.approx(curve.least, **tolerance)
    assert middle == pytest.approx(curve.middle, **tolerance)


def test_errors_of_nothing_are_drawn_as_the_smallest() -> None:
    curve = reduce_series(np.arange(10) * 1_000_000, np.zeros(10), 0, 10, "rms")
    assert decode(encode_curve(curve, "log"))[2] == pytest.approx(LOWEST_DEG)


@given(st.integers(1, 500), st.integers(1, 60), st.integers(0, 2**32 - 1))
def test_coarser_curves_keep_every_extreme(n, columns, seed) -> None:
    """Merging stretches changes neither the least nor the greatest value, nor the span."""
    rng = np.random.default_rng(seed)
    t_ns = np.arange(n) * 10_000_000
    value = rng.normal(size=n)
    fine = reduce_series(t_ns, value, 0, n)
    coarse = coarsen_curve(fine, columns)
    assert len(coarse.middle) <= columns
    assert np.nanmin(coarse.least) == value.min()
    assert np.nanmax(coarse.greatest) == value.max()
    end_s = fine.start_s + fine.step_s * len(fine.middle)
    coarse_end_s = coarse.start_s + coarse.step_s * len(coarse.middle)
    assert 0 <= coarse_end_s - end_s + 1e-9 < coarse.step_s + 1e-9
