"""The known recording through delimited logs."""

import numpy as np
import pytest
from known import START_NS, G, Known, assert_known, only
from scipy.spatial.transform import Rotation

from stillpoint.datasets import BadSource
from stillpoint.datasets.frames import quaternion, rotation
from stillpoint.datasets.importers.csv_log import CsvOptions

HEADER = ["t", "gy", "gx", "gz", "ax", "ay", "az", "m0", "m1", "m2", "qw", "qx", "qy", "qz", "go"]


def csv_rows(known: Known, q: np.ndarray) -> list[list[str]]:
    """Milliseconds, deg/s with x and y swapped, g with y turned, counts of 0.25 uT with z turned."""
    w = np.rad2deg(known.gyro_b_radps)
    f = known.accel_b_mps2 / G
    m = known.mag_b_ut / 0.25
    moving = np.arange(600) % 2
    columns = [w[:, 1], w[:, 0], w[:, 2], f[:, 0], -f[:, 1], f[:, 2], m[:, 0], m[:, 1], -m[:, 2], *q.T, moving]
    table = np.column_stack([known.t_s * 1e3, *columns])
    rows = [[repr(float(cell)) for cell in row] for row in table]
    for row in rows[40:45]:
        row[10:14] = [""] * 4
    return rows


SETTINGS = {
    "time": "t:ms",
    "gyro": "gx,gy,gz:dps",
    "accel": "ax,-ay,az:g",
    "mag": "m0,m1,-m2:0.25*uT",
    "truth": "qw,qx,qy,qz",
    "moving": "go",
}


@pytest.mark.parametrize(("delimiter", "comma"), [(",", False), (";", True), ("\t", True), (";", False), (" ", False)])
def test_flags_describe_a_delimited_log(known, tmp_path, delimiter, comma):
    file = tmp_path / "log.csv"
    rows = csv_rows(known, known.q_nb)
    if delimiter == " ":  # no empty cells in a log that is parted by blanks
        rows = [[cell or "nan" for cell in row] for row in rows]
    text = "\n".join(delimiter.join(row) for row in [HEADER, *rows])
    file.write_text("# a comment\n" + (text.replace(".", ",") if comma else text))
    recording = only("csv", file, CsvOptions(**SETTINGS))
    assert_known(recording, known)
    assert len(recording.truth.t_ns) == 595
    assert (recording.truth.moving == (recording.truth.t_ns // 10_000_000 % 2 == 1)).all()
    assert any("sign of y flipped" in line for line in recording.info.conversions)


def test_a_delimited_log_is_described_by_a_toml_file_and_column_numbers(known, tmp_path):
    file, config = tmp_path / "log.txt", tmp_path / "log.toml"
    file.write_text("\n".join(",".join(row) for row in csv_rows(known, known.q_nb)))
    numbered = {name: str(place + 1) for place, name in enumerate(HEADER)}
    lines = ['licence = "CC0"', 'time = "1:ms"', "drop-disordered = true"]
    for key in ("gyro", "accel", "mag", "truth", "moving"):
        columns, colon, unit = SETTINGS[key].partition(":")
        said = ",".join("-" * name.startswith("-") + numbered[name.lstrip("-")] for name in columns.split(","))
        lines.append(f'{key} = "{said}{colon}{unit}"')
    config.write_text("\n".join(lines))
    recording = only("csv", file, CsvOptions(config=config, sensor="IMU"))
    assert_known(recording, known)
    assert (recording.info.licence, recording.info.sensor) == ("CC0", "IMU")


@pytest.mark.parametrize("frame", ["nwu", "ned"])
def test_truth_of_a_delimited_log_is_converted_from_its_local_frame(known, tmp_path, frame):
    # The rows of these matrices are the axes of the frame in East-North-Up.
    axes = {"nwu": [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], "ned": [[0, 1, 0], [1, 0, 0], [0, 0, -1]]}[frame]
    q = quaternion(Rotation.from_matrix(axes) * rotation(known.q_nb))
    file = tmp_path / "log.csv"
    file.write_text("\n".join(",".join(row) for row in [HEADER, *csv_rows(known, q)]))
    assert_known(only("csv", file, CsvOptions(**SETTINGS, truth_frame=frame)), known)


def test_stamps_of_the_epoch_are_kept_to_the_nanosecond(known, tmp_path):
    # A double would round 1.7e9 s to 0.24 us.
    file = tmp_path / "log.csv"
    stamps = [f"{(START_NS + t) // 10**9}.{(START_NS + t) % 10**9:09d}" for t in known.t_ns.tolist()]
    rows = [[stamp, *row[1:]] for stamp, row in zip(stamps, csv_rows(known, known.q_nb), strict=True)]
    file.write_text("\n".join(",".join(row) for row in [HEADER, *rows]))
    recording = only("csv", file, CsvOptions(**{**SETTINGS, "time": "t"}))
    assert_known(recording, known, start_ns=START_NS)
    assert (recording.info.epoch, recording.info.date) == ("unix", "2023-11-14")


def test_sensors_on_rows_of_their_own_keep_their_own_clocks(known, tmp_path):
    """Every second row has the field only; the accelerometer stands between the gyro's rows."""
    lines = ["t,gx,gy,gz,ax,ay,az,mx,my,mz"]
    for k in range(400):
        gyro = ["1.5", "0", "0"] if k % 2 == 0 else [""] * 3
        accel = ["0", f"{0.001 * k!r}", "9.8"] if k % 2 else [""] * 3
        mag = ["20", "0", "-40"] if k % 4 == 1 else [""] * 3
        lines.append(",".join([str(k), *gyro, *accel, *mag]))
    file = tmp_path / "rows.csv"
    file.write_text("\n".join(lines))
    options = CsvOptions(time="t:ms", gyro="gx,gy,gz:rad/s", accel="ax,ay,az:m/s^2", mag="mx,my,mz:uT")
    recording = only("csv", file, options)
    assert (recording.imu.t_ns == np.arange(2, 400, 2) * 1_000_000).all()
    np.testing.assert_allclose(recording.imu.accel_b_mps2[:, 1], 0.001 * np.arange(2, 400, 2), atol=1e-12)
    assert (recording.mag.t_ns == np.arange(1, 400, 4) * 1_000_000).all()
    assert "gyro: 1 samples without accelerometer samples around them dropped" in recording.info.notes


# --- logs as people have them

PLAIN = CsvOptions(time="t:ms", gyro="gx,gy,gz:rad/s", accel="ax,ay,az:m/s^2")


def plain_rows(known: Known, *more: np.ndarray) -> list[str]:
    """Milliseconds, gyro, accelerometer in SI, and further columns."""
    table = np.column_stack([known.t_s * 1e3, known.gyro_b_radps, known.accel_b_mps2, *more])
    return [",".join(repr(float(cell)) for cell in row) for row in table]


def assert_plain(recording, known: Known) -> None:
    np.testing.assert_array_equal(recording.imu.t_ns, known.t_ns)
    np.testing.assert_array_equal(recording.imu.gyro_b_radps, known.gyro_b_radps)
    np.testing.assert_array_equal(recording.imu.accel_b_mps2, known.accel_b_mps2)


@pytest.mark.parametrize(
    ("before", "skipped"),
    [
        (["#t,gx,gy,gz,ax,ay,az"], 0),
        (["# made by a logger", "# t,gx,gy,gz,ax,ay,az"], 0),
        (["sep=,", "t,gx,gy,gz,ax,ay,az"], 0),
        (["Device: X, firmware 3", "Started,2021-05-06", "", "t,gx,gy,gz,ax,ay,az"], 2),
        (["t,gx,gy,gz,ax,ay,az", "ms,rad/s,rad/s,rad/s,m/s2,m/s2,m/s2"], 1),
        (["Serial,0042,x", "t,gx,gy,gz,ax,ay,az", "ms,rad/s,rad/s,rad/s,m/s2,m/s2,m/s2"], 2),
        (["t,gx,gy,gz,ax,ay,az,"], 0),
    ],
)
def test_the_header_is_found_below_a_preamble(known, tmp_path, before, skipped):
    file = tmp_path / "log.csv"
    file.write_text("\n".join([*before, *plain_rows(known)]))
    recording = only("csv", file, PLAIN)
    assert_plain(recording, known)
    assert any(f"{skipped} lines beside the header" in note for note in recording.info.notes) == bool(skipped)


def test_each_sensor_may_have_a_time_column_of_its_own(known, tmp_path):
    """Three clocks side by side in one row, whose zeros agree; the field lies between the samples of the gyro."""
    late = known.t_s * 1e3 + 3.0
    rows = plain_rows(known, known.t_s * 1e6, late, known.mag_b_ut)
    file = tmp_path / "log.csv"
    file.write_text("\n".join(["tg,gx,gy,gz,ax,ay,az,ta,tm,mx,my,mz", *rows]))
    options = CsvOptions(
        gyro=PLAIN.gyro,
        accel=PLAIN.accel,
        mag="mx,my,mz:uT",
        gyro_time="tg:ms",
        accel_time="ta:us",
        mag_time="tm:ms",
    )
    recording = only("csv", file, options)
    assert_plain(recording, known)
    assert (recording.mag.t_ns == known.t_ns + 3_000_000).all()


def test_rows_without_a_time_are_skipped_and_counted(known, tmp_path):
    rows = plain_rows(known)
    rows[10] = "," + rows[10].partition(",")[2]
    file = tmp_path / "log.csv"
    file.write_text("\n".join(["t,gx,gy,gz,ax,ay,az", *rows]))
    recording = only("csv", file, PLAIN)
    assert len(recording.imu.t_ns) == 599
    assert any("1 of 600 rows without a usable time" in note for note in recording.info.notes)


def test_fixes_are_taken_once_where_rows_repeat_them(known, tmp_path):
    fix = np.repeat(np.arange(6), 100)
    rows = plain_rows(known, 52.5 + fix * 1e-4, 13.3 + fix * 1e-4, np.full(600, 80.0), np.full(600, 5.0), fix * 10.0)
    file = tmp_path / "log.csv"
    file.write_text("\n".join(["t,gx,gy,gz,ax,ay,az,lat,lon,alt,v,c", *rows]))
    recording = only("csv", file, CsvOptions(**{**vars(PLAIN), "gps": "lat,lon,alt,v,c"}))
    np.testing.assert_allclose(recording.gps.t_ns, np.arange(6) * 1_000_000_000)
    np.testing.assert_allclose(recording.gps.lat_deg, 52.5 + np.arange(6) * 1e-4)
    np.testing.assert_allclose(recording.gps.course_rad, np.deg2rad(np.arange(6) * 10))
    np.testing.assert_allclose(recording.gps.speed_mps, 5.0)
    np.testing.assert_allclose(recording.gps.alt_m, 80.0)
    np.testing.assert_allclose(recording.info.place_lat_lon_alt, (52.50025, 13.30025, 80.0))


@pytest.mark.parametrize("order", ["ZYX", "xyz", "XZY"])
def test_a_truth_of_euler_angles_with_its_order_and_frame(known, tmp_path, order):
    turned = rotation(known.q_nb)
    ned = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    angles = (ned * turned).as_euler(order, degrees=True)
    file = tmp_path / "log.csv"
    file.write_text("\n".join(["t,gx,gy,gz,ax,ay,az,a,b,c", *plain_rows(known, angles)]))
    given = {"truth_euler": "a,b,c:deg", "truth_order": order, "truth_frame": "ned"}
    recording = only("csv", file, CsvOptions(**{**vars(PLAIN), **given}))
    assert (rotation(recording.truth.q_nb.copy()) * turned.inv()).magnitude().max() < 1e-6


def test_a_truth_that_takes_the_frame_to_the_body(known, tmp_path):
    inverse = quaternion(rotation(known.q_nb).inv())
    file = tmp_path / "log.csv"
    file.write_text("\n".join(["t,gx,gy,gz,ax,ay,az,qw,qx,qy,qz", *plain_rows(known, inverse)]))
    recording = only("csv", file, CsvOptions(**{**vars(PLAIN), "truth": "qw,qx,qy,qz", "truth_inverse": True}))
    assert (rotation(recording.truth.q_nb.copy()) * rotation(known.q_nb).inv()).magnitude().max() < 1e-6


def test_truth_may_be_in_a_separate_file_with_its_own_clock(known, tmp_path):
    file, truth = tmp_path / "run.csv", tmp_path / "run.tum"
    file.write_text("\n".join(["t,gx,gy,gz,ax,ay,az", *plain_rows(known)]))
    poses = np.column_stack([known.t_s[::6] + 0.0025, np.zeros((100, 3)), known.q_nb[::6][:, [1, 2, 3, 0]]])
    np.savetxt(truth, poses, fmt="%.12f")
    options = CsvOptions(**{**vars(PLAIN), "truth": str(tmp_path / "{name}.tum")})
    recording = only("csv", file, options)
    assert (recording.truth.t_ns == known.t_ns[::6] + 2_500_000).all()
    assert (rotation(recording.truth.q_nb.copy()) * rotation(known.q_nb[::6]).inv()).magnitude().max() < 1e-9
    assert set(recording.info.sha256) == {"run.csv", "run.tum"}


def test_place_and_date_are_kept(known, tmp_path):
    file = tmp_path / "run.csv"
    file.write_text("\n".join(["t,gx,gy,gz,ax,ay,az", *plain_rows(known)]))
    recording = only("csv", file, CsvOptions(**{**vars(PLAIN), "place": "-18.1,178.4", "date": "2025-08-31"}))
    assert recording.info.place_lat_lon_alt == (-18.1, 178.4, 0.0)
    assert recording.info.date == "2025-08-31"


def test_a_clock_that_was_set_is_not_sorted(known, tmp_path):
    """Sorting would mix two recordings; the advice is to split the file."""
    rows = plain_rows(known)
    file = tmp_path / "log.csv"
    file.write_text("\n".join(["t,gx,gy,gz,ax,ay,az", *rows, *rows]))
    with pytest.raises(BadSource, match=r"line 602.*up to 5\.99 s back.*split the file") as caught:
        only("csv", file, CsvOptions(**{**vars(PLAIN), "drop_disordered": True}))
    assert "--drop-disordered" not in str(caught.value)


def test_acceleration_without_gravity_says_so(known, tmp_path):
    gravity_b_mps2 = rotation(known.q_nb).inv().apply([0, 0, G])
    table = np.column_stack([known.t_s * 1e3, known.gyro_b_radps, 0.1 + known.accel_b_mps2 - gravity_b_mps2])
    file = tmp_path / "log.csv"
    file.write_text("\n".join(["t,gx,gy,gz,ax,ay,az", *(",".join(map(repr, row.tolist())) for row in table)]))
    with pytest.raises(BadSource, match="gravity was taken out"):
        only("csv", file, PLAIN)


def test_a_recording_of_months_is_refused(known, tmp_path):
    """Three parts, twenty days apart: no single stamp is wild."""
    days = np.repeat([0.0, 20.0, 40.0], 200) * 86_400e3
    table = np.column_stack([known.t_s * 1e3 + days, known.gyro_b_radps, known.accel_b_mps2])
    file = tmp_path / "log.csv"
    file.write_text("\n".join(["t,gx,gy,gz,ax,ay,az", *(",".join(map(repr, row.tolist())) for row in table)]))
    with pytest.raises(BadSource, match="lasts 40 days"):
        only("csv", file, PLAIN)


def test_a_truth_on_another_clock_is_noted(known, tmp_path):
    file, truth = tmp_path / "run.csv", tmp_path / "run.tum"
    file.write_text("\n".join(["t,gx,gy,gz,ax,ay,az", *plain_rows(known)]))
    np.savetxt(truth, np.column_stack([known.t_s + 1e6, np.zeros((600, 3)), known.q_nb[:, [1, 2, 3, 0]]]), fmt="%.12f")
    recording = only("csv", file, CsvOptions(**{**vars(PLAIN), "truth": str(truth)}))
    assert any("truth: its stamps do not overlap" in note for note in recording.info.notes)


def test_columns_of_a_comment_header_go_by_either_name(known, tmp_path):
    """EuRoC writes #timestamp [ns]; brackets and blanks belong to the names."""
    stamps = [str(START_NS + t) for t in known.t_ns.tolist()]
    table = np.column_stack([known.gyro_b_radps, known.accel_b_mps2])
    rows = [",".join([stamp, *map(repr, row)]) for stamp, row in zip(stamps, table.tolist(), strict=True)]
    gyro = [f"w_RS_S_{axis} [rad s^-1]" for axis in "xyz"]
    accel = [f"a_RS_S_{axis} [m s^-2]" for axis in "xyz"]
    file = tmp_path / "imu.csv"
    file.write_text("\n".join([",".join(["#timestamp [ns]", *gyro, *accel]), *rows]))
    for time in ("#timestamp [ns]:ns", "timestamp [ns]:ns", "1:ns"):
        options = CsvOptions(time=time, gyro=f"{','.join(gyro)}:rad/s", accel=f"{','.join(accel)}:m/s^2")
        recording = only("csv", file, options)
        assert (recording.imu.t_ns == known.t_ns + START_NS).all()
        np.testing.assert_array_equal(recording.imu.gyro_b_radps, known.gyro_b_radps)
