# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Stereo camera for `benchmarks.node`: publishes one pair repeatedly, at a given rate.

It runs in its own process, like the driver of a camera. It prints one line of JSON: what
was sent, and how many pairs were sent more than half a period late.
"""

from __future__ import annotations

import argparse
import json
import pickle
import sys
import time
from pathlib import Path

import rclpy
from rclpy.qos import ReliabilityPolicy

from uw_visibility_lab.demonstration.client import Player

# The first start of a node compiles its kernels, which takes minutes on a busy machine.
PATIENCE = 300.0  # s


def main() -> None:
    """Wait for subscribers, then publish."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.node_publisher")
    parser.add_argument("frame", help="file of pickled (types, serialised messages), by topic")
    parser.add_argument("--rate", type=float, default=30.0, help="pairs per second")
    parser.add_argument("--frames", type=int, default=90, help="pairs to publish")
    parser.add_argument("--best-effort", action="store_true", help="publish as sensor data")
    parser.add_argument("--wait", type=float, default=2.0, metavar="SECONDS",
                        help="time from the subscription to the first pair")
    parser.add_argument("--paced", action="store_true",
                        help="print ready, then publish a pair for each line of input")
    options = parser.parse_args()
    types, messages = pickle.loads(Path(options.frame).read_bytes())
    rclpy.init(args=[])
    node = rclpy.create_node("stereo_camera")
    reliability = ReliabilityPolicy.RELIABLE
    if options.best_effort:
        reliability = ReliabilityPolicy.BEST_EFFORT
    player = Player(node, types, reliability)
    end = time.monotonic() + PATIENCE
    while unheard := player.unheard():
        if time.monotonic() > end:
            parser.error(f"no node subscribes to {', '.join(unheard)}")
        time.sleep(0.05)
    time.sleep(options.wait)
    if options.paced:
        print("ready", flush=True)
    stamps, late = [], 0
    start = time.monotonic()
    for index in range(options.frames):
        if options.paced:
            sys.stdin.readline()
        else:
            due = start + index / options.rate
            time.sleep(max(due - time.monotonic(), 0.0))
            late += time.monotonic() - due > 0.5 / options.rate
        stamps.append(player.publish(messages))
    if not options.paced:
        # The last messages are still on their way.
        time.sleep(1.0)
    found = {"sent": len(stamps), "late": late, "first": stamps[0], "last": stamps[-1]}
    print(json.dumps(found), flush=True)
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
