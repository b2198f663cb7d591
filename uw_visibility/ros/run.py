# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Run loop of a node until a signal ends it, and its exit codes."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from uw_visibility.errors import LONGEST_MESSAGE, InputError, printable
from uw_visibility.ros.start import SIGNALS
from uw_visibility.ros.transport.middleware import give_memory, scarce_memory

# How long the exit waits for the frame that is being processed, s.
STOP_TIMEOUT = 0.5
# How often an executor that sleeps looks whether a signal has come, s.
WAKE_PERIOD = 0.2
# How long the pipeline's thread may keep the interpreter from the callbacks, s. By
# default it is ten times as long, which is what an answer then waits.
SWITCH_INTERVAL = 5e-4


def run(make_node: Callable[[], Any], arguments: Sequence[str] | None) -> int:
    """Run a node until it is told to stop.

    Parameters
    ----------
    make_node : callable
        Makes a node with a method ``stop(timeout) -> bool``, which ends its work
        and tells whether that has ended within the timeout (s), and an attribute
        ``faults`` (`FaultLog`), which is told what callbacks raise.
    arguments : sequence of str or None
        Command line with ROS arguments; that of the process where absent.

    Returns
    -------
    int
        Exit code: 0 after Ctrl-C or SIGTERM, 2 where a parameter or argument
        cannot be used.
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
        _leave()
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


def _leave() -> None:
    """End the process while the worker is still computing, which cannot be interrupted."""
    rclpy.try_shutdown()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)
