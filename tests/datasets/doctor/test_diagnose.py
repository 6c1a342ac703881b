"""Diagnoses: of recordings there is little to say about, and of real ones, of which much is known."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from resting import FIELD_UT, NO_RESTS, RNG, UNCHECKED, stamps, still

from stillpoint.datasets import Imu, Mag, Recording, Spin, SpinGeometry, Truth
from stillpoint.datasets.doctor import Diagnosis, Finding, Remedy, apply, diagnose
from stillpoint.datasets.importers.table import IMPORTERS
from stillpoint.datasets.simulate import simulate
from stillpoint.smoother.rest import find_rests


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


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("recording", list(absurd()))
def test_absurd_recordings_are_diagnosed_without_a_fuss(recording):
    diagnosis = diagnose(recording, NO_RESTS)
    assert json.loads(json.dumps(diagnosis.rows(), allow_nan=False))
    apply(recording, diagnosis.remedies)


@pytest.mark.slow
def test_axes_that_are_not_turned_are_said_to_be_untested():
    diagnosis = diagnose(still(mag=Mag(stamps(3000), RNG.normal(0, 0.3, (3000, 3)) + FIELD_UT)), NO_RESTS)
    assert diagnosis.clean
    assert diagnosis.codes().count("axes-not-tested") == 2


@pytest.mark.slow
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


def recordings_of(kind: str, folder: Path):
    importer = IMPORTERS[kind]
    return importer(folder, importer.options(units_unchecked=True))


def examine(recording):
    diagnosis = diagnose(recording, find_rests(recording.imu))
    return diagnosis, {finding.code: finding for finding in diagnosis.findings}


def test_broad_is_late_by_4_ms_in_all_trials_and_has_no_error(data_dir):
    """Known: 4.2 ms. Four trials of twelve carry magnets or taps on purpose."""
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
def test_the_bench_has_gyro_axes_flipped_and_a_field_that_points_up(data_dir, log):
    """Its README knows of x; accelerometer and magnetometer agree that y is flipped too (README's y is unproven).

    Gravity is inverted as well. The field says so only where the place is known to lie in the north, and then not
    whether gravity or the field is: nothing is changed.
    """
    (recording,) = recordings_of("bench", data_dir / "bench" / log)
    diagnosis, found = examine(recording)
    assert "gyro x -> -x" in found["gyro-axes"].remedy.text
    assert (found["gravity-inverted"].severity, found["gravity-inverted"].remedy) == ("warning", None)
    north = replace(recording, info=replace(recording.info, place_lat_lon_alt=(52.0, 13.0, 50.0)))
    assert examine(north)[1]["gravity-inverted"].severity == "error"
    mended, again = examine(apply(recording, diagnosis.remedies))
    assert "gyro-axes" not in mended.codes("error", "warning")
    assert np.linalg.norm(again["hard-iron"].values["hard_iron_ut"]) < 15
