# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Message types of ROS 2 Jazzy, as rosbags knows them."""

from __future__ import annotations

from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from uw_visibility.messages.images import MessageFactory, typestore_factory


def jazzy_types() -> tuple[Typestore, MessageFactory]:
    """Return the type store of ROS 2 Jazzy, which serialises, and a factory of its messages."""
    store = get_typestore(Stores.ROS2_JAZZY)
    return store, typestore_factory(store.types)
