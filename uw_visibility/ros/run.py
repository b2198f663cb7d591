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
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from uw_visibility.errors import LONGEST_MESSAGE, InputError, printable
from uw_visibility.ros.start import SIGNALS

# Fast DDS hands messages to other processes through 512 KiB of the sender's shared memory, which
# one image of 640x480 overruns; what finds no room is lost, or comes seconds late. The profile lets
# the node send through more shared memory and receive through sockets, whose memory is its own.
# Without it, a camera that publishes with best effort loses most pairs: test_node_large_images,
# 11 of 45 arrive.
PROFILES_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
# With any of these somebody has set up the middleware already.
OTHER_VARIABLES = (
    "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS", "SKIP_DEFAULT_XML_FILE",
)
# Read by Fast DDS from the current folder.
LOCAL_FILE = "DEFAULT_FASTRTPS_PROFILES.xml"
PROFILES = Path(__file__).with_name("fastdds.xml")
# What Linux allows the memory of a socket to be, and what a pair of images needs, bytes.
SOCKET_MEMORY = Path("/proc/sys/net/core/rmem_max")
ENOUGH = 2 * 640 * 480 * 3


def give_memory(environment: MutableMapping[str, str] = os.environ) -> bool:
    """Enlarge the memory of transport for images; to be called before `rclpy.init`.

    Nothing changes where the middleware was set up otherwise. Other middlewares do not
    read the variable.

    Returns whether the node's own profile is in use.
    """
    if any(environment.get(name) for name in (PROFILES_VARIABLE, *OTHER_VARIABLES)):
        return False
    if Path(LOCAL_FILE).exists() or not PROFILES.exists():
        return False
    environment[PROFILES_VARIABLE] = str(PROFILES)
    return True


def scarce_memory(allowed: Path = SOCKET_MEMORY) -> str:
    """Return advice where a socket may not hold a pair of images, by a file of Linux; else ""."""
    try:
        size = int(allowed.read_text(encoding="ascii"))
    except (OSError, ValueError):
        # Another system, or one that hides it: nothing is known to be wrong.
        return ""
    if size >= ENOUGH:
        return ""
    return (
        f"a socket may hold {size // 1024} KiB, less than a pair of images, which may come late: "
        "allow more, such as sysctl -w net.core.rmem_max=4194304"
    )


# How long the exit waits for the frame that is being processed, s.
STOP_TIMEOUT = 0.5
# How often an executor that sleeps looks whether a signal has come, s.
WAKE_PERIOD = 0.2
# How long the pipeline's thread may keep the interpreter from the callbacks, s. By
# default it is ten times as long, which is what an answer then waits.
SWITCH_INTERVAL = 5e-4


def run(make_node: Callable[[], Any], arguments: Sequence[str] | None) -> int:
    """Run a node until it is told to stop.

    make_node: makes a node with a method ``stop(timeout) -> bool``, which ends its work and tells
        whether that has ended within the timeout (s), and an attribute ``faults`` (`FaultLog`),
        which is told what callbacks raise.
    arguments: command line with ROS arguments; that of the process where absent.
    Returns exit code: 0 after Ctrl-C or SIGTERM, 2 where a parameter or argument cannot be used.
    """
    sys.setswitchinterval(SWITCH_INTERVAL)
    # A signal only asks for the end. rclpy's handlers would end the context under whatever
    # uses it, here and in the worker; Python's own raise at a place of their choice.
    asked: list[int] = []
    for number in SIGNALS:
        signal.signal(number, lambda number, _: asked.append(number))
    receives_by_sockets = give_memory()
    try:
        rclpy.init(
            args=None if arguments is None else list(arguments),
            signal_handler_options=SignalHandlerOptions.NO,
        )
    except Exception as error:
        return _refuse(error)
    try:
        node = make_node()
    except InputError as error:
        rclpy.try_shutdown()
        return _refuse(error)
    scarcity = scarce_memory() if receives_by_sockets else ""
    if scarcity:
        node.get_logger().warning(scarcity)
    _spin(node, asked)
    if not node.stop(STOP_TIMEOUT):
        # The worker is still computing, which cannot be interrupted.
        rclpy.try_shutdown()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)
    node.destroy_node()
    rclpy.try_shutdown()
    return 0


def _spin(node: Any, asked: Sequence[int]) -> None:
    """Run callbacks until a signal asks for the end; what they raise costs none but them."""
    executor = SingleThreadedExecutor()
    clock = Clock(clock_type=ClockType.STEADY_TIME)
    wake = node.create_timer(WAKE_PERIOD, lambda: None, clock=clock)
    executor.add_node(node)
    while not asked and rclpy.ok():
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
