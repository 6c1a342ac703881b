"""Clocks of importers: what holds for all stamps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillpoint.datasets import BadParameter, BadSource
from stillpoint.datasets.importers.clock import cells_to_ns
from stillpoint.datasets.importers.columns import FIELD, FORCE, RATE, parse_unit
from stillpoint.datasets.importers.delimited import parse
from stillpoint.datasets.importers.series import Log, Series, fit_even_times, merge_imu, sort_by_time

GRAVITY = np.array([0, 0, 9.8])


def series(t_ns, values) -> Series:
    return Series(np.asarray(t_ns, dtype=np.int64), np.asarray(values, dtype=np.float64).reshape(len(t_ns), -1))


@given(st.lists(st.integers(0, 50), min_size=1, max_size=40))
def test_rising_keeps_the_first_of_each_stamp_and_counts_the_rest(stamps):
    log = Log()
    out = sort_by_time(series(stamps, range(len(stamps))), "x", log)
    assert out.t_ns.tolist() == sorted(set(stamps))
    assert out.values[:, 0].tolist() == [stamps.index(t) for t in out.t_ns.tolist()]
    dropped = sum(int(note.split()[1]) for note in log.notes if "dropped" in note)
    assert dropped == len(stamps) - len(set(stamps))
    assert any("sorted" in note for note in log.notes) == (stamps != sorted(stamps))


@given(st.integers(0, 2**31 * 10**9), st.sampled_from([0, -3, -6, -9]))
def test_decimal_times_are_exact(t_ns, exponent):
    digits = 9 + exponent
    whole, rest = divmod(t_ns, 10**digits)
    cell = f"{whole}.{rest:0{digits}d}" if digits else str(whole)
    assert cells_to_ns([cell], exponent, "f", 1).tolist() == [t_ns]


@pytest.mark.parametrize("cell", ["", "NaN", "inf", "12:30", "1e99"])
def test_what_is_no_time_is_refused_with_its_line(cell):
    with pytest.raises(BadSource, match="f, line 8"):
        cells_to_ns(["1", cell], 0, "f", 7)


@given(
    st.lists(st.integers(1, 20), min_size=3, max_size=30),
    st.lists(st.integers(1, 20), min_size=3, max_size=30),
    st.floats(-5, 5),
)
def test_merging_is_exact_for_what_changes_evenly_and_drops_only_outside(gyro_steps, accel_steps, slope):
    """Linear interpolation reproduces a straight line; no gyro sample outside the accelerometer's span is left."""
    gyro_t, accel_t = np.cumsum(gyro_steps) * 1_000_000, np.cumsum(accel_steps) * 1_000_000
    inside = (gyro_t >= accel_t[0]) & (gyro_t <= accel_t[-1])
    gyro = series(gyro_t, np.zeros((len(gyro_t), 3)))
    accel = series(accel_t, np.outer(accel_t * 1e-9, [slope, 1.0, 0.0]) + GRAVITY)
    log = Log()
    if not inside.any():
        with pytest.raises(BadSource, match="do not overlap"):
            merge_imu(gyro, accel, "f", log)
        return
    imu = merge_imu(gyro, accel, "f", log)
    assert (imu.t_ns == gyro_t[inside]).all()
    expected = np.outer(imu.t_ns * 1e-9, [slope, 1.0, 0.0]) + GRAVITY
    np.testing.assert_allclose(imu.accel_b_mps2, expected, atol=1e-12)
    lost = sum(int(note.split()[1]) for note in log.notes)
    assert lost == (~inside).sum()


def test_a_long_gap_of_the_accelerometer_is_not_bridged():
    accel_t = [0, 10, 20, 30, 1030, 1040, 1050]
    gyro_t = [5, 25, 30, 500, 1030, 1045]
    accel = series(np.array(accel_t) * 1_000_000, np.ones((7, 3)))
    log = Log()
    imu = merge_imu(series(np.array(gyro_t) * 1_000_000, np.zeros((6, 3))), accel, "f", log)
    assert (imu.t_ns // 1_000_000).tolist() == [5, 25, 30, 1030, 1045]
    assert log.notes == ["gyro: 1 samples without accelerometer samples around them dropped"]


def test_equal_stamps_are_taken_as_they_are():
    t_ns = np.arange(5) * 1_000_000
    log = Log()
    imu = merge_imu(series(t_ns, np.zeros((5, 3))), series(t_ns, np.arange(15).reshape(5, 3)), "f", log)
    assert (imu.accel_b_mps2 == np.arange(15).reshape(5, 3)).all()
    assert log.conversions == []


@given(st.integers(0, 2**32 - 1), st.floats(20, 400))
def test_the_line_through_bursts_of_receipt_has_the_true_rate(seed, rate_hz):
    """Samples wait for the next of 30 readings a second, and a hundred at the start come 0.3 s late."""
    taken_s = np.arange(int(60 * rate_hz)) / rate_hz
    rng = np.random.default_rng(seed)
    received_s = np.ceil(taken_s * 30) / 30 + rng.uniform(0, 1e-3, len(taken_s))
    received_s[:100] += 0.3
    line = fit_even_times(received_s, "x", Log())
    assert abs((line[-1] - line[0]) / (taken_s[-1] - taken_s[0]) - 1) < 1e-3
    assert np.ptp(np.diff(line)) < 1e-9
    assert abs(np.median(line - taken_s) - 1 / 60) < 0.02


@given(
    st.sampled_from([",", ";", "\t", "|"]),
    st.lists(st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3), min_size=1, max_size=10),
    st.booleans(),
)
def test_numbers_come_back_from_each_kind_of_text(delimiter, rows, quoted):
    comma = delimiter != ","
    cell = (lambda x: repr(x).replace(".", ",")) if comma else repr
    head = ["a b", "c", "d (°)"]
    lines = [delimiter.join(f'"{name}"' if quoted else name for name in head)]
    lines += [delimiter.join(cell(x) for x in row) for row in rows]
    table = parse("\n".join(lines), "f")
    assert table.columns == tuple(head)
    assert (table.floats(("d (°)", "a b")) == np.array(rows)[:, [2, 0]]).all()


def test_empty_cells_are_nan_and_a_headerless_table_counts_its_columns():
    table = parse("1,,3\n4,5,nan\n", "f")
    np.testing.assert_array_equal(table.floats(("2", "3")), [[np.nan, 3], [5, np.nan]])


@pytest.mark.parametrize(
    ("text", "table", "factor"),
    [
        ("deg/s", RATE, np.pi / 180),
        ("dps", RATE, np.pi / 180),
        ("0.07*dps", RATE, 0.07 * np.pi / 180),
        ("mg", FORCE, 9.80665e-3),
        ("m/s²", FORCE, 1.0),
        ("µT", FIELD, 1.0),
        ("G", FIELD, 100.0),
        ("mG", FIELD, 0.1),
        ("0.15 * uT", FIELD, 0.15),
    ],
)
def test_units_and_raw_counts(text, table, factor):
    assert parse_unit(text, table, "--x").factor == pytest.approx(factor, rel=1e-15)


@pytest.mark.parametrize("text", ["degs", "G/s", "*deg/s", "1..2*deg/s", ""])
def test_an_unknown_unit_is_refused_with_those_there_are(text):
    with pytest.raises(BadParameter, match="--x"):
        parse_unit(text, RATE, "--x")
