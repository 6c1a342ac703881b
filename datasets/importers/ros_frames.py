"""Frames of ROS: which of several frames a topic uses, and the fixed rotations between them in ``/tf_static``."""

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.frames import rotation
from stillpoint.datasets.importers.ros_files import Messages, RosFiles


def list_names(frames: NDArray[Any]) -> str:
    """Return the names of frames for a message, the most frequent first, with their numbers of messages."""
    counts = Counter(str(frame) for frame in frames)
    return ", ".join(f"{frame or '(unnamed)'} ({count})" for frame, count in counts.most_common(8))


def keep_frame(messages: Messages, wanted: str | None, flag: str, of: str = "frames") -> Messages:
    """Return the messages of one frame; ``of`` is the column: frames (header.frame_id) or children (child_frame_id).

    Raises :class:`BadParameter` where there are several frames and none is wanted, or the wanted one is not there.
    """
    frames = getattr(messages, of)
    names = sorted({str(frame) for frame in frames} - {""})
    if wanted is None:
        if len(names) > 1:
            raise BadParameter(
                f"{messages.topic}: its messages are of {len(names)} frames, {list_names(frames)}; "
                f"choose one: {flag} FRAME"
            )
        return messages
    keep = np.asarray(frames == wanted)
    if not keep.any():
        raise BadParameter(f"{flag} {wanted}: {messages.topic} has no such frame; it has {list_names(frames)}")
    return messages.where(keep)


@dataclass(frozen=True)
class StaticFrames:
    """The tree of fixed rotations between frames."""

    parents: dict[str, tuple[str, Rotation]]  # child -> parent, rotation that takes vectors of the child to the parent

    @staticmethod
    def none() -> "StaticFrames":
        """Return a tree without frames."""
        return StaticFrames({})

    @staticmethod
    def read(bag: RosFiles, messages: Messages) -> "StaticFrames":
        """Return the tree that ``/tf_static`` describes; the last message about a frame counts."""
        parents = {}
        for frame, child, q in zip(messages.frames, messages.children, messages.numbers["q"], strict=True):
            if np.linalg.norm(q) > 0.5:
                parents[strip_slash(child)] = (strip_slash(frame), rotation(q))
        return StaticFrames(parents)

    def find_rotation(self, target: str | None, frame: str) -> Rotation:
        """Return the rotation that takes vectors of ``frame`` to ``target``; the identity without a target.

        Raises :class:`BadParameter` where the tree does not connect the two.
        """
        if target is None or strip_slash(target) == strip_slash(frame):
            return Rotation.identity()
        to_root, from_root = self._find_ancestors(strip_slash(frame)), self._find_ancestors(strip_slash(target))
        common = next((name for name in to_root if name in from_root), None)
        if common is None:
            known = sorted({*self.parents, *(parent for parent, _ in self.parents.values())})
            raise BadParameter(
                f"--body-frame {target}: /tf_static does not connect it with {frame}; it has {', '.join(known[:12])}"
            )
        return from_root[common].inv() * to_root[common]

    def _find_ancestors(self, frame: str) -> dict[str, Rotation]:
        """Return the frame and its ancestors with the rotations that take its vectors to them."""
        path = {frame: Rotation.identity()}
        turn = Rotation.identity()
        while frame in self.parents:
            frame, step = self.parents[frame]
            if frame in path:
                break
            turn = step * turn
            path[frame] = turn
        return path


def strip_slash(frame: Any) -> str:
    """Return a frame's name without the slash that ROS 1 puts before it."""
    return str(frame).lstrip("/")
