"""Logs of a spinning body: the bench of Asghari et al. (2018) by columns and flags, and the disc of flatball-ins."""

import numpy as np
import pytest
from known import only

from stillpoint.datasets import BadParameter, BadSource, Unobservable, read
from stillpoint.datasets.constants import STANDARD_GRAVITY_MPS2
from stillpoint.datasets.importers.spin_csv import SpinOptions
from stillpoint.datasets.importers.table import IMPORTERS
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.spin import BENCH, channels, make_five_accelerometers

FULL = "%.17g"


@pytest.fixture(scope="module")
def made():
    return simulate("spin-constant", 1, minutes=0.02, sensor="white")


def bench_log(made, path, header, **columns):
    """A log of the simulated bench with these columns: each a function of the recording."""
    values = np.column_stack([column(made) for column in columns.values()])
    np.savetxt(path, values, fmt=FULL, delimiter=",", header=",".join(header or columns), comments="")
    return path


USUAL = {
    "t_s": lambda r: r.spin.t_ns / 1e9,
    "F4_mps2": lambda r: r.spin.accel_mps2[:, 0],
    "F5_mps2": lambda r: r.spin.accel_mps2[:, 1],
    "angle_deg": lambda r: np.rad2deg(r.encoder.angle_rad) % 360,
    "rate_degps": lambda r: np.rad2deg(r.encoder.rate_radps),
}


def test_a_log_with_the_usual_columns_needs_no_flags(made, tmp_path):
    recording = only("spin", bench_log(made, tmp_path / "trial.csv", None, **USUAL))
    assert recording.name == "trial"
    assert (recording.spin.t_ns == made.spin.t_ns).all()
    assert recording.spin.accel_mps2.tobytes() == made.spin.accel_mps2.tobytes()
    assert recording.encoder.angle_rad == pytest.approx(
        made.encoder.angle_rad - made.encoder.angle_rad[0] // (2 * np.pi) * 2 * np.pi, abs=1e-9
    )
    assert recording.encoder.rate_radps == pytest.approx(made.encoder.rate_radps, rel=1e-12)
    assert recording.spin.geometry.accel_r_b_m.tolist() == BENCH.accel_r_b_m.tolist()
    assert recording.spin.geometry.fixed_axis
    assert any("unwrapped over" in line for line in recording.info.conversions)


def test_flags_give_columns_units_signs_and_arms(made, tmp_path):
    """Raw counts of 3.90625 mg, the other way round and inverted; the encoder in turns; milliseconds."""
    log = bench_log(
        made,
        tmp_path / "raw.csv",
        None,
        ms=lambda r: r.spin.t_ns / 1e6,
        tangential=lambda r: -r.spin.accel_mps2[:, 1] / (3.90625e-3 * STANDARD_GRAVITY_MPS2),
        radial=lambda r: r.spin.accel_mps2[:, 0] / (3.90625e-3 * STANDARD_GRAVITY_MPS2),
        turns=lambda r: r.encoder.angle_rad / (2 * np.pi),
    )
    options = SpinOptions(
        time="ms:ms", accels="radial,-tangential:3.90625*mg", encoder_angle="turns:rev", d1_m=0.11, d2_m=0.4, range_g=8
    )
    recording = only("spin", log, options)
    assert recording.spin.accel_mps2 == pytest.approx(made.spin.accel_mps2, abs=1e-9)
    assert recording.encoder.angle_rad == pytest.approx(made.encoder.angle_rad, abs=1e-9)
    assert recording.spin.geometry.accel_r_b_m.tolist() == [[0, 0, 0.11], [0, 0.4, 0]]
    assert recording.spin.geometry.accel_range_mps2 == pytest.approx([8 * STANDARD_GRAVITY_MPS2] * 2)


def test_what_the_encoder_lacks_is_made_from_the_other_and_said(made, tmp_path):
    for column, line in (("angle_deg", "encoder rate: difference"), ("rate_degps", "encoder angle: integral")):
        usual = {
            name: made_of for name, made_of in USUAL.items() if not name.endswith(("deg", "degps")) or name == column
        }
        recording = only("spin", bench_log(made, tmp_path / f"{column}.csv", None, **usual))
        truth = made.roll_truth
        assert any(one.startswith(line) for one in recording.info.conversions)
        turned = recording.encoder.angle_rad - recording.encoder.angle_rad[0]
        assert turned == pytest.approx(truth.angle_rad, abs=0.05)
        assert np.mean(recording.encoder.rate_radps) == pytest.approx(np.mean(truth.rate_radps), rel=1e-3)
    usual = {name: USUAL[name] for name in ("t_s", "F4_mps2", "F5_mps2")}
    assert only("spin", bench_log(made, tmp_path / "none.csv", None, **usual)).encoder is None


def test_lost_values_stay_lost_and_are_counted(tmp_path):
    log = tmp_path / "gaps.csv"
    log.write_text("t_s,F4_mps2,F5_mps2,rate_degps\n0,-124,1,2020\n0.004,,1,2020\n0.008,,,2020\n0.012,-124,1,\n")
    recording = only("spin", log)
    assert recording.spin.t_ns.tolist() == [0, 4_000_000, 12_000_000]
    assert np.isnan(recording.spin.accel_mps2).tolist() == [[False, False], [True, False], [False, False]]
    assert recording.encoder.t_ns.tolist() == [0, 4_000_000, 8_000_000]
    notes = "; ".join(recording.info.notes)
    assert "1 of 4 rows without a number dropped" in notes
    assert "1 rows lack some sensors" in notes


def test_five_accelerometers_and_their_gyros_are_read(tmp_path):
    made = simulate("spin-flight", 0, minutes=0.02)
    columns = {"t_s": lambda r: r.spin.t_ns / 1e9}
    columns |= {f"F{k + 1}_mps2": lambda r, k=k: r.spin.accel_mps2[:, k] for k in range(5)}
    columns |= {f"g{k + 1}_degps": lambda r, k=k: np.rad2deg(r.spin.gyro_radps[:, k]) for k in range(2)}
    recording = only(
        "spin", bench_log(made, tmp_path / "five.csv", None, **columns), SpinOptions(geometry="five", d1_m=0.08)
    )
    assert recording.spin.accel_mps2.tobytes() == made.spin.accel_mps2.tobytes()
    assert recording.spin.gyro_radps == pytest.approx(made.spin.gyro_radps, rel=1e-12)
    assert channels(recording.spin.geometry).omega_squared.accel == pytest.approx(
        channels(make_five_accelerometers(0.08)).omega_squared.accel
    )


def test_geometry_and_settings_come_from_files(made, tmp_path):
    geometry = tmp_path / "shaft.toml"
    geometry.write_text(
        "accel_r_m = [[0, 0, 0.1], [0, 0.5, 0]]\naccel_axis = [[0, 0, 2], [0, 0, 1]]\nrange_g = 16\nfixed_axis = true\n"
    )
    settings = tmp_path / "trial.toml"
    settings.write_text(
        f'geometry = "{geometry}"\ntime = "t_s:s"\naccels = "F4_mps2,F5_mps2:m/s^2"\nsensor = "ADXL345"\n'
    )
    recording = only("spin", bench_log(made, tmp_path / "trial.csv", None, **USUAL), SpinOptions(config=settings))
    assert recording.info.sensor == "ADXL345"
    assert recording.spin.geometry.accel_axis_b.tolist() == BENCH.accel_axis_b.tolist()
    assert recording.spin.geometry.accel_range_mps2.tolist() == BENCH.accel_range_mps2.tolist()


@pytest.mark.parametrize(
    ("text", "options", "said"),
    [
        ("t_s,F4_mps2\n0,1\n", {}, "no column 'F5_mps2'; it has t_s, F4_mps2"),
        ("t_s,F4_mps2,F5_mps2\n0,,\n", {}, "no row has a number of any accelerometer"),
        ("t_s,F4_mps2,F5_mps2\n0,1,x\n", {}, "line 2, column 'F5_mps2': 'x' is not a number"),
        ("t_s,F4_mps2,F5_mps2\n1,1,1\n0,1,1\n", {}, "time does not rise"),
        ("t_s,F4_mps2,F5_mps2,angle_deg\n0,1,1,\n", {}, "no row has numbers in all columns of --encoder-angle"),
        ("t_s,F4_mps2,F5_mps2,angle_deg\n0,1,1,5\n", {}, "one angle of the encoder gives no rate"),
        ("t_s,F4_mps2,F5_mps2\n0,1,1\n", {"accels": "F4_mps2:g"}, "names 1 columns, not 2"),
        ("t_s,F4_mps2,F5_mps2\n0,1,1\n", {"accels": "F4_mps2,F5_mps2"}, "has no unit; write X,Y:UNIT"),
        ("t_s,F4_mps2,F5_mps2\n0,1,1\n", {"encoder_rate": "F4_mps2:m"}, "no unit 'm'"),
        ("t_s,F4_mps2,F5_mps2\n0,1,1\n", {"geometry": "six"}, "no preset 'six'; give bench, five or a .toml file"),
        ("t_s,F4_mps2,F5_mps2\n0,1,1\n", {"d1_m": -0.1}, "--d1-m -0.1: give a positive length"),
        ("t_s,F4_mps2,F5_mps2\n0,1,1\n", {"range_g": 0.0}, "--range-g 0: give a positive number"),
        ("t_s,F4_mps2,F5_mps2\n0,1,1\n", {"geometry": "no.toml"}, "no.toml: cannot be read"),
        ("t_s,F4_mps2,F5_mps2\n0,1,1\n", {"geometry": "no.toml", "d1_m": 0.1}, "a file states its own arms"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path, text, options, said):
    log = tmp_path / "log.csv"
    log.write_text(text)
    with pytest.raises((BadSource, BadParameter)) as refused:
        list(IMPORTERS["spin"](log, SpinOptions(**options)))
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("toml", "said"),
    [
        ("accel_r_m = [[0, 0]]", "rows of three numbers"),
        ("accel_r_m = [[0, 0, 1]]\naccel_axis = [[0, 0, 0]]", "not of length 1"),
        ("arms = 1", "no setting 'arms'"),
        ("accel_r_m = [", "is not TOML"),
    ],
)
def test_a_geometry_file_that_says_nothing_is_refused(tmp_path, toml, said):
    (tmp_path / "g.toml").write_text(toml)
    (tmp_path / "log.csv").write_text("t_s,F4_mps2\n0,1\n")
    with pytest.raises(BadParameter, match=said):
        list(IMPORTERS["spin"](tmp_path / "log.csv", SpinOptions(geometry=str(tmp_path / "g.toml"))))


def test_the_command_imports_it(made, tmp_path, call, capsys):
    log = bench_log(made, tmp_path / "trial.csv", None, **USUAL)
    assert call("import", "spin", log, "-o", tmp_path / "out", "--d1-m", "0.1", "--range-g", "16") == 0
    kept = read(tmp_path / "out" / "trial.mcap")
    assert kept.spin.accel_mps2.tobytes() == made.spin.accel_mps2.tobytes()
    assert "spin, Hz" in capsys.readouterr().out


def test_a_throw_of_the_disc_is_imported_from_its_log(data_dir, tmp_path, call, capsys):
    """100 Hz, 3391 deg/s about the spin axis; the throw is at rows 1584 to 1874; nothing reaches +-16 g."""
    assert call("import", "flatball", data_dir / "disc", "-o", tmp_path) == 0
    recording = read(tmp_path / "2025-08-31-001-rb.mcap")
    spin = recording.spin
    assert len(spin.t_ns) == len(recording.mag.t_ns) == 3558
    assert np.rad2deg(spin.gyro_radps[:, 0].max()) == pytest.approx(3391, abs=1)
    assert np.median(spin.gyro_radps[1584:1874, 0]) > np.deg2rad(2000)
    assert np.abs(spin.accel_mps2).max() / STANDARD_GRAVITY_MPS2 < 8
    step_g = np.diff(np.unique(spin.accel_mps2[:, 1])).min() / STANDARD_GRAVITY_MPS2
    assert step_g == pytest.approx(16 / 2**15, rel=0.01)  # a converter of 16 bits over +-16 g
    assert np.isnan(spin.geometry.accel_r_b_m).all()
    with pytest.raises(Unobservable, match="lever arm of accelerometer 1, 2, 3 is not known"):
        channels(spin.geometry)
    assert np.linalg.norm(spin.accel_mps2[:100].mean(axis=0)) / STANDARD_GRAVITY_MPS2 == pytest.approx(1.03, abs=0.02)
    assert any("lever arm is NaN" in note for note in recording.info.notes)


def test_a_log_without_the_discs_columns_is_refused(tmp_path):
    (tmp_path / "log.csv").write_text("idx,gx\n0,1\n")
    with pytest.raises(BadSource, match="no column acc-z, acc-x"):
        list(IMPORTERS["flatball"](tmp_path / "log.csv"))
