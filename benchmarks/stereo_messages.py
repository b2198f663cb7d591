# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The stereo frame that benchmarks of the node publish."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.__main__ import load_pair
from uw_visibility.messages.images import write_image
from uw_visibility.ros.transport.factory import make_message

BASELINE = 0.160


def stereo_messages(width: int = 640, height: int = 480) -> dict[str, Any]:
    """Return the messages of a frame by topic, in the order in which drivers publish them."""
    left, right, _ = load_pair(width, height)
    focal = 3740.0 * width / 1282
    cx, cy = (width - 1) / 2, (height - 1) / 2
    messages = {}
    for side, image, offset in (("left", left, 0.0), ("right", right, -focal * BASELINE)):
        header = make_message("std_msgs/msg/Header", frame_id=f"{side}_camera")
        messages[f"{side}/image_rect"] = write_image(make_message, image, "rgb8", header)
        messages[f"{side}/camera_info"] = make_message(
            "sensor_msgs/msg/CameraInfo", header=header, width=width, height=height,
            distortion_model="plumb_bob", d=[0.0] * 5, r=np.eye(3).ravel(),
            k=[focal, 0.0, cx, 0.0, focal, cy, 0.0, 0.0, 1.0],
            p=[focal, 0.0, cx, offset, 0.0, focal, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        )
    return messages
