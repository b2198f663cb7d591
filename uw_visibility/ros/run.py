# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Run loop of a node: middleware settings, callbacks until a signal, exit codes."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, MutableMapping, Sequence
from pathlib import Path
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from uw_visibility.compute.memory import keep_freed_memory
from uw_visibility.errors import LONGEST_MESSAGE, InputError, printable
from uw_visibility.ros.start import SIGNALS

# Fast DDS sends messages to other processes through 512 KiB of the sender's shared memory. One
# image of 640x480 exceeds it: messages that do not fit are lost, or arrive seconds late. With this
# profile the node sends through more shared memory, and receives through sockets, whose memory is
# its own. Without it, most pairs of a best-effort camera are lost: in test_node_large_images 11 of
# 45 arrive.
PROFILES_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
# Any of these shows that the user has configured the middleware.
OTHER_VARIABLES = (
    "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS", "SKIP_DEFAULT_XML_FILE",
)
# Read by Fast DDS from the current folder.
LOCAL_FILE = "DEFAULT_FASTRTPS_PROFILES.xml"
PROFILES = Path(__file__).with_name("fastdds.xml")
# Linux's limit of a socket's memory, and the size of a pair of images, bytes.
SOCKET_MEMORY = Path("/proc/sys/net/core/rmem_max")
ENOUGH = 2 * 640 * 480 * 3


def give_memory(environment: MutableMapping[str, str] = os.environ) -> bool:
    """Select the Fast DDS profile with memory for images; call it before `rclpy.init`.

    The user's own configuration takes precedence. Other middlewares ignore the profile.

    Returns whether the node's own profile is in use.
    """
    if any(environment.get(name) for name in (PROFILES_VARIABLE, *OTHER_VARIABLES)):
        return False
    if Path(LOCAL_FILE).exists() or not PROFILES.exists():
        return False
    environment[PROFILES_VARIABLE] = str(PROFILES)
    return True


def scarce_memory(allowed: Path = SOCKET_MEMORY) -> str:
    """Return advice if the limit in `allowed` is too small for a pair of images, or ""."""
    try:
        size = int(allowed.read_text(encoding="ascii"))
    except (OSError, ValueError):
        # The system is not Linux, or hides the file: the limit is unknown.
        return ""
    if size >= ENOUGH:
        return ""
    return (
        f"a socket may hold {size // 1024} KiB, less than a pair of images, which may come late: "
        "allow more, such as sysctl -w net.core.rmem_max=4194304"
    )


# Time that the exit waits for the frame in process, s.
STOP_TIMEOUT = 0.5
# Period at which an idle executor checks for signals, s.
WAKE_PERIOD = 0.2
# Time for which the pipeline's thread may hold the interpreter's lock while callbacks wait, s: a
# tenth of Python's default.
SWITCH_INTERVAL = 5e-4


def run(make_node: Callable[[], Any], arguments: Sequence[str] | None) -> int:
    """Run a node until SIGINT or SIGTERM.

    make_node: makes a node with a method ``stop(timeout) -> bool``, which stops its work and
        returns whether that ended within the timeout (s), and an attribute ``faults`` (`FaultLog`)
        for the exceptions of callbacks.
    arguments: command line with ROS arguments; by default that of the process.
    Returns exit code: 0 after a signal, 2 if a parameter or argument cannot be used.
    """
    sys.setswitchinterval(SWITCH_INTERVAL)
    keep_freed_memory()
    # Handlers only record the signal. rclpy's own would end the context while this thread and
    # the worker use it; Python's own would raise an exception anywhere.
    received: list[int] = []
    for number in SIGNALS:
        signal.signal(number, lambda number, _: received.append(number))
    receives_by_sockets = give_memory()
    try:
        rclpy.init(
            args=None if arguments is None else list(arguments),
            signal_handler_options=SignalHandlerOptions.NO,
        )
    except Exception as error:
        return _refuse(error)
    try:
        # rclpy ignores them, such as parameters without --ros-args.
        others = remove_ros_args(sys.argv[1:] if arguments is None else list(arguments))
        if others:
            raise InputError(f"unknown argument {others[0]}: ROS arguments follow --ros-args")
        node = make_node()
    except (InputError, InvalidParameterTypeException) as error:
        # The latter is of parameters that rclpy declares itself, such as use_sim_time.
        rclpy.try_shutdown()
        return _refuse(error)
    scarcity = scarce_memory() if receives_by_sockets else ""
    if scarcity:
        node.get_logger().warning(scarcity)
    _spin(node, received)
    if not node.stop(STOP_TIMEOUT):
        # The worker is still computing, which cannot be interrupted.
        rclpy.try_shutdown()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)
    node.destroy_node()
    rclpy.try_shutdown()
    return 0


def _spin(node: Any, signals: Sequence[int]) -> None:
    """Run callbacks until a signal is in `signals`; log their exceptions and continue."""
    executor = SingleThreadedExecutor()
    clock = Clock(clock_type=ClockType.STEADY_TIME)
    wake = node.create_timer(WAKE_PERIOD, lambda: None, clock=clock)
    executor.add_node(node)
    while not signals and rclpy.ok():
        try:
            executor.spin_once()
        except Exception as error:
            node.faults.add(error)
    executor.shutdown()
    node.destroy_timer(wake)


def _refuse(error: Exception) -> int:
    text = " ".join(str(error).split())
    print(f"uw_visibility: {printable(text, LONGEST_MESSAGE)}", file=sys.stderr)
    return 2
