"""The known recording through delimited logs."""

import numpy as np
import pytest
from known import START_NS, G, Known, assert_known, only
from scipy.spatial.transform import Rotation

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
def test_a_delimited_log_by_flags(known, tmp_path, delimiter, comma):
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


def test_a_delimited_log_by_a_toml_file_and_by_column_numbers(known, tmp_path):
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
def test_a_delimited_log_with_truth_in_another_local_frame(known, tmp_path, frame):
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
