# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Run the node with a publisher, and measure its answers and their latency.

    python -m benchmarks.node --rate 30 --seconds 120
    python -m benchmarks.node --rate 4 --seconds 60 --everything
    python -m benchmarks.node --table --seconds 30 --size 1280x960
    python -m benchmarks.node --starts 5 --disparity-only

Node, camera and listener are three processes; the node's environment is that of its launch
file. Latency is the time from an image's stamp, which is the time of its publication, to the
arrival of its disparity. `--table` (`make rates`) prints the share of frames that are answered at
10, 15 and 30 Hz, with subscriptions to the disparity only and to all images. `--starts` measures
the time from the node's start to the first answer instead, with the camera running; `--cold` does
so without kernels on disk. Measure on an idle machine, since the three processes share its
processors. `make soak` measures memory.
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message

from benchmarks.__main__ import load_pair
from uw_visibility.compute.threads import use_one_thread
from uw_visibility.config.schema import NodeConfig
from uw_visibility.messages.images import write_image
from uw_visibility.messages.outputs import all_topics
from uw_visibility.messages.stamps import header_stamp
from uw_visibility.ros.transport.factory import make_message, message_type
from uw_visibility_lab.demonstration.node_process import (
    COMMAND,
    NodeDied,
    NodeProcess,
    reserved_domain,
)
from uw_visibility_lab.simulation.bag import camera_info_message
from uw_visibility_lab.simulation.camera import StereoCamera

START_TIMEOUT = 300.0
BASELINE = 0.160
TABLE_RATES = (10.0, 15.0, 30.0)
EVERYTHING = ("-p", "publish_depth_image:=true", "-p", "publish_points:=true")


def main() -> int:
    """Run the benchmark and print what it found."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.node", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--rate", type=float, default=30.0, help="pairs per second")
    parser.add_argument("--table", action="store_true", help="all rates and subscriptions")
    parser.add_argument("--size", default="640x480", help="size of the images, px")
    parser.add_argument("--seconds", type=float, default=120.0, help="duration of publishing")
    parser.add_argument("--everything", action="store_true", help="depth image and points, too")
    parser.add_argument("--disparity-only", action="store_true", help="subscribe to no images")
    parser.add_argument("-p", action="append", default=[], metavar="NAME:=VALUE", dest="given",
                        help="parameter of the node")
    parser.add_argument("--starts", type=int, default=0, help="number of starts to time instead")
    parser.add_argument("--cold", action="store_true", help="every start compiles all kernels")
    options = parser.parse_args()
    use_one_thread()
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    if options.table:
        print_table(options)
        return 0
    if options.starts:
        print_starts(options)
        return 0
    for name, value in run(options).items():
        print(f"{name:38s} {value if isinstance(value, int | str) else f'{value:.2f}'}")
    return 0


def print_table(options: argparse.Namespace) -> None:
    """Print answered frames, latency and processor time, by rate and subscriptions."""
    print("| Subscribed | Input | Answered | Latency, median, 95 % | Processor time per answer |")
    print("| --- | --- | --- | --- | --- |")
    for subscribed, options.disparity_only in (("disparity", True), ("all images", False)):
        for options.rate in TABLE_RATES:
            report = run(options)
            print(
                f"| {subscribed} | {options.rate:g} Hz | "
                f"{report['frames answered'] / report['pairs sent']:.0%} | "
                f"{report['latency, median (ms)']:.0f}, {report['latency, 95 % (ms)']:.0f} ms | "
                f"{report['processor time per answer (ms)']:.0f} ms |", flush=True)


def print_starts(options: argparse.Namespace) -> None:
    """Print the time from the node's start to its first answer.

    On a shared machine processor time is more reliable than elapsed time.
    """
    times = []
    for _ in range(options.starts):
        with tempfile.TemporaryDirectory() as folder, reserved_domain() as domain:
            os.environ["ROS_DOMAIN_ID"] = str(domain)
            if options.cold:
                os.environ["NUMBA_CACHE_DIR"] = folder
            listener, camera = start_camera(Path(folder), options, "--wait", "0")
            begin = time.monotonic()
            try:
                with started_node(Path(folder), domain, options) as node:
                    while not listener.answers:
                        check(node, begin)
                        time.sleep(0.01)
                    times.append((time.monotonic() - begin, processor_time(node.pid)))
            finally:
                camera.kill()
                camera.wait()
                listener.close()
        print("first answer after {:.2f} s, processors {:.2f} s".format(*times[-1]), flush=True)
    elapsed, worked = (statistics.median(column) for column in zip(*times, strict=True))
    print(f"median: {elapsed:.2f} s; processors {worked:.2f} s")


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Start the node, publish to it, and return the numbers."""
    with tempfile.TemporaryDirectory() as folder, reserved_domain() as domain:
        os.environ["ROS_DOMAIN_ID"] = str(domain)
        with started_node(Path(folder), domain, options) as node:
            return measure(node, Path(folder), options)


def started_node(folder: Path, domain: int, options: argparse.Namespace) -> NodeProcess:
    """Return the node's process, not started yet; its log is in the folder."""
    arguments = [part for given in options.given for part in ("-p", given)]
    arguments += EVERYTHING if options.everything else ()
    ros = ("--ros-args", *arguments) if arguments else ()
    return NodeProcess(folder / "node.log", domain, (*COMMAND, *ros))


def measure(node: NodeProcess, folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Publish to the running node, listen, and return the numbers."""
    begin = time.monotonic()
    while "ready after" not in (folder / "node.log").read_text(encoding="utf-8"):
        check(node, begin)
        time.sleep(0.1)
    listener, publisher = start_camera(folder, options)
    load = watch(node.pid, publisher, listener)
    sent = json.loads(publisher.communicate()[0])
    time.sleep(1.5)
    listener.close()
    return summarise(sent, listener) | load


def check(node: NodeProcess, begin: float) -> None:
    """Raise NodeDied if the node has ended, or takes too long to start."""
    node.check()
    if time.monotonic() > begin + START_TIMEOUT:
        raise NodeDied(f"the node has not started within {START_TIMEOUT:.0f} s")


def start_camera(
    folder: Path, options: argparse.Namespace, *more: str
) -> tuple[Listener, subprocess.Popen[bytes]]:
    """Start a listener and a camera, which publishes once the node subscribes."""
    frame = folder / "frame.pickle"
    frame.write_bytes(pickle.dumps(make_frame(*map(int, options.size.split("x")))))
    config = NodeConfig(publish_depth_image=options.everything, publish_points=options.everything)
    topics = all_topics(config)
    if options.disparity_only:
        topics = {topic: name for topic, name in topics.items() if topic == "disparity"}
    rclpy.init(args=[])
    listener = Listener(topics)
    publisher = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.node_publisher", str(frame), "--rate",
         str(options.rate), "--frames", str(round(options.rate * options.seconds)), *more],
        stdout=subprocess.PIPE,
    )
    return listener, publisher


def make_frame(width: int, height: int) -> tuple[dict[str, str], dict[str, bytes]]:
    """Return types and serialised messages of a stereo frame by topic, in drivers' order."""
    left, right, _ = load_pair(width, height)
    camera = StereoCamera(width, height, 3740.0 * width / 1282, BASELINE)
    messages = {}
    for side, image in (("left", left), ("right", right)):
        header = make_message("std_msgs/msg/Header", frame_id=f"{side}_camera")
        messages[f"{side}/image_rect"] = write_image(make_message, image, "rgb8", header)
        messages[f"{side}/camera_info"] = camera_info_message(
            make_message, header, camera, right=side == "right")
    types = {
        topic: f"sensor_msgs/msg/{type(message).__name__}" for topic, message in messages.items()
    }
    return types, {topic: serialize_message(message) for topic, message in messages.items()}


class Listener:
    """Subscriber to the node's results and diagnostics.

    answers: time of arrival by stamp, ns. diagnostics: values by name, by part of the node.
    """

    def __init__(self, topics: Mapping[str, str]) -> None:
        self.answers: dict[int, int] = {}
        self.diagnostics: list[dict[str, dict[str, str]]] = []
        self._node = Node("listener")
        for topic, name in topics.items():
            self._node.create_subscription(
                message_type(name), topic,
                self._hear if topic == "disparity" else lambda data: None,
                QoSProfile(depth=10), raw=True,
            )
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnose, 10)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop listening."""
        rclpy.shutdown()
        self._thread.join()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            # The listener was closed.
            return

    def _hear(self, data: bytes) -> None:
        self.answers[header_stamp(data)] = time.time_ns()

    def _diagnose(self, message: DiagnosticArray) -> None:
        self.diagnostics.append({
            status.name.split(": ")[1]: {value.key: value.value for value in status.values}
            for status in message.status
        })


def processor_time(pid: int) -> float:
    """Return the processor time of a process, s."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / float(os.sysconf("SC_CLK_TCK"))


def watch(
    pid: int, publisher: subprocess.Popen[bytes], listener: Listener
) -> dict[str, float]:
    """Return the processor load from the first answer until the publisher ends."""
    while not listener.answers and publisher.poll() is None:
        time.sleep(0.05)
    begin, worked, heard = time.monotonic(), processor_time(pid), len(listener.answers)
    publisher.wait()
    worked = processor_time(pid) - worked
    return {
        "processors busy with the node": worked / (time.monotonic() - begin),
        "processor time per answer (ms)": 1e3 * worked / max(len(listener.answers) - heard, 1),
    }


def summarise(sent: dict[str, int], listener: Listener) -> dict[str, Any]:
    """Return the numbers by name."""
    latency = sorted(
        1e-6 * (arrival - stamp) for stamp, arrival in listener.answers.items()
        if sent["first"] <= stamp <= sent["last"]
    )
    if not latency:
        raise RuntimeError("the node has answered no frame: see its log")
    last = listener.diagnostics[-1]
    halfway = listener.diagnostics[len(listener.diagnostics) // 2]
    reliability = halfway["input"]["reliability of left/image_rect"]
    return {
        "pairs sent": sent["sent"],
        "pairs sent late": sent["late"],
        "images received": int(last["input"]["left received"])
        + int(last["input"]["right received"]),
        "images lost by the middleware": int(last["input"]["images lost by the middleware"]),
        "reliability": reliability,
        "pairs received": int(last["input"]["stereo frames"]),
        "frames answered": len(latency),
        "frames skipped for newer ones": int(last["pipeline"]["frames skipped"]),
        "frames neither answered nor counted": int(last["input"]["stereo frames"]) - sum(
            int(last["pipeline"][f"frames {fate}"])
            for fate in ("processed", "refused", "failed", "skipped")),
        "pipeline, median (ms)": pipeline_time(listener, "total (ms)"),
        "around the pipeline, median (ms)": pipeline_time(listener, "around the pipeline (ms)"),
        "latency, median (ms)": statistics.median(latency),
        "latency, 95 % (ms)": float(np.quantile(latency, 0.95)),
        "latency, largest (ms)": latency[-1],
    }


def pipeline_time(listener: Listener, name: str) -> float:
    """Return the median of a time in the node's diagnostics, which come once a second."""
    parts = [values["pipeline"] for values in listener.diagnostics]
    return statistics.median(float(part[name]) for part in parts if name in part)


if __name__ == "__main__":
    sys.exit(main())
