# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Files of recordings: whole ones through rosbags, damaged ones as far as they can be read."""

from uw_visibility.errors import InputError

try:
    import rosbags as _  # noqa: F401
except ModuleNotFoundError as error:
    # apt has none, so that it may be missing where all else comes from there.
    raise InputError(
        "recordings need rosbags, which is not installed: pip install rosbags; beside a ROS from "
        "apt, pip install --user --break-system-packages rosbags, which adds to ~/.local and "
        "changes no package of the system's"
    ) from error
