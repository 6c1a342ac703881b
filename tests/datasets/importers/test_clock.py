"""Clocks of importers: what holds for all stamps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillpoint.datasets import BadParameter, BadSource
from stillpoint.datasets.importers.clock import (
    check_rate,
    find_wild_stamps,
    parse_times,
    repair_clock,
    unwrap_counter,
)
from stillpoint.datasets.importers.columns import FIELD, FORCE, RATE, parse_unit
from stillpoint.datasets.importers.delimited import parse
from stillpoint.datasets.importers.series import Log, Series, fit_even_times, make_gps, merge_imu, sort_by_time

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


@given(st.integers(0, 2**31 * 10**9), st.sampled_from(["s", "ms", "us", "ns"]))
def test_decimal_times_are_exact(t_ns, unit):
    digits = {"s": 9, "ms": 6, "us": 3, "ns": 0}[unit]
    whole, rest = divmod(t_ns, 10**digits)
    cell = f"{whole}.{rest:0{digits}d}" if digits else str(whole)
    assert parse_times([cell], unit, "f", [1]).t_ns.tolist() == [t_ns]


@pytest.mark.parametrize("cell", ["inf", "12:30", "1e99", "soon"])
def test_what_is_no_time_is_refused_with_its_line(cell):
    with pytest.raises(BadSource, match="f, line 8"):
        parse_times(["1", cell], "s", "f", [7, 8])


@pytest.mark.parametrize("cell", ["", "NaN", "null"])
def test_an_empty_stamp_is_unknown(cell):
    assert parse_times(["1", cell], "s", "f", [7, 8]).known.tolist() == [True, False]


@given(
    st.lists(st.integers(1, 20), min_size=3, max_size=30),
    st.lists(st.integers(1, 20), min_size=3, max_size=30),
    st.floats(-5, 5),
)
def test_merging_is_exact_for_what_changes_evenly_and_drops_only_outside(gyro_steps, accel_steps, slope):
    """A straight line is met at each stamp, or in the middle of the interval before it where the force is averaged.

    No gyro sample outside the accelerometer's span is left.
    """
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
    step_ns = round(float(np.median(np.diff(gyro_t))))
    begin_ns = np.maximum(np.concatenate([[0], imu.t_ns[:-1]]), np.maximum(imu.t_ns - step_ns, accel_t[0]))
    averaged = any("averaged over" in line for line in log.conversions)
    assert averaged == (np.median(np.diff(accel_t)) < 0.75 * np.median(np.diff(gyro_t)))
    at_s = (imu.t_ns + begin_ns) / 2e9 if averaged else imu.t_ns * 1e-9
    expected = np.outer(at_s, [slope, 1.0, 0.0]) + GRAVITY
    np.testing.assert_allclose(imu.accel_b_mps2, expected, atol=1e-12)
    lost = sum(int(note.split()[1]) for note in log.notes)
    assert lost == (~inside).sum()


def test_vibration_above_the_rate_of_the_gyro_is_averaged_out():
    """The mean of a sine of 90 Hz over 10 ms is sin(pi 0.9) / (pi 0.9) = 0.11 of it; a single reading keeps it all."""
    accel_t, gyro_t = np.arange(0, 2_000_000_000, 500_000), np.arange(10_000_000, 1_990_000_000, 10_000_000)
    shaken = np.outer(5 * np.sin(2 * np.pi * 90 * accel_t * 1e-9), [1.0, 0.0, 0.0]) + GRAVITY
    imu = merge_imu(series(gyro_t, np.zeros((len(gyro_t), 3))), series(accel_t, shaken), "f", Log())
    assert np.abs(imu.accel_b_mps2 - GRAVITY).max() == pytest.approx(0.11 * 5, rel=0.05)


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


@pytest.mark.slow
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
    assert (table.read_floats(("d (°)", "a b")) == np.array(rows)[:, [2, 0]]).all()


def test_empty_cells_are_nan_and_a_headerless_table_counts_its_columns():
    table = parse("1,,3\n4,5,nan\n", "f")
    np.testing.assert_array_equal(table.read_floats(("2", "3")), [[np.nan, 3], [5, np.nan]])


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
def test_units_and_factors_convert_raw_counts(text, table, factor):
    assert parse_unit(text, table, "--x").factor == pytest.approx(factor, rel=1e-15)


@pytest.mark.parametrize("text", ["degs", "G/s", "*deg/s", "1..2*deg/s", ""])
def test_an_unknown_unit_is_refused_with_those_there_are(text):
    with pytest.raises(BadParameter, match="--x"):
        parse_unit(text, RATE, "--x")


# --- wrong units, wraps and wild stamps

STEPS = np.arange(1000, dtype=np.int64) * 10_000_000  # 100 Hz


@pytest.mark.parametrize(
    ("declared", "shown", "true"),
    [
        ("s", "milliseconds", "ms"),
        ("ms", "microseconds", "us"),
        ("us", "milliseconds", "ms"),
        ("us", "nanoseconds", "ns"),
    ],
)
def test_a_wrong_unit_is_named_with_the_one_that_fits(declared, shown, true):
    exponents = {"s": 0, "ms": 3, "us": 6, "ns": 9}
    cells = [str(k * 10 ** exponents[true] // 100) for k in range(100)]  # 100 Hz in the true unit
    clock = parse_times(cells, declared, "f", list(range(1, 101)), "t")
    with pytest.raises(BadParameter, match=rf"this looks like {shown} \(100 Hz\): --time t:{true}"):
        check_rate(clock, "f")


@pytest.mark.parametrize(
    ("cell", "declared", "advice"),
    [
        ("1623484800011828668", "s", "nanoseconds: --time t:ns"),
        ("1623484800011", "s", "milliseconds: --time t:ms"),
        ("2021-06-12 08:00:00.011829", "ms", "dates: --time t:iso"),
    ],
)
def test_a_stamp_beyond_its_unit_names_the_one_that_makes_it_a_date(cell, declared, advice):
    with pytest.raises(BadSource, match=f"line 7: .*{advice}"):
        parse_times([cell], declared, "f", [7], "t", "--time")


@pytest.mark.parametrize(("rate_hz", "says"), [(2.0, r"\d\d% .* to 128 s, as a float32"), (100.0, "100%")])
def test_stamps_rounded_by_float32_are_recognised(rate_hz, says):
    """A float32 holds seconds since 1970 to 128 s only."""
    cells = [repr(float(np.float32(1.7e9 + k / rate_hz))) for k in range(1000)]
    with pytest.raises(BadSource, match=says):
        check_rate(parse_times(cells, "s", "f", list(range(1000)), "t"), "f")


@pytest.mark.parametrize(
    ("text", "ns"),
    [
        ("2021-06-12T08:00:00.123456789Z", 1623484800_123456789),
        ("2021-06-12 10:00:00.5+02:00", 1623484800_500000000),
        ("2021-06-12 10:00:00,25 +0200", 1623484800_250000000),
        ("2021-06-12", 1623456000_000000000),
        ("2021-06-12T08:00:00", 1623484800_000000000),
        ("23:59:59.5", 86399_500000000),
    ],
)
def test_dates_are_exact_to_the_nanosecond(text, ns):
    assert parse_times([text], "iso", "f", [1]).t_ns.tolist() == [ns]


@given(st.sampled_from([(16, 1), (24, 1000), (32, 1000), (16, 1_000_000)]), st.integers(0, 999), st.integers(1, 50))
def test_a_counter_that_overflows_is_unwrapped(counter, at, step_of):
    """Whatever the width and unit: the steps across the overflow are the same as all others."""
    bits, unit_ns = counter
    span_ns = unit_ns << bits
    step_ns = max(span_ns // (2000 * step_of) // unit_ns, 1) * unit_ns
    true_ns = np.arange(1000, dtype=np.int64) * step_ns + span_ns - at * step_ns
    log = Log()
    found = unwrap_counter(true_ns % span_ns, "t", log)
    assert (np.diff(found) == step_ns).all()
    assert len(log.notes) == int((np.diff(true_ns % span_ns) < 0).sum())


def test_disorder_is_not_taken_for_an_overflow():
    t_ns = STEPS.copy()
    t_ns[[500, 501]] = t_ns[[501, 500]]
    assert (unwrap_counter(t_ns, "t", Log()) == t_ns).all()


@pytest.mark.parametrize("offset_ns", [10**12, -(10**12), 1_700_000_000 * 10**9])
@pytest.mark.parametrize("at", [0, 3, 500, 998, 999])
def test_a_single_wild_stamp_is_dropped(offset_ns, at):
    t_ns = STEPS + 2 * 10**12
    t_ns[at] += offset_ns
    wild = find_wild_stamps(t_ns)
    expected = np.zeros(1000, dtype=bool)
    # A first or last stamp 1000 s away may also be a sample before or after a gap: a day tells.
    expected[at] = 0 < at < 999 or abs(offset_ns) > 86_400 * 10**9
    if at in (3, 998) and abs(offset_ns) < 86_400 * 10**9:
        assert not (wild & ~expected).any()
    else:
        assert (wild == expected).all()


def test_gaps_hold_no_wild_stamps():
    t_ns = np.concatenate([STEPS, STEPS[:3] + 10**13, STEPS + 2 * 10**13])
    assert not find_wild_stamps(t_ns).any()


def test_the_time_of_day_goes_on_after_midnight():
    cells = [f"23:59:{58 + k / 100:05.2f}" for k in range(200)] + [f"00:00:{k / 100:05.2f}" for k in range(200)]
    log = Log()
    clock = repair_clock(parse_times(cells, "iso", "f", list(range(400)), "t"), log)
    assert (np.diff(clock.t_ns) == 10_000_000).all()
    assert any("a day wrapped" in note for note in log.notes)


def test_a_date_in_another_form_says_how_to_write_it():
    with pytest.raises(BadSource, match=r"'12/06/2021 08:00' is not a time in iso; write 2021-06-12T08:00:00"):
        parse_times(["12/06/2021 08:00"], "iso", "f", [1])


def test_fixes_at_zero_and_outside_the_globe_are_no_fixes():
    log = Log()
    values = np.array([[52.5, 13.3, 80, -1, -1], [0, 0, 0, 0, 0], [np.nan, 13.3, 80, 90, 2], [95, 13.3, 80, 90, 2]])
    gps = make_gps(series([1, 2, 3, 4], values), log)
    assert gps.valid.tolist() == [True, False, False, False]
    assert np.isnan(gps.course_rad[0])
    np.testing.assert_allclose(gps.course_rad[2], np.pi / 2)
    assert len([note for note in log.notes if "marked as no fix" in note]) == 2
