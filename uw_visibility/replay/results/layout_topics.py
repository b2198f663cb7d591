# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What the Foxglove layout shows beside the estimates: recorded inputs, and diagnostics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from uw_visibility.messages.estimates import ImageHeader
from uw_visibility.messages.images import MessageFactory
from uw_visibility.replay.bags.storage import Channel
from uw_visibility.replay.inputs.topics import COMPRESSED, Selection
from uw_visibility.replay.records import JoinedFrame
from uw_visibility.status import Status

DIAGNOSTICS = "/diagnostics"
DIAGNOSTICS_TYPE = "diagnostic_msgs/msg/DiagnosticArray"


def copied_topics(
    selection: Selection, channels: Mapping[str, Channel], *, rectify: bool
) -> dict[str, tuple[str, str]]:
    """Return the inputs that are copied to the results.

    Parameters
    ----------
    selection : Selection
        Topics used.
    channels : mapping of str to Channel
        What the recording has.
    rectify : bool
        Whether the images are raw; they keep their names then, since the layout's are of
        rectified ones.

    Returns
    -------
    dict of str to tuple
        By the recorded topic: its name in the results, and its type.
    """
    names = {selection.left: "/left/image_rect", selection.left_info: "/left/camera_info"}
    if channels[selection.left].type == COMPRESSED:
        names[selection.left] += "/compressed"
    if rectify:
        names = {topic: topic for topic in names if topic is not None}
    names[selection.depth] = "/depth_sensor"
    return {
        topic: (name, channels[topic].type) for topic, name in names.items()
        if topic is not None and name is not None
    }


def diagnostics(make: MessageFactory, joined: JoinedFrame) -> Any:
    """Make a DiagnosticArray of a frame: what was assessed, or why not.

    Returns
    -------
    object
        At the stamp of the frame.
    """
    estimate, reason = joined.record.estimate, joined.record.reason
    states = {"pipeline": reason or "ok"}
    if estimate is not None:
        states |= {
            "water": str(estimate.water.status), "visibility": str(estimate.visibility.status),
            "depth": str(estimate.visibility.depth_status),
        }
    if joined.verdict is not None:
        states["depth plausibility"] = joined.verdict_reason or "ok"
    status = [
        make(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=0 if message == str(Status.OK) else 1, name=f"uw_visibility: {name}",
            message=message, hardware_id="", values=[],
        )
        for name, message in states.items()
    ]
    header = ImageHeader.at(joined.record.stamp)
    return make(DIAGNOSTICS_TYPE, header=header.message(make), status=status)
