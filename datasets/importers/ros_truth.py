"""The truth of a ROS file: the poses of one topic, or a chain of the frames of TF."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stillpoint.datasets.errors import BadParameter, BadSource
from stillpoint.datasets.frames import quaternion, rotation, slerp
from stillpoint.datasets.importers.ros_files import Leaves, Messages, RosFiles, collect_messages, settle_stamps
from stillpoint.datasets.importers.ros_frames import keep_frame, list_names, strip_slash
from stillpoint.datasets.importers.series import Log, Series, find_finite_rows, sort_by_time
from stillpoint.datasets.mcap.reader import Log as McapLog
from stillpoint.datasets.recording import Floats, Times, Truth
from stillpoint.datasets.times import find_longest_step_ns

TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")  # lists of transforms
TF_LIST = "transforms"
STATIC = "/tf_static"
ODOMETRY = "nav_msgs/msg/Odometry"
_LEAST_NORM = 0.5  # of a quaternion; drivers write zeros where they know no attitude
_DEEPEST = 64  # frames of a chain; a longer one goes in a circle


def list_leaves(prefix: str, names: str) -> tuple[str, ...]:
    """Return the names of the components of a vector or a quaternion in a message."""
    return tuple(f"{prefix}.{name}" for name in names)


def _list_pose_leaves(prefix: str) -> Leaves:
    return {"q": list_leaves(f"{prefix}.orientation", "wxyz"), "position": list_leaves(f"{prefix}.position", "xyz")}


TRANSFORM: Leaves = {
    "q": list_leaves("transform.rotation", "wxyz"),
    "position": list_leaves("transform.translation", "xyz"),
}
POSES: dict[str, Leaves] = {
    "geometry_msgs/msg/PoseStamped": _list_pose_leaves("pose"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": _list_pose_leaves("pose.pose"),
    ODOMETRY: _list_pose_leaves("pose.pose"),
    "geometry_msgs/msg/TransformStamped": TRANSFORM,
    "geometry_msgs/msg/QuaternionStamped": {"q": list_leaves("quaternion", "wxyz")},
    **dict.fromkeys(TF, TRANSFORM),
}


def list_pose_topics(bag: RosFiles, topic: str) -> list[str]:
    """Return the topics that :func:`read_pose_topic` needs of a file: of TF also the fixed links."""
    return [topic, STATIC] if bag.types[topic] in TF and topic != STATIC and STATIC in bag.types else [topic]


def read_pose_topic(
    bag: RosFiles, topic: str, logs: Sequence[McapLog], parent: str | None, child: str | None, log: Log
) -> Truth:
    """Return the poses of a topic whose fixed frame is ``parent`` and, of a TF topic, whose moving frame is ``child``.

    ``logs`` hold the topics of :func:`list_pose_topics`. Where no transform of TF leads from the one frame to the
    other, the chain between them is composed. Raises :class:`BadParameter` where there are several frames and none is
    named, and where no chain connects those that are.
    """
    kind = bag.types[topic]
    messages = collect_messages(topic, kind, logs, POSES[kind], TF_LIST if kind in TF else "")
    log.add_conversion(f"truth from {topic} ({kind.replace('/msg/', '/')}), stamps of its headers")
    if kind in TF and parent is not None and child is not None and not _is_direct(messages, parent, child):
        series, frames = _compose_chain(messages, _collect_static(bag, topic, logs), parent, child, log), parent
    else:
        if kind in TF:
            messages = keep_frame(messages, child, "--truth-child", of="children")
        messages = keep_frame(messages, parent, "--truth-parent")
        series, frames = sort_by_time(_settle_poses(messages, log), "truth", log), list_names(messages.frames)
    norm = np.linalg.norm(series.values[:, :4], axis=1)
    known = find_finite_rows(series.values[:, :4]) & (norm > _LEAST_NORM)
    if not known.all():
        log.add_note(f"truth: {int((~known).sum())} samples without an attitude dropped")
    if not known.any():
        raise BadSource(f"{bag.source}: {topic} holds no attitude; name another by --truth-topic")
    log.add_conversion(f"truth x, y, z, w -> w, x, y, z; its local frame {frames} is taken as East-North-Up (REP 103)")
    q_nb = series.values[known, :4] / norm[known, None]
    position_n_m = series.values[known, 4:] if series.values.shape[1] == 7 else None
    return Truth(series.t_ns[known], q_nb, np.ones(len(q_nb), dtype=np.bool_), position_n_m)


def _settle_poses(messages: Messages, log: Log) -> Series:
    """Return quaternions wxyz and, where there are some, positions (N, 4 or 7) on settled stamps."""
    numbers = messages.numbers
    values = np.hstack([numbers["q"], numbers.get("position", np.empty((len(messages.stamps_ns), 0)))])
    return settle_stamps(messages, values, log)


def _is_direct(messages: Messages, parent: str, child: str) -> bool:
    """Return whether messages state the pose of the child in the parent, without links between."""
    return bool(((messages.frames == parent) & (messages.children == child)).any())


def _collect_static(bag: RosFiles, topic: str, logs: Sequence[McapLog]) -> Messages | None:
    """Return the messages of the static transforms that belong to a topic; None without them."""
    if STATIC not in list_pose_topics(bag, topic)[1:] or not bag.counts.get(STATIC):
        return None
    return collect_messages(STATIC, bag.types[STATIC], logs, TRANSFORM, TF_LIST)


@dataclass(frozen=True, eq=False)
class _Link:
    """The pose of a child frame in its parent: one row where it is fixed, else a row for each stamp."""

    parent: str
    child: str
    t_ns: Times  # (N,), empty where it is fixed
    turn: Rotation
    position_m: Floats  # (N or 1, 3)

    @property
    def is_fixed(self) -> bool:
        return len(self.t_ns) == 0

    @property
    def name(self) -> str:
        return f"{self.parent} <- {self.child}"


def _compose_chain(moving: Messages, fixed: Messages | None, parent: str, child: str, log: Log) -> Series:
    """Return the pose (N, 7) of ``child`` in ``parent`` at the stamps of the most frequent of the links between them.

    The other moving links are interpolated there, between neighbours that are no further apart than a gap of their own
    clock (``datasets/times.py``); stamps without such neighbours are dropped and counted.
    """
    up, down, names = _find_chain(moving, fixed, parent, child)
    from_child, from_parent = [_read_link(step, log) for step in up], [_read_link(step, log) for step in down]
    links = [*from_child, *from_parent]
    leading = max(links, key=lambda link: len(link.t_ns))
    if leading.is_fixed:
        raise BadParameter(
            f"--truth-parent {parent}: every link to {child} is fixed ({names}), so nothing moves; name another"
        )
    log.add_conversion(f"truth composed of the chain {names}, at the stamps of {leading.name}")
    keep = np.ones(len(leading.t_ns), dtype=np.bool_)
    for link in (one for one in links if not one.is_fixed):
        inside, is_exact = _has_neighbours(link.t_ns, leading.t_ns), np.isin(leading.t_ns, link.t_ns)
        count = int((inside & ~is_exact).sum())
        if count:
            log.add_note(
                f"truth: {link.name} ({len(link.t_ns)} transforms) interpolated at {count} of {len(keep)} stamps"
            )
        keep &= inside
    if not keep.any():
        raise BadSource(f"{moving.topic}: the links of {names} do not overlap in time; name another --truth-parent")
    if not keep.all():
        log.add_note(
            f"truth: {int((~keep).sum())} of {len(keep)} stamps dropped, at which a link of the chain has a gap"
        )
    t_ns = leading.t_ns[keep]
    turn, position_m = _compose_links(from_child, t_ns)
    parent_turn, parent_position_m = _compose_links(from_parent, t_ns)
    turn, position_m = parent_turn.inv() * turn, parent_turn.inv().apply(position_m - parent_position_m)
    return Series(t_ns, np.hstack([np.broadcast_to(quaternion(turn), (len(t_ns), 4)), position_m]))


def _find_chain(
    moving: Messages, fixed: Messages | None, parent: str, child: str
) -> tuple[list[Messages], list[Messages], str]:
    """Return the links from the child and from the parent up to the frame above both, and the frames in words.

    Raises :class:`BadParameter` where there is no such frame.
    """
    above_child, up = _find_ancestors(child, moving, fixed)
    above_parent, down = _find_ancestors(parent, moving, fixed)
    common = next((name for name in above_child if name in above_parent), None)
    if common is None:
        known = {strip_slash(name) for one in (moving, fixed) if one for name in (*one.frames, *one.children)}
        raise BadParameter(
            f"--truth-parent {parent}: {moving.topic} and {STATIC} do not connect it with {child}; "
            f"they hold {', '.join(sorted(known)[:12])}"
        )
    up_to, down_to = above_child.index(common), above_parent.index(common)
    names = " <- ".join([*above_parent[:down_to], common, *reversed(above_child[:up_to])])
    return up[:up_to], down[:down_to], names


def _find_ancestors(frame: str, moving: Messages, fixed: Messages | None) -> tuple[list[str], list[Messages]]:
    """Return a frame with the frames above it, and the messages of the links between them.

    Raises :class:`BadParameter` where a frame has two parents.
    """
    frames, steps = [strip_slash(frame)], list[Messages]()
    while len(frames) < _DEEPEST:
        of_frame = [_select_child(one, frames[-1]) for one in (moving, fixed) if one is not None]
        found = [one for one in of_frame if len(one.frames)]
        if not found:
            return frames, steps
        parents = {strip_slash(parent) for one in found for parent in one.frames}
        if len(parents) > 1:
            counts = ", ".join(list_names(one.frames) for one in found)
            raise BadParameter(
                f"{found[0].topic}: {frames[-1]} has {len(parents)} parents, {counts}, so that the chain above {frame} "
                "is not clear; name one of them as --truth-parent and this frame as --truth-child"
            )
        frames.append(parents.pop())
        steps.append(found[0])  # one that moves counts before a fixed one
    raise BadParameter(f"{moving.topic}: the frames above {frame} go in a circle; name another --truth-child")


def _select_child(messages: Messages, child: str) -> Messages:
    """Return the messages about this child frame."""
    return messages.where(np.array([strip_slash(name) == child for name in messages.children], dtype=np.bool_))


def _read_link(messages: Messages, log: Log) -> _Link:
    """Return a link without the rows that hold no attitude; of a fixed one the last message counts."""
    parent, child = strip_slash(messages.frames[0]), strip_slash(messages.children[0])
    if messages.topic == STATIC:
        values, t_ns = np.hstack([messages.numbers["q"], messages.numbers["position"]])[-1:], np.empty(0, np.int64)
    else:
        series = sort_by_time(_settle_poses(messages, log), f"{parent} <- {child}", log)
        norm = np.linalg.norm(series.values[:, :4], axis=1)
        known = find_finite_rows(series.values) & (norm > _LEAST_NORM)
        if not known.all():
            log.add_note(f"{parent} <- {child}: {int((~known).sum())} transforms without an attitude dropped")
        values, t_ns = series.values[known], series.t_ns[known]
    if not len(values) or not np.linalg.norm(values[-1, :4]) > _LEAST_NORM:
        raise BadSource(f"{messages.topic}: {parent} <- {child} holds no attitude; name another --truth-parent")
    return _Link(parent, child, t_ns, rotation(np.ascontiguousarray(values[:, :4])), values[:, 4:])


def _has_neighbours(t_ns: Times, at_ns: Times) -> NDArray[np.bool_]:
    """Return which stamps lie on one of ``t_ns``, or between two of them that no gap parts."""
    after = np.searchsorted(t_ns, at_ns)
    inside = (after > 0) & (after < len(t_ns))
    close = np.zeros(len(at_ns), dtype=np.bool_)
    close[inside] = (t_ns[after[inside]] - t_ns[after[inside] - 1]) <= find_longest_step_ns(t_ns)
    return np.asarray(close | np.isin(at_ns, t_ns), dtype=np.bool_)


def _interpolate_link(link: _Link, at_ns: Times) -> tuple[Rotation, Floats]:
    """Return rotation and position of a link at stamps that are all on it or between two of its own."""
    if link.is_fixed:
        return link.turn, link.position_m
    if len(link.t_ns) == len(at_ns) and (link.t_ns == at_ns).all():
        return link.turn, link.position_m
    turn = rotation(slerp(link.t_ns, quaternion(link.turn), at_ns))
    position_m = np.column_stack([np.interp(at_ns, link.t_ns, column) for column in link.position_m.T])
    return turn, position_m


def _compose_links(links: Sequence[_Link], at_ns: Times) -> tuple[Rotation, Floats]:
    """Return the pose of the first child in the last parent of links that lead upward, at these stamps."""
    turn, position_m = Rotation.identity(1), np.zeros((1, 3))
    for link in links:
        step, step_m = _interpolate_link(link, at_ns)
        turn, position_m = step * turn, step.apply(position_m) + step_m
    return turn, position_m
