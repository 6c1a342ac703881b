"""The known recording as devices and data sets log it."""

import struct
from pathlib import Path

import numpy as np
from known import START_NS, Known
from scipy.spatial.transform import Rotation

from stillpoint.datasets.frames import local_from_enu, quaternion, rotation


def table(header: str, *columns: list[str] | np.ndarray, delimiter: str = ",") -> str:
    """A text of N rows; a column is a list of texts, or numbers (N,) or (N, k)."""
    parts = [
        [[text] for text in column] if isinstance(column, list) else np.reshape(column, (len(column), -1)).tolist()
        for column in columns
    ]
    rows = [
        [cell if isinstance(cell, str) else repr(cell) for part in row for cell in part]
        for row in zip(*parts, strict=True)
    ]
    return "\n".join([header, *(delimiter.join(row) for row in rows)])


def write_euroc(folder: Path, known: Known, turn: Rotation | None = None) -> None:
    stamps = [str(START_NS + t) for t in known.t_ns.tolist()]
    gyro, accel = known.gyro_b_radps, known.accel_b_mps2
    if turn is not None:
        gyro, accel = turn.inv().apply(gyro), turn.inv().apply(accel)
    (folder / "imu0").mkdir(parents=True)
    header = "#timestamp [ns]," + ",".join(f"w_RS_S_{a} [rad s^-1]" for a in "xyz")
    header += "," + ",".join(f"a_RS_S_{a} [m s^-2]" for a in "xyz")
    (folder / "imu0" / "data.csv").write_text(table(header, stamps, gyro, accel))
    if turn is not None:
        matrix = np.eye(4)
        matrix[:3, :3] = turn.as_matrix()
        data = ", ".join(map(repr, matrix.ravel().tolist()))
        text = f"sensor_type: imu\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{data}]\nrate_hz: 200\n"
        (folder / "imu0" / "sensor.yaml").write_text(text)
    (folder / "mag0").mkdir()
    (folder / "mag0" / "data.csv").write_text(table("#timestamp [ns],x [uT],y [uT],z [uT]", stamps, known.mag_b_ut))
    (folder / "state_groundtruth_estimate0").mkdir()
    header = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"
    truth = table(header, stamps, np.tile([1.0, 2.0, 3.0], (600, 1)), known.q_nb)
    (folder / "state_groundtruth_estimate0" / "data.csv").write_text(truth)


def ulog_message(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def write_ulog(path: Path, known: Known, count: int = 600) -> None:
    """The first samples of the known recording as a log of PX4, whose world is North-East-Down."""
    formats = {
        "sensor_combined": "uint64_t timestamp;float[3] gyro_rad;int32_t accelerometer_timestamp_relative;"
        "float[3] accelerometer_m_s2;",
        "vehicle_magnetometer": "uint64_t timestamp;float[3] magnetometer_ga;",
        "vehicle_attitude": "uint64_t timestamp;float[4] q;",
        "vehicle_attitude_groundtruth": "uint64_t timestamp;float[4] q;",
    }
    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + ulog_message("B", bytes(40))
    for name, fields in formats.items():
        out += ulog_message("F", f"{name}:{fields}".encode())
    for number, name in enumerate(formats):
        out += ulog_message("A", struct.pack("<BH", 0, number) + name.encode())
    q_ned = quaternion(local_from_enu("ned") * rotation(known.q_nb))
    for k, t in enumerate((known.t_ns // 1000 + 1_000_000).tolist()[:count]):
        stamp = struct.pack("<Q", t)
        imu = struct.pack("<3fi3f", *known.gyro_b_radps[k], 0, *known.accel_b_mps2[k])
        bodies = (imu, struct.pack("<3f", *(known.mag_b_ut[k] / 100)), struct.pack("<4f", *q_ned[k]))
        for number, body in enumerate((*bodies, bodies[2])):
            out += ulog_message("D", struct.pack("<H", number) + stamp + body)
    path.write_bytes(out)
