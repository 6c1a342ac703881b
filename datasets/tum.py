"""Trajectories as text in the TUM format, which evo and most SLAM tools read and write.

One pose a line: ``seconds x y z qx qy qz qw``, the body in the world; lines with # are comments. Here the world is n
(East-North-Up); of a foreign file it is any frame with z up, as scores align the heading.
"""

from pathlib import Path

import numpy as np

from stillpoint.datasets.errors import BadRecording, BadSource
from stillpoint.datasets.frames import from_xyzw, to_xyzw
from stillpoint.datasets.importers.clock import cells_to_ns
from stillpoint.datasets.recording import Floats, Times, Truth

COLUMNS = 8
LENGTH_OFF = 0.01  # a quaternion as written with few digits is off unit length by less


def tum_text(t_ns: Times, q_nb: Floats, position_n_m: Floats | None = None) -> str:
    """Poses ``q_nb`` (N, 4) wxyz, ``position_n_m`` (N, 3) or None, as lines; an unknown position is 0 0 0."""
    place = np.zeros((len(t_ns), 3)) if position_n_m is None else np.nan_to_num(position_n_m)
    poses = np.hstack([place, to_xyzw(q_nb)]).tolist()
    lines = [
        f"{t // 10**9}.{t % 10**9:09d} {' '.join(map(repr, pose))}\n"
        for t, pose in zip(t_ns.tolist(), poses, strict=True)
    ]
    return "".join(["# seconds x y z qx qy qz qw (body in East-North-Up)\n", *lines])


def read_tum(path: Path | str) -> Truth:
    """The poses of a file, all of them counted as moving.

    Raises :class:`BadSource` for a line that is no pose, time that does not rise, and a file that cannot be read.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise BadSource(f"{path}: cannot be opened ({error.strerror}); check the name") from None
    except UnicodeDecodeError:
        raise BadSource(f"{path}: is no text; give a TUM trajectory, or an MCAP file by its name *.mcap") from None
    rows = [(number, line.split()) for number, line in enumerate(text.splitlines(), 1) if line.split("#")[0].strip()]
    for number, cells in rows:
        if len(cells) != COLUMNS:
            raise BadSource(
                f"{path}, line {number}: has {len(cells)} words; a TUM pose is eight: seconds x y z qx qy qz qw"
            )
    if not rows:
        raise BadSource(f"{path}: holds no pose; a TUM pose is a line: seconds x y z qx qy qz qw")
    t_ns = np.array([cells_to_ns([cells[0]], 0, str(path), number)[0] for number, cells in rows])
    poses = np.array([_numbers(cells[1:], f"{path}, line {number}") for number, cells in rows])
    length = np.linalg.norm(poses[:, 3:], axis=1)
    wrong = np.flatnonzero(~(np.abs(length - 1) < LENGTH_OFF))
    if len(wrong):
        raise BadSource(
            f"{path}, line {rows[wrong[0]][0]}: qx qy qz qw has the length {length[wrong[0]]:.3g}, not 1; "
            "a TUM pose is eight numbers: seconds x y z qx qy qz qw"
        )
    try:
        return Truth(t_ns, from_xyzw(poses[:, 3:] / length[:, None]), np.ones(len(t_ns), np.bool_), poses[:, :3])
    except BadRecording as error:
        raise BadSource(f"{path}: {error}") from None


def _numbers(cells: list[str], where: str) -> list[float]:
    try:
        return [float(cell) for cell in cells]
    except ValueError:
        raise BadSource(f"{where}: {' '.join(cells)!r} are not seven numbers; remove this line") from None
