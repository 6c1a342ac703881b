"""``stillpoint score`` reads trajectories of other programs, all to the same figures."""

import json
from dataclasses import replace

import numpy as np
import pytest
from bags import write_pose_bag
from known import START_NS
from scipy.spatial.transform import Rotation

from stillpoint.datasets import Imu, Info, Recording, Truth, write
from stillpoint.datasets.frames import quaternion, rotation, to_xyzw


@pytest.fixture
def folder(known, tmp_path):
    """A recording with its truth, and trajectories that are 3 deg off about body x in every format."""
    t_ns = known.t_ns + START_NS
    truth = Truth(t_ns, known.q_nb, np.ones(600, np.bool_))
    imu = Imu(t_ns, known.gyro_b_radps, known.accel_b_mps2)
    write(tmp_path / "run.mcap", Recording("run", imu=imu, truth=truth, info=Info(units_unchecked=True)))
    off = replace(known, q_nb=quaternion(rotation(known.q_nb) * Rotation.from_euler("x", 3, degrees=True)))
    seconds = [f"{t // 10**9}.{t % 10**9:09d}" for t in t_ns.tolist()]
    rows = zip(seconds, t_ns.tolist(), off.q_nb.tolist(), to_xyzw(off.q_nb).tolist(), strict=True)
    tum, euroc, csv = [], [], ["t_ns,qw,qx,qy,qz"]
    for second, t, wxyz, xyzw in rows:
        tum.append(" ".join([second, "0 0 0", *map(repr, xyzw)]))
        euroc.append(",".join([str(t), "0,0,0", *map(repr, wxyz)]))
        csv.append(",".join([str(t), *map(repr, wxyz)]))
    (tmp_path / "a.tum").write_text("\n".join(tum))
    (tmp_path / "a.euroc.csv").write_text("\n".join(euroc))
    (tmp_path / "a.csv").write_text("\n".join(csv))
    matrices = np.concatenate([rotation(off.q_nb).as_matrix(), np.zeros((600, 3, 1))], axis=2).reshape(600, 12)
    np.savetxt(tmp_path / "a.kitti", matrices)
    (tmp_path / "times.txt").write_text("\n".join(seconds))
    write_pose_bag(tmp_path / "a.bag", off)
    return tmp_path


@pytest.mark.parametrize("name", ["a.tum", "a.euroc.csv", "a.csv", "a.kitti", "a.bag"])
def test_every_format_gives_the_same_score(call, folder, capsys, name):
    """3 deg in total, on either side of the score."""
    assert call("score", folder / name, "--against", folder / "run.mcap", "--align", "none", "--json", "-") == 0
    (row,) = json.loads(capsys.readouterr().out)["rows"]
    assert row["total_rmse_deg"] == pytest.approx(3.0, abs=1e-6)
    assert call("score", folder / "a.tum", "--against", folder / name, "--align", "none", "--json", "-") == 0
    (row,) = json.loads(capsys.readouterr().out)["rows"]
    assert row["total_rmse_deg"] == pytest.approx(0.0, abs=1e-5)
