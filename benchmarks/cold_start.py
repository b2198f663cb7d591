# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""How long the real node takes from its start to its first answer, with a camera running.

    python -m benchmarks.cold_start             with the kernels that are on disk
    python -m benchmarks.cold_start --cold      with none: every kernel is compiled

The time of the processors tells more than that of the clock where others use the machine.
"""

from __future__ import annotations

import argparse
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile

from benchmarks.stereo_messages import stereo_messages
from benchmarks.timing import processor_time
from uw_visibility.messages.images import stamp_to_nanoseconds
from uw_visibility.ros.transport.factory import message_type
from uw_visibility_lab.demonstration.node_process import reserved_domain

RATE = 15.0
PATIENCE = 400.0


def main() -> None:
    """Start the node some times and print the times to its first answer."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.cold_start", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--cold", action="store_true", help="without kernels on disk, once")
    parser.add_argument("--starts", type=int, default=5, help="how often (%(default)s)")
    parser.add_argument("--show", action="store_true", help="print what the node logs")
    options = parser.parse_args()
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    times = []
    with tempfile.TemporaryDirectory() as folder, reserved_domain() as domain:
        os.environ["ROS_DOMAIN_ID"] = str(domain)
        rclpy.init(args=[])
        camera = Camera()
        environment = {**os.environ, **({"NUMBA_CACHE_DIR": folder} if options.cold else {})}
        for number in range(1 if options.cold else options.starts):
            times.append(first_answer(camera, Path(folder), environment))
            print(
                f"start {number + 1}: first answer after {times[-1][0]:.2f} s, for which the "
                f"processors worked {times[-1][1]:.2f} s", flush=True,
            )
            if options.show:
                print((Path(folder) / "node.log").read_text(encoding="utf-8"))
    rclpy.shutdown()
    elapsed, worked = (statistics.median(column) for column in zip(*times, strict=True))
    print(f"median: {elapsed:.2f} s; processors {worked:.2f} s")


def first_answer(
    camera: Camera, folder: Path, environment: dict[str, str]
) -> tuple[float, float]:
    """Start the node; return elapsed and processor time until its first disparity, s."""
    with (folder / "node.log").open("wb") as log:
        begin = time.monotonic()
        process = subprocess.Popen(
            [sys.executable, "-m", "uw_visibility.ros.node"],
            stdout=log, stderr=subprocess.STDOUT, env=environment,
        )
    try:
        camera.wait_for_answers_to(time.time_ns())
        while not camera.answered:
            rclpy.spin_once(camera, timeout_sec=0.01)
            if process.poll() is not None or time.monotonic() - begin > PATIENCE:
                raise RuntimeError((folder / "node.log").read_text(encoding="utf-8"))
        return time.monotonic() - begin, processor_time(process.pid)
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(20)


class Camera(Node):
    """Publishes a stereo pair over and over, and listens for its disparity."""

    def __init__(self) -> None:
        super().__init__("camera")
        self.answered = False
        self._since = 0
        self._messages = [
            (self.create_publisher(type(message), topic, QoSProfile(depth=5)), message)
            for topic, message in stereo_messages().items()
        ]
        self.create_timer(1.0 / RATE, self._publish)
        self.create_subscription(
            message_type("stereo_msgs/msg/DisparityImage"), "disparity", self._hear, 10
        )

    def wait_for_answers_to(self, since: int) -> None:
        """Forget earlier answers, those that are still under way too; ns."""
        self.answered, self._since = False, since

    def _publish(self) -> None:
        stamp = self.get_clock().now().to_msg()
        for publisher, message in self._messages:
            message.header.stamp = stamp
            publisher.publish(message)

    def _hear(self, message: Any) -> None:
        self.answered |= stamp_to_nanoseconds(message.header.stamp) >= self._since


if __name__ == "__main__":
    main()
