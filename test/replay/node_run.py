# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The real node in a process of its own, fed with a recording message by message."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from uw_visibility.replay.bags.storage import Recorded
from uw_visibility_lab.demonstration.node_process import COMMAND, NodeProcess

# The first start compiles every kernel: three minutes of processor time, others' beside it.
READY_TIMEOUT = 900.0
ANSWER_TIMEOUT = 30.0


class NodeRun:
    """Publishes recorded messages as they are and keeps what the node publishes.

    Attributes
    ----------
    received : dict of str to list of bytes
        Serialised messages by topic, in the order of their arrival.
    """

    def __init__(
        self, process: NodeProcess, node: Any, inputs: Mapping[str, str], outputs: Mapping[str, str]
    ) -> None:
        from rclpy.qos import QoSProfile

        from uw_visibility.ros.transport.factory import message_type

        self.process = process
        self.received: dict[str, list[bytes]] = {topic: [] for topic in outputs}
        # Reliable and deep: nothing is lost on either way.
        qos = QoSProfile(depth=100)
        self._publishers = {
            topic: node.create_publisher(message_type(kind), topic, qos)
            for topic, kind in inputs.items()
        }
        self._subscriptions = {
            topic: node.create_subscription(
                message_type(kind), topic, self.received[topic].append, qos, raw=True
            )
            for topic, kind in outputs.items()
        }

    def connect(self) -> None:
        """Wait until the node hears every input, and every output is heard."""
        def connected() -> bool:
            return all(p.get_subscription_count() for p in self._publishers.values()) and all(
                s.get_publisher_count() for s in self._subscriptions.values()
            )

        self.wait(connected, "connection with the node", READY_TIMEOUT)
        # Both ends have to see one another.
        time.sleep(1.0)

    def publish(self, message: Recorded) -> None:
        """Publish a recorded message as it is."""
        self._publishers[message.topic].publish(message.data)

    def wait_for(self, counts: Mapping[str, int]) -> None:
        """Wait until so many messages have come by topic."""
        def there() -> bool:
            return all(len(self.received[topic]) >= n for topic, n in counts.items())

        self.wait(there, f"{dict(counts)} messages", ANSWER_TIMEOUT)

    def wait(self, done: Any, what: str, timeout: float) -> None:
        end = time.monotonic() + timeout
        while not done():
            self.process.check()
            numbers = {topic: len(kept) for topic, kept in self.received.items()}
            assert time.monotonic() < end, f"no {what}, but {numbers}"
            time.sleep(0.005)


@contextmanager
def run_node(
    log: Path, params: Path, inputs: Mapping[str, str], outputs: Mapping[str, str]
) -> Iterator[NodeRun]:
    """Start the node with a parameter file and reliable subscriptions."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor

    domain = int(os.environ["ROS_DOMAIN_ID"])
    command = [*COMMAND, "--ros-args", "--params-file", str(params)]
    for topic in inputs:
        command += ["-p", f"qos_overrides.{topic}.subscription.reliability:=reliable"]
        command += ["-p", f"qos_overrides.{topic}.subscription.depth:=100"]
    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=domain)
    node = rclpy.create_node("replay_test", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    ending = threading.Event()

    def spin() -> None:
        while not ending.is_set():
            executor.spin_once(timeout_sec=0.05)

    thread = threading.Thread(target=spin, daemon=True)
    try:
        with NodeProcess(log, domain, tuple(command)) as process:
            running = NodeRun(process, node, inputs, outputs)
            thread.start()
            running.connect()
            running.wait(lambda: "ready after" in log.read_text(), "start", READY_TIMEOUT)
            yield running
    finally:
        ending.set()
        if thread.is_alive():
            thread.join(10)
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()
