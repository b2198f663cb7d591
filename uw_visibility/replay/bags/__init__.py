# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Reading and writing of recordings, with rosbags."""

from uw_visibility.errors import InputError

try:
    import rosbags as _  # noqa: F401
except ModuleNotFoundError as error:
    # rosbags is not in apt, so it may be the only missing package.
    raise InputError(
        "recordings need rosbags, which is not installed: pip install rosbags; with ROS from apt, "
        "pip install --user --break-system-packages rosbags, which installs to ~/.local and does "
        "not change system packages"
    ) from error
