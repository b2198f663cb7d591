# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A node in a process of its own, and a client that feeds and hears it."""

from __future__ import annotations

import array
import contextlib
import functools
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from prepared import Forked, Prepared
from scenes import in_water, row_ranges, stereo_pair, texture

from uw_visibility.config.schema import NodeConfig
from uw_visibility.messages.images import stamp_to_nanoseconds
from uw_visibility.messages.outputs import all_topics
from uw_visibility.stereo.rig import StereoRig

ROOT = Path(__file__).resolve().parents[2]
# Set by the conftest above, for this process and the nodes alike.
DOMAIN = int(os.environ["ROS_DOMAIN_ID"])
ENVIRONMENT = {
    **os.environ,
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    "PYTHONUNBUFFERED": "1",
    "PYTHONFAULTHANDLER": "1",
}

# What the node publishes beside the optional outputs, and about itself.
OUTPUTS = all_topics(NodeConfig(publish_depth_image=True, publish_points=True)) | {
    "depth_plausibility/nis": "std_msgs/msg/Float64",
    "depth_plausibility/nis_stamped": "geometry_msgs/msg/Vector3Stamped",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}

# What the node answers every frame with.
ALWAYS = ["disparity", *(
    f"{side}/enhanced/{topic}" for side in ("left", "right") for topic in ("image", "camera_info"))]

# The first start compiles every kernel: three minutes of processor time, others' beside it.
READY_TIMEOUT = 900.0
# The node yields to other processes (`niceness`): beside four that never rest a frame under lamps
# takes ten times as long.
RESULT_TIMEOUT = 100.0
# Until publishers and subscriptions have found one another.
CONNECT_TIMEOUT = 200.0
# What nobody has heard is said again after this time, then after twice as long, so that a machine
# under load is given ever more. Frames that are answered count: the node's filter remembers them.
SERVICE_PATIENCE, FRAME_PATIENCE = 0.1, 2.0

WIDTH, HEIGHT, FOCAL, BASELINE, CENTRE = 160, 120, 200.0, 0.1, (79.5, 59.5)


@dataclass(frozen=True)
class KnownScene:
    """A sloping sea floor whose disparity, water and images are known."""

    left: np.ndarray
    right: np.ndarray
    disparity: np.ndarray
    attenuation: np.ndarray
    ambient_light: np.ndarray


def make_scene() -> KnownScene:
    disparity = np.linspace(5.0, 24.0, HEIGHT)
    # Some of it is black and some white, as the estimate of the water needs.
    radiance = np.clip(1.6 * texture((HEIGHT, WIDTH + 40, 3), 11, (1, 8)) - 0.3, 0.0, 1.0)
    ranges = row_ranges(StereoRig(FOCAL, BASELINE, CENTRE), disparity, WIDTH)
    attenuation, ambient_light = np.array([0.6, 0.4, 0.3]), np.array([0.4, 0.55, 0.6])
    left, right = (
        in_water(view, ranges, attenuation, ambient_light)
        for view in stereo_pair(radiance, disparity, WIDTH)
    )
    rows = np.repeat(disparity[:, np.newaxis], WIDTH, axis=1)
    return KnownScene(left, right, rows, attenuation, ambient_light)


def double(scene: KnownScene) -> KnownScene:
    """Show a scene in twice as many rows and columns: smooth enough for mosaics and JPEG."""
    left, right = (
        cv2.resize(p, None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR)
        for p in (scene.left, scene.right)
    )
    disparity = np.kron(2.0 * scene.disparity, np.ones((2, 2)))
    return KnownScene(left, right, disparity, scene.attenuation, scene.ambient_light)


# As the installed executables do, but for diagnostics that come sooner than once a second.
START = """
import sys
from uw_visibility.ros import monitor
monitor.PERIOD = 0.1
from uw_visibility.ros.start import {0}
sys.exit({0}())
"""
EXECUTABLES = {"node": "node", "lifecycle": "lifecycle_node"}


@functools.cache
def with_modules() -> Prepared:
    """A process that has imported what the nodes do but ROS, and has loaded their kernels.

    ROS starts threads, and so does OpenCV where it may.
    """
    return Prepared(
        "import cv2\nfrom uw_visibility.config.schema import PipelineConfig\n"
        "from uw_visibility.messages import estimates, processor\n"
        "cv2.setNumThreads(1)\n"
        "processor.warm_up(PipelineConfig.from_parameters({'threads': 1}))\n"
        "cv2.setNumThreads(-1)\n",
        # As the current folder is for who starts `python -m`.
        ENVIRONMENT | {"PYTHONPATH": os.pathsep.join(
            filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))},
    )


class NodeProcess:
    """The real node.

    A fresh one is started as a user would start it; others begin where all modules are
    imported, and kernels are loaded.
    """

    def __init__(
        self, folder: Path, *arguments: str, module: str = "node", code: str = "",
        fresh: bool = False,
    ) -> None:
        self._log = folder / f"node_{time.monotonic_ns()}.log"
        given = ["--ros-args", *arguments] if arguments else []
        self.process: Forked | subprocess.Popen[bytes]
        if not fresh:
            self.process = with_modules().start(
                code or START.format(EXECUTABLES[module]), given, environment=ENVIRONMENT,
                cwd=ROOT, output=self._log,
            )
            return
        started = ["-c", code] if code else ["-m", f"uw_visibility.ros.{module}"]
        with self._log.open("w") as output:
            self.process = subprocess.Popen(
                [sys.executable, *started, *given], stdout=output, stderr=subprocess.STDOUT,
                env=ENVIRONMENT, cwd=ROOT,
            )

    @property
    def log(self) -> str:
        return self._log.read_text()

    @property
    def memory(self) -> float:
        """Memory in use, MiB."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(status.split("VmRSS:")[1].split()[0]) / 1024

    def wait_for(self, text: str, timeout: float = RESULT_TIMEOUT) -> None:
        """Wait until the node logs a text."""
        end = time.monotonic() + timeout
        while text not in self.log:
            assert self.process.poll() is None, f"the node has ended:\n{self.log}"
            assert time.monotonic() < end, f"{text!r} did not appear in:\n{self.log}"
            time.sleep(0.02)

    def stop(self, number: int = signal.SIGINT) -> tuple[int, float]:
        """Signal the node; return its exit code and how long it took, s."""
        started = time.monotonic()
        self.process.send_signal(number)
        try:
            return self.process.wait(timeout=20), time.monotonic() - started
        except subprocess.TimeoutExpired:
            # What its threads are doing goes to the log.
            self.process.send_signal(signal.SIGABRT)
            self.process.wait(timeout=20)
            raise AssertionError(f"the node did not end:\n{self.log}") from None

    def end(self) -> None:
        """Wait for the end that a signal has asked for, and enforce it if it does not come."""
        try:
            self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


def input_topics(suffix: str = "") -> dict[str, str]:
    """Return the node's inputs by name, those of images with a suffix."""
    return {
        f"{side}/{name}": f"{side}/{topic}" for side in ("left", "right")
        for name, topic in (("image", f"image_rect{suffix}"), ("camera_info", "camera_info"))
    }


class Client:
    """Publishes stereo frames to a node and collects what comes back."""

    environment = ENVIRONMENT

    def __init__(self, inputs: dict[str, str], namespace: str) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import QoSProfile
        from sensor_msgs.msg import CameraInfo, CompressedImage, Image

        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.node = rclpy.create_node(
            f"client_{time.monotonic_ns()}", namespace=namespace, context=self.context
        )
        self.received: dict[str, list[Any]] = {topic: [] for topic in OUTPUTS}
        types = {"image": Image, "camera_info": CameraInfo}
        self.publishers = {}
        for name, topic in inputs.items():
            kind = CompressedImage if topic.endswith("/compressed") else types[name.split("/")[1]]
            self.publishers[name] = self.node.create_publisher(kind, topic, QoSProfile(depth=50))
        self._subscriptions: dict[str, Any] = {}
        self._services: dict[str, Any] = {}
        for topic in self.received:
            self.listen(topic)
        self._seconds = 100
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._closing = False
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def listen(self, topic: str) -> None:
        """Subscribe to an output."""
        from rclpy.qos import QoSProfile

        from uw_visibility.ros.transport.factory import message_type

        self._subscriptions[topic] = self.node.create_subscription(
            message_type(OUTPUTS[topic]), topic, self.received[topic].append, QoSProfile(depth=50)
        )

    def forget(self, topic: str) -> None:
        """Unsubscribe from an output, and forget what it said."""
        self.node.destroy_subscription(self._subscriptions.pop(topic))
        self.received[topic].clear()

    def _spin(self) -> None:
        from rclpy.exceptions import InvalidHandle

        while not self._closing:
            # A test may destroy what was about to be waited for; the rest goes on.
            with contextlib.suppress(InvalidHandle):
                self._executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        self._closing = True
        self._thread.join(10)
        self._executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def wait(self, done: Callable[[], bool], what: str, timeout: float = RESULT_TIMEOUT) -> None:
        end = time.monotonic() + timeout
        while not done():
            assert time.monotonic() < end, f"{what} did not happen"
            time.sleep(0.01)

    def connect(self, *frame: Any) -> None:
        """Publish a frame until the node answers it, so that nothing later is lost."""
        self.wait(self._is_heard_whole, "a reliable subscription to the images", CONNECT_TIMEOUT)
        patience = FRAME_PATIENCE
        while patience < CONNECT_TIMEOUT:
            stamp = self.publish(*frame)
            end, patience = time.monotonic() + patience, 2.0 * patience
            while time.monotonic() < end:
                # What was published before is answered by then, or never.
                if all(self.has(topic, stamp) for topic in ALWAYS):
                    for messages in self.received.values():
                        messages.clear()
                    return
                time.sleep(0.01)
        raise AssertionError("the node did not answer")

    def _is_heard_whole(self) -> bool:
        """Return whether the node subscribes so that no image is lost."""
        from rclpy.qos import ReliabilityPolicy

        return all(
            any(
                info.qos_profile.reliability is ReliabilityPolicy.RELIABLE
                for info in self.node.get_subscriptions_info_by_topic(
                    self.publishers[f"{side}/image"].topic_name)
            )
            for side in ("left", "right")
        )

    def next_stamp(self) -> int:
        self._seconds += 1
        return self._seconds

    def publish(
        self, left: Any, right: Any, left_info: Any, right_info: Any, stamp: int | None = None,
        nanosec: int = 5,
    ) -> int:
        """Publish a stereo frame; return its stamp in s."""
        stamp = self.next_stamp() if stamp is None else stamp
        messages = {
            "left/camera_info": left_info, "right/camera_info": right_info,
            "left/image": left, "right/image": right,
        }
        for name, message in messages.items():
            message.header.stamp.sec, message.header.stamp.nanosec = stamp, nanosec
            message.header.frame_id = f"{name.split('/')[0]}_camera"
            self.publishers[name].publish(message)
        return stamp

    def call(self, service: str, request: Any) -> Any:
        """Call a service of the node, by its name and with its request."""
        if service not in self._services:
            self._services[service] = self._serve(service, type(request))
        future = self._services[service].call_async(request)
        self.wait(future.done, service)
        return future.result()

    def set_parameters(self, **values: Any) -> Any:
        """Set parameters of the node together; double underscores stand for dots."""
        from rcl_interfaces.srv import SetParametersAtomically
        from rclpy.parameter import Parameter

        return self.call("uw_visibility/set_parameters_atomically", SetParametersAtomically.Request(
            parameters=[Parameter(name.replace("__", "."), value=value).to_parameter_msg()
                        for name, value in values.items()])).result

    def _serve(self, service: str, request: type) -> Any:
        """Make the client of a service, and wait until the node knows it.

        Until then it answers into the void; so it is asked for nothing until it answers.
        """
        name = request.__name__.removesuffix("_Request")
        module = sys.modules[request.__module__.rsplit(".", 1)[0]]
        client = self.node.create_client(getattr(module, name), service)
        patience = SERVICE_PATIENCE
        while patience < RESULT_TIMEOUT:
            assert client.wait_for_service(timeout_sec=RESULT_TIMEOUT), service
            answer, end = client.call_async(request()), time.monotonic() + patience
            patience *= 2.0
            while time.monotonic() < end:
                if answer.done():
                    return client
                time.sleep(0.005)
        raise AssertionError(f"{service} does not answer")

    def has(self, topic: str, stamp: int) -> bool:
        return any(m.header.stamp.sec == stamp for m in list(self.received[topic]))

    def result(self, stamp: int, *topics: str) -> list[Any]:
        """Wait for the messages of topics with a stamp, and return them."""
        self.wait(
            lambda: all(self.has(topic, stamp) for topic in topics), f"{topics} of {stamp}"
        )
        return [
            next(m for m in self.received[topic] if m.header.stamp.sec == stamp)
            for topic in topics
        ]

    def diagnosis(self, part: str) -> Any:
        """Return the newest status of a part of the node, with its values as `numbers`."""
        name = f"{self.node.get_namespace().strip('/')}/uw_visibility: {part}".lstrip("/")
        for message in reversed(list(self.received["/diagnostics"])):
            for status in message.status:
                if status.name == name:
                    numbers = {value.key: value.value for value in status.values}
                    return SimpleNamespace(
                        level=status.level, message=status.message, numbers=numbers)
        return SimpleNamespace(level=None, message="", numbers={})

    def diagnosed(
        self, part: str, message: str, timeout: float = RESULT_TIMEOUT, **numbers: int | str
    ) -> Any:
        """Wait until a part of the node says something, with its numbers; return that status.

        In names of numbers, underscores stand for spaces.
        """
        wanted = {name.replace("_", " "): str(number) for name, number in numbers.items()}
        end = time.monotonic() + timeout
        while True:
            status = self.diagnosis(part)
            if (
                status.level is not None and message in status.message
                and wanted.items() <= status.numbers.items()
            ):
                return status
            assert time.monotonic() < end, f"{message!r} {wanted} was not said, but {status}"
            time.sleep(0.02)

    def stamps(self, topic: str) -> list[int]:
        return [stamp_to_nanoseconds(m.header.stamp) for m in self.received[topic]]


def image_message(pixels: np.ndarray, encoding: str, **changes: Any) -> Any:
    """Make an Image message of an array in the encoding's own layout."""
    from sensor_msgs.msg import Image

    pixels = np.ascontiguousarray(pixels)
    fields = {
        "height": pixels.shape[0], "width": pixels.shape[1], "encoding": encoding,
        "step": pixels.strides[0], "data": array.array("B", pixels.tobytes()),
    }
    return Image(**(fields | changes))


def info_message(side: str, offset: float = 0.0, scale: int = 1, **changes: Any) -> Any:
    """Make the CameraInfo of the known scene; cx of the right camera is less by an offset."""
    from sensor_msgs.msg import CameraInfo

    right = side == "right"
    focal, (cx, cy) = scale * FOCAL, (scale * (c + 0.5) - 0.5 for c in CENTRE)
    cx -= offset if right else 0.0
    fields = {
        "width": scale * WIDTH, "height": scale * HEIGHT, "distortion_model": "plumb_bob",
        "d": [0.0] * 5, "r": np.eye(3).ravel(),
        "k": [focal, 0.0, cx, 0.0, focal, cy, 0.0, 0.0, 1.0],
        "p": [
            focal, 0.0, cx, -focal * BASELINE if right else 0.0,
            0.0, focal, cy, 0.0, 0.0, 0.0, 1.0, 0.0,
        ],
    }
    return CameraInfo(**(fields | changes))


@pytest.fixture(scope="session")
def scene() -> KnownScene:
    """Return the known scene."""
    return make_scene()


@pytest.fixture(scope="session")
def large_scene(scene: KnownScene) -> KnownScene:
    """Return the known scene in twice as many rows and columns; its CameraInfo has scale 2."""
    return double(scene)


@pytest.fixture(scope="module")
def nodes() -> Iterator[list[NodeProcess]]:
    """Nodes that the tests of a module have started."""
    started: list[NodeProcess] = []
    yield started
    # Asked first, since the middleware's shared memory outlives a node that is killed.
    for node in started:
        node.process.send_signal(signal.SIGINT)
    for node in started:
        node.end()


@pytest.fixture(scope="module")
def clients() -> Iterator[list[Client]]:
    """Clients that the tests of a module have made and that hear still."""
    made: list[Client] = []
    yield made
    for client in made:
        client.close()


@pytest.fixture(autouse=True)
def end_with_the_test(nodes: list[NodeProcess], clients: list[Client]) -> Iterator[None]:
    """End what a test has started itself: every client hears the diagnostics of every node."""
    before = len(nodes), len(clients)
    yield
    for node in nodes[before[0]:]:
        node.process.send_signal(signal.SIGINT)
    while len(clients) > before[1]:
        clients.pop().close()


@pytest.fixture(scope="module")
def start_node(
    nodes: list[NodeProcess], tmp_path_factory: pytest.TempPathFactory
) -> Callable[..., NodeProcess]:
    """Start nodes in processes of their own; they end with the test or fixture that starts them."""
    pytest.importorskip("rclpy", reason="ROS is not installed")

    def start(
        *arguments: str, ready: bool = True, module: str = "node", code: str = "",
        fresh: bool = False,
    ) -> NodeProcess:
        folder = tmp_path_factory.mktemp("node")
        nodes.append(NodeProcess(folder, *arguments, module=module, code=code, fresh=fresh))
        if ready:
            nodes[-1].wait_for("ready after", READY_TIMEOUT)
        return nodes[-1]

    return start


@pytest.fixture(scope="module")
def make_client(clients: list[Client]) -> Callable[..., Client]:
    """Make clients; they end with the test or fixture that makes them."""
    pytest.importorskip("rclpy", reason="ROS is not installed")
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

    def make(inputs: dict[str, str] | None = None, namespace: str = "") -> Client:
        clients.append(Client(inputs or input_topics(), namespace))
        return clients[-1]

    return make


@pytest.fixture(scope="session")
def image() -> Callable[..., Any]:
    """Make Image messages."""
    return image_message


@pytest.fixture(scope="session")
def info() -> Callable[..., Any]:
    """Make CameraInfo messages."""
    return info_message


@pytest.fixture(scope="module")
def parts(
    scene: Any, image: Callable[..., Any], info: Callable[..., Any]
) -> tuple[Any, Any, Any, Any]:
    """Return the known scene's messages, whose stamps tests may set."""
    return image(scene.left, "rgb8"), image(scene.right, "rgb8"), info("left"), info("right")
