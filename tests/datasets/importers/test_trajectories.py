"""Trajectories of other programs: one asymmetric attitude through every format."""

import numpy as np
import pytest
from bags import write_pose_bag
from known import START_NS, Known

from stillpoint.datasets import BadParameter, BadSource, Estimate
from stillpoint.datasets.frames import local_from_enu, quaternion, rotation, to_xyzw
from stillpoint.datasets.importers.trajectories import read_poses, read_trajectory

POSITION = np.tile([1.0, 2.0, 3.0], (600, 1))


def rows(*columns: np.ndarray, delimiter: str = " ", stamps: list[str] | None = None) -> list[str]:
    lines = [[repr(float(cell)) for cell in row] for row in np.column_stack(columns)]
    if stamps is not None:
        lines = [[stamp, *line] for stamp, line in zip(stamps, lines, strict=True)]
    return [delimiter.join(line) for line in lines]


def assert_same(found, known: Known, start_ns: int = 0) -> None:
    assert (found.t_ns == known.t_ns + start_ns).all()
    assert (rotation(found.q_nb.copy()) * rotation(known.q_nb).inv()).magnitude().max() < 1e-7


def write(tmp_path, name: str, known: Known, lines: list[str]):
    (tmp_path / name).write_text("\n".join(lines))
    return tmp_path / name


def unix(known: Known) -> list[str]:
    return [str(START_NS + t) for t in known.t_ns.tolist()]


def test_tum_with_a_byte_order_mark(known, tmp_path):
    lines = ["\ufeff# seconds x y z qx qy qz qw", *rows(known.t_s, POSITION, to_xyzw(known.q_nb))]
    found = read_trajectory(write(tmp_path, "vio.tum", known, lines))
    assert isinstance(found, Estimate)
    assert found.name == "vio"
    assert_same(found, known)


def test_tum_in_nanoseconds_says_so(known, tmp_path):
    file = write(tmp_path, "a.tum", known, rows(POSITION, to_xyzw(known.q_nb), stamps=unix(known)))
    with pytest.raises(BadSource, match=r"a\.tum, line 1.*looks like nanoseconds$"):
        read_poses(file)


@pytest.mark.parametrize("header", ["#timestamp, p_x, p_y, p_z, q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []", None])
def test_euroc_is_read_with_and_without_a_header(known, tmp_path, header):
    lines = ([header] if header else []) + rows(POSITION, known.q_nb, delimiter=",", stamps=unix(known))
    found = read_poses(write(tmp_path, "data.csv", known, lines))
    assert_same(found, known, START_NS)
    if header is None:
        assert (found.position_n_m == [1, 2, 3]).all()


def test_kitti_needs_its_stamps(known, tmp_path):
    matrices = np.concatenate([rotation(known.q_nb).as_matrix(), POSITION[:, :, None]], axis=2).reshape(600, 12)
    file = write(tmp_path, "00.txt", known, rows(matrices))
    with pytest.raises(BadSource, match=r"no times\.txt beside"):
        read_poses(file)
    write(tmp_path, "times.txt", known, [repr(t) for t in known.t_s.tolist()])
    assert_same(read_poses(file), known)
    write(tmp_path, "times.txt", known, ["0.0", "0.1"])
    with pytest.raises(BadSource, match="2 stamps for 600 poses"):
        read_poses(file)


@pytest.mark.parametrize(
    ("names", "unit"),
    [
        ("t_ns,qw,qx,qy,qz", 1),
        ("timestamp [us],q_w,q_x,q_y,q_z", 1000),
        ("time_ms,pose.orientation.w,pose.orientation.x,pose.orientation.y,pose.orientation.z", 1_000_000),
        ("t,Quat_W,Quat_X,Quat_Y,Quat_Z", 1_000_000),
    ],
)
def test_a_table_whose_header_names_time_and_quaternion(known, tmp_path, names, unit):
    """The unit of a column that only says t is found by the rate: 100 Hz in ms, where s would be 0.1 Hz."""
    stamps = [str(t // unit) for t in known.t_ns.tolist()]
    lines = [names + ",other", *rows(known.q_nb, np.ones(600), delimiter=",", stamps=stamps)]
    assert_same(read_poses(write(tmp_path, "filter.csv", known, lines)), known)


def test_flags_name_columns_frame_and_inversion_of_a_table(known, tmp_path):
    inverse_ned = quaternion((local_from_enu("ned") * rotation(known.q_nb)).inv())
    lines = ["a,b,c,d,e", *rows(inverse_ned, delimiter=",", stamps=[repr(t) for t in known.t_s.tolist()])]
    file = write(tmp_path, "f.csv", known, lines)
    found = read_poses(file, time="a:s", quaternion="b,c,d,e", frame="ned", inverse=True)
    assert_same(found, known)
    with pytest.raises(BadSource, match=r"names no time and quaternion.*a, b, c, d, e"):
        read_poses(file)


def test_a_pose_topic_of_a_bag_is_read(known, tmp_path):
    write_pose_bag(tmp_path / "run.bag", known)
    found = read_poses(tmp_path / "run.bag")  # the pose topic, as TF holds whatever moves
    assert_same(found, known, START_NS)
    assert (found.position_n_m == [1, 2, 3]).all()
    assert_same(read_poses(tmp_path / "run.bag", topic="/tf", child="phone"), known, START_NS)
    with pytest.raises(BadParameter, match=r"no pose topic /nothing; it has /pose"):
        read_poses(tmp_path / "run.bag", topic="/nothing")


def test_poses_in_two_fixed_frames_are_not_mixed(known, tmp_path):
    write_pose_bag(tmp_path / "run.bag", known, frames=("map", "odom"))
    with pytest.raises(BadParameter, match=r"map \(300\).*--truth-parent"):
        read_poses(tmp_path / "run.bag", topic="/pose")
    found = read_poses(tmp_path / "run.bag", topic="/pose", parent="odom")
    assert (found.t_ns == known.t_ns[1::2] + START_NS).all()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("1 2 3\n", "has 3 words; a TUM pose is eight"),
        ("1 0 0 0 0 0 0 2\n", "has the length 2, not 1"),
        ("1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "does not rise"),
        ("1 2 3 4 5 6 7 8 9 10 11 12\n", "times.txt"),
        ("\0\0\0", "is not text"),
        ("", "is empty"),
    ],
)
def test_what_is_no_trajectory_gives_one_line_error(tmp_path, text, says):
    (tmp_path / "x.txt").write_text(text)
    with pytest.raises(BadSource) as caught:
        read_poses(tmp_path / "x.txt")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)
