# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Client node of the demonstration: plays and collects beside the node under test."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from uw_visibility.ros.client.collector import Collector
from uw_visibility.ros.client.player import Player


@contextmanager
def open_link(
    domain: int, played: Mapping[str, str], collected: Mapping[str, str]
) -> Iterator[tuple[Player, Collector]]:
    """Join a ROS domain with a player and a collector, as long as the context lasts.

    Parameters
    ----------
    domain : int
        ROS domain.
    played, collected : mapping of str to str
        Types of message by topic.

    Yields
    ------
    player : Player
    collector : Collector
        Receives in a thread of its own.
    """
    context = rclpy.Context()
    # Signals are the command's: Ctrl-C has to end more than ROS.
    rclpy.init(
        args=[], context=context, domain_id=domain,
        signal_handler_options=SignalHandlerOptions.NO,
    )
    node = rclpy.create_node("uw_visibility_demo", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    ending = Future()
    thread = threading.Thread(
        target=executor.spin_until_future_complete, args=(ending,), name="collector", daemon=True
    )
    try:
        player, collector = Player(node, played), Collector(node, collected)
        thread.start()
        yield player, collector
    finally:
        # The executor takes away what it waits with, from under whoever still spins it.
        ending.set_result(None)
        if thread.is_alive():
            thread.join()
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)
