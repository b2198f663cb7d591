# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The stereo frame that benchmarks of the node publish."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.__main__ import load_pair
from uw_visibility.messages.images import write_image
from uw_visibility.ros.transport.factory import make_message

WIDTH, HEIGHT = 640, 480
FOCAL, BASELINE = 3740.0 * WIDTH / 1282, 0.160


def stereo_messages() -> dict[str, Any]:
    """Return the messages of a frame by topic, in the order in which drivers publish them."""
    left, right, _ = load_pair(WIDTH, HEIGHT)
    cx, cy = (WIDTH - 1) / 2, (HEIGHT - 1) / 2
    messages = {}
    for side, image, offset in (("left", left, 0.0), ("right", right, -FOCAL * BASELINE)):
        header = make_message("std_msgs/msg/Header", frame_id=f"{side}_camera")
        messages[f"{side}/image_rect"] = write_image(make_message, image, "rgb8", header)
        messages[f"{side}/camera_info"] = make_message(
            "sensor_msgs/msg/CameraInfo", header=header, width=WIDTH, height=HEIGHT,
            distortion_model="plumb_bob", d=[0.0] * 5, r=np.eye(3).ravel(),
            k=[FOCAL, 0.0, cx, 0.0, FOCAL, cy, 0.0, 0.0, 1.0],
            p=[FOCAL, 0.0, cx, offset, 0.0, FOCAL, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        )
    return messages
