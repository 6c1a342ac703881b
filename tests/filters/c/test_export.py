"""The filters in C against the compiled steps that they are translated from."""

import shutil
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from c_filters import ATTITUDE_LOOP, SPIN_LOOP, compile_filter, run_attitude, run_spin
from numpy.testing import assert_array_equal
from quick import mark_slow_except

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.importers.table import IMPORTERS
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.spin import BENCH
from stillpoint.filters.c.export import EXPORTED, export_filter
from stillpoint.filters.front.sources import find_sources, prepare_log
from stillpoint.filters.precision import to_precision
from stillpoint.filters.sample import Track
from stillpoint.filters.spin import front as spin_front
from stillpoint.filters.spin.noise import make_channels
from stillpoint.filters.spin.sample import empty_track
from stillpoint.filters.table import ESTIMATORS

ATTITUDES = [name for name in EXPORTED if not name.startswith("roll")]
SPINS = [name for name in EXPORTED if name.startswith("roll")]
COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
pytestmark = pytest.mark.skipif(not COMPILERS, reason="no C compiler")

# C in single precision against the compiled step in single precision: sine and cosine are rounded differently.
# On the 12 trials of BROAD it is at most 2e-5 deg.
SINGLE_APART_DEG = 1e-3


def spoil(log):
    """Gaps, lost samples, free fall and fields of zero: every branch of a filter that does not need a broken number."""
    dt_s, accel, mag = log.dt_s.copy(), log.accel_b_mps2.copy(), log.mag_b_ut.copy()
    has_accel, has_mag = log.has_accel.copy(), log.has_mag.copy()
    dt_s[2000], accel[500:520], mag[700:740] = 3.0, 0.1, 0.0
    has_accel[900:1000], has_mag[1200:1400] = False, False
    mag[2600:] *= 1.6
    return log._replace(dt_s=dt_s, accel_b_mps2=accel, mag_b_ut=mag, has_accel=has_accel, has_mag=has_mag)


@pytest.fixture(scope="module")
def logs():
    """A phone in the hand in both forms, without what the guard hides: the C filters have no guard."""
    recording = simulate("phone-1", seed=3, minutes=1)
    log, _ = prepare_log(recording.require_imu(), find_sources(recording, "mag", None, None), "double")
    log = log._replace(hidden_b_radps=np.zeros_like(log.hidden_b_radps))
    return {"clean": log, "spoilt": spoil(log)}


@pytest.fixture(scope="module")
def build(tmp_path_factory):
    """Return :func:`compile_filter`, which compiles each source once per compiler and precision."""

    @cache
    def build_once(made, loop, compiler, single=False):
        return compile_filter(made, tmp_path_factory.mktemp(made.stem), loop, single, compiler)

    return build_once


def run_step(name, log, params, precision="double"):
    """What the compiled step says."""
    entry = ESTIMATORS[name]
    c = to_precision(entry.coefficients(replace(entry.params(), **params), 0.05), precision)
    n, real = len(log.dt_s), np.float64
    track = Track(
        np.empty((n, 4), real),
        np.empty((n, 3), real) if entry.gives_bias else None,
        np.empty((n, 9), real) if entry.gives_cov else None,
        np.empty((n, entry.innovations), real) if entry.innovations else None,
        np.empty(n, bool),
    )
    entry.run(to_precision(log, precision), to_precision(entry.start(c), precision), c, track)
    return track


CASES = [(name, kind, {}) for name in ATTITUDES for kind in ("clean", "spoilt")] + [
    pytest.param(*case, marks=pytest.mark.slow)
    for case in (
        ("cf", "clean", {"zeta": 0.5, "levelled_by": "estimate", "kappa": 1.0}),
        ("kf-axis", "clean", {"tilt": "roots", "heading": "compass", "reset_s": 5.0, "speed_mps": 1.0}),
        ("ekf", "clean", {"window_s": 0.0, "gate_sd": 1.0, "tilt_patience_s": 0.5, "heading_patience_s": 1.0}),
    )
]


@pytest.mark.slow
@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize(("name", "kind", "params"), CASES)
def test_c_gives_the_bits_of_the_compiled_step(name, kind, params, compiler, logs, build):
    made = export_filter(name, params, declination_rad=0.05)
    found = run_attitude(build(made, ATTITUDE_LOOP, compiler), logs[kind])
    step = run_step(name, logs[kind], params)
    assert step.ready.any()
    assert_array_equal(found["ready"], step.ready)
    assert_array_equal(found["q_nb"], step.q_nb)
    assert_array_equal(found["bias"], step.gyro_bias_b_radps)
    if step.cov_b_rad2 is not None:
        assert_array_equal(found["cov"], step.cov_b_rad2)
    else:
        assert np.isnan(found["cov"]).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ATTITUDES)
def test_single_precision_is_that_of_the_compiled_step_in_single(name, logs, build):
    made = export_filter(name, declination_rad=0.05)
    log = logs["clean"]
    found = run_attitude(build(made, ATTITUDE_LOOP, COMPILERS[0], single=True), log, np.float32)
    single, double = run_step(name, log, {}, "single"), run_step(name, log, {})
    assert turn_deg(found["q_nb"], single.q_nb).max() < SINGLE_APART_DEG
    assert turn_deg(found["q_nb"], double.q_nb)[double.ready].max() < 0.05


def turn_deg(p, q):
    """The angles between two columns of attitudes, which may be rounded to single precision."""
    p, q = (np.asarray(one, float) / np.linalg.norm(one, axis=1)[:, None] for one in (p, q))
    chord = np.minimum(np.linalg.norm(p - q, axis=1), np.linalg.norm(p + q, axis=1))
    return np.rad2deg(4 * np.arcsin(np.clip(chord / 2, 0, 1)))


@pytest.mark.parametrize("compiler", mark_slow_except(COMPILERS, *COMPILERS[:1]))
@pytest.mark.parametrize(
    ("name", "params"),
    [
        *((name, {}) for name in SPINS),
        pytest.param("roll-ekf", {"process_noise": "literal", "first_rate": "first"}, marks=pytest.mark.slow),
        pytest.param("roll-aekf", {"mode": "system", "mean": "literal", "window": 7}, marks=pytest.mark.slow),
        pytest.param("roll-aekf", {"mode": "system", "fading": "literal"}, marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("kind", ["spin-constant", "spin-variable"])
def test_c_gives_the_bits_of_the_compiled_step_of_a_spin(name, params, kind, compiler, build):
    entry, spin = ESTIMATORS[name], simulate(kind, seed=1).spin
    settings = replace(entry.params(), **params)
    front_c = spin_front.coefficients(make_channels(settings, spin.geometry), settings, "double")
    _, log = spin_front.filter_log(spin.t_ns, spin.accel_mps2, spin.gyro_radps, spin_front.start(), front_c)
    one = np.ones_like(log.dt_s)
    has_accel, has_square, direction = log.has_accel.copy(), log.has_square.copy(), log.direction.copy()
    has_accel[300:310], has_square[400:420], direction[600:605] = False, False, -1
    log = log._replace(
        accel_widened=one, square_widened=one, has_accel=has_accel, has_square=has_square, direction=direction
    )
    c, track = entry.coefficients(settings, spin.geometry), empty_track(len(one))
    entry.run(log, entry.start(c), c, track)
    made = export_filter(name, params, geometry=spin.geometry)
    found = run_spin(build(made, SPIN_LOOP, compiler), log)
    assert_array_equal(found["ready"], track.ready)
    assert_array_equal(found["rate_radps"], track.rate_radps)
    assert_array_equal(found["variances"][:, [0, 2]], np.column_stack([track.angle_var, track.rate_var]))
    assert_array_equal(found["turns"] * (2.0 * np.pi) + found["rest_rad"], track.angle_rad)


@pytest.mark.real_data
@pytest.mark.parametrize("name", ATTITUDES)
def test_c_gives_the_bits_of_the_compiled_step_on_broad(name, data_dir, build):
    """The same bits on all trials in double precision, and nearly the same attitude in single."""
    made = export_filter(name, declination_rad=0.05)
    double = build(made, ATTITUDE_LOOP, COMPILERS[0])
    single = build(made, ATTITUDE_LOOP, COMPILERS[0], single=True)
    trials = list(IMPORTERS["broad"](data_dir / "broad"))
    assert trials
    for recording in trials:
        log, _ = prepare_log(recording.require_imu(), find_sources(recording, "mag", None, None), "double")
        log = log._replace(hidden_b_radps=np.zeros_like(log.hidden_b_radps))
        step, found = run_step(name, log, {}), run_attitude(double, log)
        assert_array_equal(found["q_nb"], step.q_nb)
        assert_array_equal(found["bias"], step.gyro_bias_b_radps)
        apart = turn_deg(run_attitude(single, log, np.float32)["q_nb"], run_step(name, log, {}, "single").q_nb)
        print(f"{name} {recording.name}: {apart.max():.5f} deg from the compiled step in single precision")
        assert apart.max() < SINGLE_APART_DEG


def test_other_filters_and_wrong_parameters_are_refused():
    with pytest.raises(BadParameter, match="vqf: cannot be exported to C; choose among cf"):
        export_filter("vqf")
    with pytest.raises(BadParameter, match="omega"):
        export_filter("cf", {"omega": 1.0})


def test_parameters_are_in_the_header():
    made = export_filter("roll-ekf", {"radial_var_m2ps4": 0.4}, geometry=BENCH)
    assert "radial_var_m2ps4 = 0.4" in made.header
