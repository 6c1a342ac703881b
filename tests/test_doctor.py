"""The doctor's parts against what is known exactly, its answers on real recordings, and the verb."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stillpoint.datasets import BadParameter, Imu, Info, Mag, Recording, Spin, SpinGeometry, Truth
from stillpoint.datasets.doctor import Diagnosis, Finding, Remedy, apply, diagnose
from stillpoint.datasets.doctor.candidates import CANDIDATES, choose, describe
from stillpoint.datasets.doctor.coherence import MODES, displacement_modes
from stillpoint.datasets.doctor.lag import find_lag
from stillpoint.datasets.doctor.noise import white_noise
from stillpoint.datasets.doctor.remedy import line_through
from stillpoint.datasets.doctor.still import calm_seconds
from stillpoint.datasets.doctor.turning import Grid, gyro_series, vector_series
from stillpoint.datasets.importers.table import IMPORTERS
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.store import read_recording, write
from stillpoint.scripts.main import main
from stillpoint.smoother.rest import find_rests

NO_RESTS = np.empty((0, 2), dtype=np.int64)
RNG = np.random.default_rng(11)


FIELD_UT = np.array([20.0, 0.0, -40.0])
UP_MPS2 = np.array([0.0, 0.0, 9.81])
UNCHECKED = Info(units_unchecked=True)


def stamps(n, rate_hz=100.0):
    return np.round(np.arange(n) / rate_hz * 1e9).astype(np.int64)


def still(n=3000, **streams):
    gyro, accel = RNG.normal(0, 0.002, (n, 3)), RNG.normal(0, 0.02, (n, 3)) + UP_MPS2
    return Recording("still", imu=Imu(stamps(n), gyro, accel), info=UNCHECKED, **streams)


# --- the physics ---


@given(st.integers(0, 47), st.integers(0, 1000))
def test_a_vector_fixed_in_the_world_changes_as_the_true_rate_says(k, seed):
    """With the gyro's axes wrong by a candidate, that candidate's inverse predicts the change, exactly."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(1001) / 100
    rate = np.stack([np.sin(2 * np.pi * f * t_s + p) for f, p in rng.uniform(0.2, 1.0, (3, 2))], axis=1)
    steps = Rotation.from_rotvec(rate[1:] * 0.01)
    attitude = [Rotation.identity()]
    for step in steps:
        attitude.append(attitude[-1] * step)
    offset = np.array([1.0, 2.0, 3.0])
    vector = Rotation.concatenate(attitude).inv().apply(rng.normal(size=3)) + offset
    imu = Imu(stamps(1001), rate @ CANDIDATES[k], np.ones((1001, 3)))
    at = Grid(gyro_series(imu, 0), vector_series(imu.t_ns, vector, 0), 0.0).at_lag(0.0)
    predicted = at.predicted(CANDIDATES[k], offset)
    assert np.abs(predicted - at.change).max() < 1e-3 * np.abs(at.change).max()


def test_the_candidates_are_all_signed_permutations():
    assert len({matrix.tobytes() for matrix in CANDIDATES + 0.0}) == 48
    assert np.array_equal(CANDIDATES[0], np.eye(3))
    assert np.allclose(CANDIDATES @ CANDIDATES.transpose(0, 2, 1), np.eye(3))


@pytest.mark.parametrize("matrix", CANDIDATES)
def test_a_description_says_what_the_matrix_does(matrix):
    values = dict(zip("xyz", (2.0, 3.0, 5.0), strict=True))
    changed = dict(values)
    for part in filter(None, describe("gyro", matrix).split(", ")):
        target, source = part.removeprefix("gyro ").split(" -> ")
        changed[target] = -values[source[1:]] if source.startswith("-") else values[source]
    assert np.allclose(list(changed.values()), matrix @ [2.0, 3.0, 5.0])


def test_nothing_is_chosen_where_the_gyro_explains_nothing():
    noise = RNG.normal(0, 1, (48, 200))
    assert choose(noise, noise.mean(axis=0), 1.0) is None


def test_the_displacement_of_a_force_is_that_of_its_path():
    length, step_s = 200, 0.01
    t_s = step_s * np.arange(1, length + 1)
    force = np.cos(3 * t_s)
    of_force, of_path = displacement_modes(length, step_s)
    twice = np.cumsum(np.cumsum(force)) * step_s**2
    assert of_force.shape == of_path.shape == (MODES, length)
    assert np.allclose(of_force @ force, of_path @ twice, atol=1e-12)
    assert np.allclose(of_path @ (3.0 - 2 * t_s + 7 * t_s**2), 0, atol=1e-9)  # a steady tilt is no displacement


@given(st.floats(-0.2, 0.2))
def test_a_lag_is_found_to_a_tenth_of_a_millisecond(lag_s):
    t_s = np.arange(0.5, 30, 0.02)
    lag = find_lag(lambda shift_s: (np.sin(3 * (t_s + shift_s - lag_s)) - np.sin(3 * t_s)) ** 2)
    assert lag is not None
    assert abs(lag.lag_s - lag_s) < 1e-4


def test_no_lag_is_claimed_where_the_loss_hardly_depends_on_it():
    assert find_lag(lambda shift_s: np.full(100, 1.0 + 0.01 * shift_s)) is None


@given(st.floats(1e-4, 10.0), st.integers(0, 100))
def test_white_noise_is_told_from_drift_and_jolts(sd, seed):
    rng = np.random.default_rng(seed)
    values = rng.normal(0, sd, (5000, 3)) + 50 * sd * np.linspace(0, 1, 5000)[:, None] ** 2
    values[::500] += 100 * sd
    assert white_noise(values, np.ones(5000, dtype=bool)) == pytest.approx([sd] * 3, rel=0.1)


@given(st.floats(1e-3, 1e3))
def test_calm_seconds_do_not_depend_on_the_unit(factor):
    recording = simulate("phone-1", seed=0, minutes=0.6)
    scaled = replace(recording.imu, accel_b_mps2=factor * recording.imu.accel_b_mps2)
    assert np.array_equal(calm_seconds(scaled), calm_seconds(recording.imu))
    assert len(calm_seconds(recording.imu)) >= 8  # of the ten seconds of rest


# --- remedies ---


def test_a_line_leaves_even_stamps_and_spreads_bursts():
    even = stamps(1000) + 10**9
    assert np.abs(line_through(even) - even).max() <= 1
    bursts = even[np.minimum(np.arange(1000) // 25 * 25 + 24, 999)] + np.arange(1000) % 25 * 10**6
    steps = np.diff(line_through(bursts))
    assert np.ptp(steps) <= 1
    assert abs(steps.mean() - 1e7) < 1e4


def test_a_line_does_not_bridge_a_gap():
    t_ns = stamps(1000)
    t_ns[500:] += 3 * 10**9
    assert np.abs(line_through(t_ns) - t_ns).max() <= 1


def test_a_shift_of_one_sensor_moves_it_against_the_other():
    recording = simulate("phone-3", seed=2, minutes=1.5)
    shifted = apply(recording, [Remedy("shift", "accel", "accel shifted by +20.0 ms", (0.02,))])
    back = apply(shifted, [Remedy("shift", "accel", "accel shifted by -20.0 ms", (-0.02,))])
    inside = np.isin(recording.imu.t_ns, back.imu.t_ns)
    assert np.array_equal(back.imu.gyro_b_radps, recording.imu.gyro_b_radps[inside])
    start_ns = recording.imu.t_ns[0]
    t_s, at_s = (recording.imu.t_ns - start_ns) / 1e9, (shifted.imu.t_ns - start_ns) / 1e9 - 0.02
    moved = [np.interp(at_s, t_s, column) for column in recording.imu.accel_b_mps2.T]
    assert np.allclose(shifted.imu.accel_b_mps2, np.transpose(moved), atol=1e-9)
    assert "samples at the ends dropped" in shifted.info.conversions[-1]


@pytest.mark.parametrize("matrix", CANDIDATES[[1, 5, 20, 47]])
def test_a_matrix_and_its_inverse_cancel_for_the_truth_as_well(matrix):
    matrix = matrix * np.linalg.det(matrix)
    recording = simulate("phone-3", seed=2, minutes=1.5)
    there = Remedy("matrix", "truth", "there", tuple(matrix.ravel()))
    back = Remedy("matrix", "truth", "back", tuple(matrix.T.ravel()))
    changed = apply(recording, [there])
    # A vector of the body's old axes, taken to the new ones, points to the same side of the world.
    old = Rotation.from_quat(recording.truth.q_nb[9], scalar_first=True).apply([1.0, 2.0, 3.0])
    new = Rotation.from_quat(changed.truth.q_nb[9], scalar_first=True).apply(matrix @ [1.0, 2.0, 3.0])
    assert np.allclose(old, new)
    assert np.allclose(np.abs((apply(changed, [back]).truth.q_nb * recording.truth.q_nb).sum(axis=1)), 1)


def test_units_count_as_checked_again_once_they_fit():
    recording = still()
    in_g = replace(recording, imu=replace(recording.imu, accel_b_mps2=recording.imu.accel_b_mps2 / 9.80665))
    remedies = diagnose(in_g, NO_RESTS).remedies
    assert apply(in_g, ()).info.units_unchecked
    assert not apply(in_g, remedies).info.units_unchecked


@pytest.mark.parametrize(
    ("remedy", "words"),
    [
        (Remedy("paint", "gyro", "paint it"), "no remedy 'paint'"),
        (Remedy("shift", "mag", "mag shifted", (0.1,)), "needs the stream mag"),
        (Remedy("offset", "truth", "truth less 1", (1.0, 1.0, 1.0)), "needs the stream truth"),
        (Remedy("drop", "imu", "all dropped", (0, 10**12)), "drop every sample"),
    ],
)
def test_a_remedy_that_cannot_be_applied_is_refused_in_one_line(remedy, words):
    with pytest.raises(BadParameter, match=words):
        apply(still(), [remedy])


def test_shifting_before_time_zero_counts_what_is_lost():
    recording = still(mag=Mag(stamps(3000), RNG.normal(0, 1, (3000, 3)) + FIELD_UT))
    shifted = apply(recording, [Remedy("shift", "mag", "mag shifted by -100.0 ms", (-0.1,))])
    assert len(shifted.mag.t_ns) == 2990
    assert "10 samples before time 0 dropped" in shifted.info.conversions[-1]


# --- what there is little to say about ---


def absurd():
    """Recordings that break the premises of most tests."""
    noise = RNG.normal(0, 1, (3000, 3))
    attitude = np.tile([1.0, 0, 0, 0], (3000, 1))
    moving = np.ones(3000, dtype=bool)
    for n in (1, 2, 9, 10, 20, 50, 300):
        yield still(n, mag=Mag(stamps(n), RNG.normal(0, 1, (n, 3)) + FIELD_UT))
    zeros = np.zeros((3000, 3))
    yield Recording("zeros", imu=Imu(stamps(3000), zeros, zeros), mag=Mag(stamps(3000), zeros), info=UNCHECKED)
    yield still(mag=Mag(stamps(1), noise[:1]))
    yield still(mag=Mag(stamps(300) + 10**13, noise[:300]))
    yield still(truth=Truth(stamps(3000), attitude, moving, np.full((3000, 3), np.nan)))
    yield still(truth=Truth(stamps(3000) + 10**13, attitude, moving))
    yield still(truth=Truth(stamps(1), attitude[:1], moving[:1]))
    for rate_hz in (1.0, 2000.0):
        yield Recording(
            "slow or fast", imu=Imu(stamps(3000, rate_hz), noise, 3 * noise), mag=Mag(stamps(3000), noise * 40)
        )
    for size in (1e-200, 1e12):
        imu, mag = Imu(stamps(3000), size * noise, size * noise), Mag(stamps(3000), size * noise)
        yield Recording("sizes", imu=imu, mag=mag, info=UNCHECKED)
    geometry = SpinGeometry(np.zeros((3, 3)), np.eye(3), np.eye(3)[:1])
    yield Recording("spin", spin=Spin(stamps(3000), noise, noise[:, :1], geometry))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("recording", list(absurd()))
def test_absurd_recordings_are_diagnosed_without_a_fuss(recording):
    diagnosis = diagnose(recording, NO_RESTS)
    assert json.loads(json.dumps(diagnosis.rows(), allow_nan=False))
    apply(recording, diagnosis.remedies)


def test_axes_that_are_not_turned_are_said_to_be_untested():
    diagnosis = diagnose(still(mag=Mag(stamps(3000), RNG.normal(0, 0.3, (3000, 3)) + FIELD_UT)), NO_RESTS)
    assert diagnosis.clean
    assert diagnosis.codes().count("axes-not-tested") == 2


def test_a_field_that_points_up_is_inverted_gravity_or_the_south():
    """Without truth, place or base pose nothing else tells the sign of gravity; the place decides."""
    recording = replace(simulate("phone-3", seed=1, minutes=1.6), truth=None, base_pose=None)
    flipped = replace(
        recording,
        imu=replace(recording.imu, accel_b_mps2=-recording.imu.accel_b_mps2),
        info=replace(recording.info, units_unchecked=True),
    )
    rests = find_rests(flipped.imu)
    sure = {f.code: f.severity for f in diagnose(flipped, rests).findings}
    assert sure["gravity-inverted"] == "error"
    nowhere = replace(flipped, info=replace(flipped.info, place_lat_lon_alt=None))
    unsure = {f.code: f for f in diagnose(nowhere, rests).findings}["gravity-inverted"]
    assert unsure.severity == "warning"
    assert "southern hemisphere" in unsure.message
    south = replace(flipped, info=replace(flipped.info, place_lat_lon_alt=(-35.0, 149.0, 600.0)))
    assert diagnose(south, rests).clean


def test_findings_are_plain_data():
    remedy = Remedy("offset", "mag", "mag less hard iron", (1.0, 2.0, 3.0))
    findings = (Finding("hard-iron", "warning", "mag: …", remedy, {"x": float("nan")}), Finding("a", "fact", "b"))
    diagnosis = Diagnosis("r", findings)
    rows = json.loads(json.dumps(diagnosis.rows(), allow_nan=False))
    assert [set(row) for row in rows] == [{"recording", "code", "severity", "message", "remedy", "values"}] * 2
    assert rows[0]["remedy"]["values"] == [1.0, 2.0, 3.0]
    assert rows[1]["remedy"] is None
    assert not diagnosis.clean
    assert diagnosis.codes("fact") == ("a",)


# --- the verb ---


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A clean recording and one whose gyro has x flipped."""
    folder = tmp_path_factory.mktemp("doctor")
    clean = simulate("phone-3", seed=3, minutes=1.6)
    write(folder / "clean.mcap", clean)
    imu = replace(clean.imu, gyro_b_radps=clean.imu.gyro_b_radps * [-1.0, 1.0, 1.0])
    write(folder / "flipped.mcap", replace(clean, name="flipped", imu=imu))
    return folder


def call(*arguments):
    with pytest.raises(SystemExit) as ended:
        main(["doctor", *map(str, arguments)])
    return ended.value.code


def test_the_verb_reports_and_strict_sets_the_exit_code(files, capsys):
    assert call(files / "clean.mcap", "--strict", "--json", "-") == 0
    assert {row["severity"] for row in json.loads(capsys.readouterr().out)["rows"]} == {"fact"}
    assert call(files / "flipped.mcap") == 0
    assert "gyro x -> -x" in capsys.readouterr().out
    assert call(files / "flipped.mcap", "--strict") == 2


def test_the_verb_applies_remedies_and_records_them(files, tmp_path, capsys):
    before = (files / "flipped.mcap").read_bytes()
    assert call(files, "--apply", "-o", tmp_path / "mended") == 0
    mended, clean = (read_recording(tmp_path / "mended" / f"{name}.mcap") for name in ("flipped", "clean"))
    assert np.array_equal(mended.imu.gyro_b_radps, clean.imu.gyro_b_radps)
    assert mended.info.conversions[-1] == "doctor: gyro x -> -x"
    assert (files / "flipped.mcap").read_bytes() == before


def test_a_remedy_can_be_left_out(files, tmp_path, capsys):
    assert call(files / "flipped.mcap", "--apply", "-o", tmp_path, "--skip", "gyro-axes") == 0
    assert "0 of 1 remedies applied" in capsys.readouterr().out
    kept, before = read_recording(tmp_path / "flipped.mcap"), read_recording(files / "flipped.mcap")
    assert np.array_equal(kept.imu.gyro_b_radps, before.imu.gyro_b_radps)


@pytest.mark.parametrize("flags", [["--apply"], ["-o", "x"], ["--apply", "-o", "."]])
def test_the_verb_never_overwrites_and_wants_a_folder(files, flags, capsys, monkeypatch):
    monkeypatch.chdir(files)
    assert call("clean.mcap", *flags) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


# --- real recordings: what is known about them ---


def recordings_of(kind: str, folder: Path):
    importer = IMPORTERS[kind]
    return importer(folder, importer.options(units_unchecked=True))


def examine(recording):
    diagnosis = diagnose(recording, find_rests(recording.imu))
    return diagnosis, {finding.code: finding for finding in diagnosis.findings}


def test_broad_is_late_by_4_ms_in_all_trials_and_has_no_error(data_dir):
    """Known: 4.2 ms (shared README). Four trials of twelve carry magnets or taps on purpose."""
    count = 0
    for recording in recordings_of("broad", data_dir / "broad"):
        diagnosis, found = examine(recording)
        assert diagnosis.codes("error") == (), recording.name
        assert found["gyro-truth-lag"].values["lag_s"] == pytest.approx(4.2e-3, abs=0.2e-3), recording.name
        count += 1
    assert count == 12


# Seconds that remain after the dataset's own alignment on a grid of 10 ms; the gyro is late where negative.
TYREX_S = {
    "Nexus5_NoDist_AR": -0.017,
    "Nexus5_NoDist_Texting": -0.0205,
    "Nexus5_NoDist_Swinging": -0.0237,
    "Nexus5_Dist_Phoning": -0.0192,
    "Nexus5_NoDist_RunningHand": -0.0218,
    "iPhone5_NoDist_Texting": -0.030,
    "iPhone5_Dist_AR": -0.0129,
    "iPhone5_NoDist_Phoning": -0.0169,
    "iPhone4S_NoDist_AR": -0.0091,
    "iPhone4S_Dist_FrontPocket": -0.0096,
}


def test_the_phones_are_late_by_what_was_measured(data_dir):
    count = 0
    for recording in recordings_of("tyrex", data_dir / "tyrex"):
        known_s = next(lag_s for name, lag_s in TYREX_S.items() if recording.name.endswith(name))
        diagnosis, found = examine(recording)
        assert diagnosis.codes("error") == (), recording.name
        assert found["gyro-truth-lag"].values["lag_s"] == pytest.approx(-known_s, abs=3e-3), recording.name
        assert found["hard-iron"].severity == "warning"
        count += 1
    assert count == 10


@pytest.mark.parametrize("log", ["full-sphere", "roll-and-tilt-at-45-90"])
def test_the_bench_has_gyro_x_flipped_and_gravity_inverted(data_dir, log):
    """Its README knows of x; accelerometer and magnetometer agree that y is flipped too (README's y is unproven)."""
    (recording,) = recordings_of("bench", data_dir / "bench" / log)
    diagnosis, found = examine(recording)
    assert "gyro x -> -x" in found["gyro-axes"].remedy.text
    assert found["gravity-inverted"].remedy.text == "accel -> -accel"
    mended, again = examine(apply(recording, diagnosis.remedies))
    assert not {"gyro-axes", "gravity-inverted"} & set(mended.codes("error", "warning"))
    assert np.linalg.norm(again["hard-iron"].values["hard_iron_ut"]) < 15
