"""Logs from ROS bags, by the library rosbags, which needs no ROS."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eladapt.errors import LogError, UnknownNameError, needing

with needing("a ROS bag needs rosbags", "ros"):
    from rosbags.highlevel import AnyReader
    from rosbags.highlevel.anyreader import AnyReaderError
    from rosbags.typesys import Stores, get_typestore

JOINT_STATE = ("sensor_msgs/msg/JointState", "sensor_msgs/JointState")


def read_bag(path: Path, topic: str | None, joints: Sequence[str]) -> dict[str, Any]:
    """t, q, v, tau and joint_names of the JointState messages of a topic. Raises LogError."""
    try:
        # What the bag does not define itself is as in the last release with long support.
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            topics = {c.topic: c for c in reader.connections if c.msgtype in JOINT_STATE}
            connection = topics[_chosen(path, list(topics), topic)]
            received = [
                (stamp, reader.deserialize(raw, connection.msgtype))
                for _, stamp, raw in reader.messages(connections=[connection])
            ]
    except (AnyReaderError, OSError, ValueError, KeyError) as reason:
        raise LogError(f"{path}: not a ROS bag that can be read ({reason})") from reason
    if not received:
        raise LogError(f"{path}: topic {connection.topic} has no message")
    return _gathered(path, received, tuple(joints))


def _chosen(path: Path, topics: list[str], topic: str | None) -> str:
    if not topics:
        raise LogError(f"{path}: it has no topic of {JOINT_STATE[0]}")
    if topic is None and len(topics) > 1:
        raise LogError(f"{path}: joint states are on {', '.join(topics)}; say which (topic=)")
    if topic is not None and topic not in topics:
        raise UnknownNameError("topic", [topic], topics)
    return topic or topics[0]


def _gathered(path: Path, received: Sequence[tuple[int, Any]], joints: tuple[str, ...]) -> dict[str, Any]:
    """Messages with the times [ns] at which they were recorded: those that hold all joints, which are those
    named, or those that most messages have."""
    messages = [message for _, message in received]
    stamped = any(_stamp(message) for message in messages)
    wanted = joints or Counter(tuple(message.name) for message in messages).most_common(1)[0][0]
    if not wanted:
        raise LogError(f"{path}: its joint states name no joints")
    rows, times = [], []
    for recorded, message in received:
        names = list(message.name)
        if not set(wanted) <= set(names):
            continue
        at = [names.index(name) for name in wanted]
        parts = [np.asarray(getattr(message, part)) for part in ("position", "velocity", "effort")]
        rows.append([part[at] if len(part) == len(names) else np.full(len(at), np.nan) for part in parts])
        times.append(_stamp(message) if stamped else recorded)
    if not rows:
        legal = sorted({name for message in messages for name in message.name})
        raise UnknownNameError("joint of the bag", list(wanted), legal)
    q, v, tau = (np.array(part) for part in zip(*rows, strict=True))
    if np.isnan(tau).all():
        raise LogError(f"{path}: its joint states have no effort")
    lost = len(messages) - len(rows)
    notes = [f"{lost} messages lack some of these joints, and were left out"] if lost else []
    if not stamped:
        notes.append("no message has a stamp: times are those at which the bag recorded them")
    return {
        "t": 1e-9 * (np.array(times) - times[0]), "q": q, "v": v, "tau": tau, "joint_names": wanted,
        "notes": notes,
    }  # fmt: skip


def _stamp(message: Any) -> int:
    """[ns] of a message's header; 0 where nobody filled it in."""
    return int(10**9 * message.header.stamp.sec + message.header.stamp.nanosec)
