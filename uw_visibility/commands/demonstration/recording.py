# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Frames of a simulated bag: the messages to play, and the truth to compare with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.messages.images import read_disparity, read_image
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.stereo.rig import StereoRig

TRUTH = "/ground_truth/"


@dataclass(frozen=True)
class RecordedFrame:
    """Messages and truth of one instant of a bag.

    Attributes
    ----------
    time : int
        Time in the bag in ns.
    serialized : dict of str to bytes
        Message of each topic that a vehicle has.
    left, right : ndarray, shape (H, W, 3), uint8
        The images, RGB.
    rig : StereoRig
        Their geometry.
    attenuation : ndarray, shape (3,), float64
        True β in 1/m, RGB.
    mean_attenuation, depth : float
        True α in 1/m and depth in m, positive down.
    disparity : ndarray, shape (H, W), float32
        True disparity in px; NaN = open water.
    """

    time: int
    serialized: dict[str, bytes]
    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    rig: StereoRig
    attenuation: NDArray[np.float64]
    mean_attenuation: float
    depth: float
    disparity: NDArray[np.float32]


def read_recording(path: Path) -> tuple[dict[str, str], list[RecordedFrame]]:
    """Read a simulated bag.

    Parameters
    ----------
    path : Path
        Folder of a bag that `simulate` wrote.

    Returns
    -------
    topics : dict of str to str
        Type of message by topic, of those that are to be played.
    frames : list of RecordedFrame
        In the order of time.
    """
    instants: dict[int, dict[str, Any]] = {}
    with BagReader(path) as bag:
        topics = {t: name for t, name in bag.topics.items() if not t.startswith(TRUTH)}
        for recorded in bag.messages():
            instant = instants.setdefault(recorded.time, {})
            instant[recorded.topic] = (recorded.data, bag.deserialize(recorded))
    return topics, [_frame(time, instant) for time, instant in sorted(instants.items())]


def _frame(time: int, instant: dict[str, Any]) -> RecordedFrame:
    message = {topic: pair[1] for topic, pair in instant.items()}
    return RecordedFrame(
        time=time,
        serialized={t: pair[0] for t, pair in instant.items() if not t.startswith(TRUTH)},
        left=read_image(message["/left/image_rect"]),
        right=read_image(message["/right/image_rect"]),
        rig=StereoRig.from_camera_info(message["/left/camera_info"], message["/right/camera_info"]),
        attenuation=read_vector(message[TRUTH + "attenuation"]),
        mean_attenuation=message[TRUTH + "mean_attenuation"].data,
        depth=-message[TRUTH + "depth"].pose.pose.position.z,
        disparity=read_disparity(message[TRUTH + "disparity"]),
    )


def read_vector(message: Any) -> NDArray[np.float64]:
    """Return the components of a Vector3Stamped."""
    return np.array([message.vector.x, message.vector.y, message.vector.z])
