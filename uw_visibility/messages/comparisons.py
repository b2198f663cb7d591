# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Messages of the comparison of a depth sensor with the estimate, the same from node and replay."""

from __future__ import annotations

from collections.abc import Iterator
from types import MappingProxyType
from typing import Any

from uw_visibility.messages.estimates import ImageHeader, vector_message
from uw_visibility.messages.images import MessageFactory

NIS, STAMPED_NIS = "depth_plausibility/nis", "depth_plausibility/nis_stamped"

NIS_TOPICS = MappingProxyType({
    NIS: "std_msgs/msg/Float64", STAMPED_NIS: "geometry_msgs/msg/Vector3Stamped",
})
"""Type of message by topic."""


def nis_messages(
    make: MessageFactory, stamp: int, frame_id: str, innovation: float, variance: float, nis: float
) -> Iterator[tuple[str, Any]]:
    """Make the messages of a comparison, by topic.

    Parameters
    ----------
    make : MessageFactory
        Makes the messages.
    stamp : int
        Of the image that the depth was estimated from, ns.
    frame_id : str
        Frame of the depth.
    innovation, variance, nis : float
        ν, m; S, m²; ν²/S.

    Yields
    ------
    topic : str
        Of `NIS_TOPICS`.
    message : object
    """
    yield NIS, make(NIS_TOPICS[NIS], data=nis)
    header = ImageHeader.at(stamp, frame_id).message(make)
    yield STAMPED_NIS, vector_message(make, header, (nis, innovation, variance))
