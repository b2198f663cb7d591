# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The managed node: its states, and transitions that nobody should ask for."""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Callable
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")

from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState

CONFIGURE, CLEANUP = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_CLEANUP
ACTIVATE, DEACTIVATE = Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_DEACTIVATE
UNCONFIGURED, INACTIVE = State.PRIMARY_STATE_UNCONFIGURED, State.PRIMARY_STATE_INACTIVE
ACTIVE = State.PRIMARY_STATE_ACTIVE
# What leads from a state to another; all else is refused.
LEADS = {
    (UNCONFIGURED, CONFIGURE): INACTIVE, (INACTIVE, CLEANUP): UNCONFIGURED,
    (INACTIVE, ACTIVATE): ACTIVE, (ACTIVE, DEACTIVATE): INACTIVE,
}
# The node's own and nobody's among them.
ASKED = (CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE, 0, 8, 10, 42, 62, 255)
# What an operator waits for, with a margin for a machine under load, s.
LONGEST_END = 10.0
# More of them take longer: TRANSITIONS=500 makes it a minute and a half.
TRANSITIONS = int(os.environ.get("TRANSITIONS", "60"))


COMPILING = """
import os, signal, sys, threading, time
from concurrent.futures import ThreadPoolExecutor
from uw_visibility.messages import processor
from uw_visibility.ros import lifecycle
from uw_visibility.ros.run import run
class Pipeline:
    def __init__(self, *arguments):
        pass
    def warm_up(self, *arguments, **options):
        ThreadPoolExecutor(1).submit(time.sleep, 60.0).result()
processor.Pipeline = Pipeline
class Node(lifecycle.UwVisibilityLifecycleNode):
    def __init__(self):
        super().__init__()
        self.trigger_configure()
        time.sleep(0.5)
        self.trigger_cleanup()
        threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGTERM)).start()
sys.exit(run(Node, []))
"""


class Managed:
    """A managed node and who manages it."""

    def __init__(self, process: Any, client: Any) -> None:
        self.process = process
        self.client = client

    def change(self, transition: int, label: str = "") -> bool:
        request = ChangeState.Request(transition=Transition(id=transition, label=label))
        return bool(self.client.call("uw_visibility/change_state", request).success)

    @property
    def state(self) -> int:
        response = self.client.call("uw_visibility/get_state", GetState.Request())
        return int(response.current_state.id)

    def end(self, number: int) -> None:
        code, seconds = self.process.stop(number)
        assert (code, "Traceback" in self.process.log) == (0, False), self.process.log
        assert seconds < LONGEST_END


@pytest.fixture
def manage(start_node: Callable[..., Any], make_client: Callable[..., Any]) -> Callable[..., Any]:
    def start(namespace: str) -> Managed:
        process = start_node(
            "-r", f"__ns:={namespace}", "-p", "stereo.max_disparity:=40", module="lifecycle",
            ready=False,
        )
        return Managed(process, make_client(namespace=namespace))

    return start


def test_lifecycle(manage: Callable[[str], Managed], parts: Any) -> None:
    managed = manage("/managed")
    client, log = managed.client, lambda: managed.process.log
    assert managed.state == UNCONFIGURED
    for round_ in (1, 2):
        # In every state there is a heartbeat.
        assert client.diagnosed("lifecycle", "unconfigured").level == DiagnosticStatus.WARN
        assert managed.change(CONFIGURE)
        client.wait(lambda n=round_: log().count("ready after") == n, "compiling", timeout=900.0)
        assert managed.state == INACTIVE
        status = client.diagnosed("input", "the node is not active: activate it")
        assert status.level == DiagnosticStatus.WARN
        client.wait(lambda: client.publishers["left/image"].get_subscription_count() > 0, "it")
        silent = client.publish(*parts)
        assert managed.change(ACTIVATE)
        client.connect(*parts)
        assert managed.state == ACTIVE
        client.result(client.publish(*parts), "disparity", "visibility/attenuation")
        assert client.diagnosed("lifecycle", "active").level == DiagnosticStatus.OK
        assert managed.change(DEACTIVATE)
        paused = client.publish(*parts)
        time.sleep(0.5)
        assert not client.has("disparity", silent) and not client.has("disparity", paused)
        for part in ("input", "pipeline", "plausibility"):
            status = client.diagnosed(part, "the node is not active: activate it")
            assert status.level == DiagnosticStatus.WARN
        assert managed.change(CLEANUP)
        assert managed.state == UNCONFIGURED
        client.wait(
            lambda: client.publishers["left/image"].get_subscription_count() == 0, "a clean-up"
        )
        client.received["/diagnostics"].clear()
    managed.end(signal.SIGTERM)


def test_managed_node_that_crashed_goes_on_by_itself(
    start_node: Callable[..., Any], make_client: Callable[..., Any], parts: Any
) -> None:
    client = make_client(namespace="/crashed")
    for crash in (signal.SIGKILL, None):
        # As respawn starts it: with the same arguments, at once.
        process = start_node(
            "-r", "__ns:=/crashed", "-p", "stereo.max_disparity:=40", "-p", "autostart:=true",
            module="lifecycle",
        )
        client.connect(*parts)
        client.result(client.publish(*parts), "disparity")
        if crash is not None:
            process.process.send_signal(crash)
            process.process.wait(20)
    managed = Managed(process, make_client(namespace="/crashed"))
    assert managed.state == ACTIVE
    assert managed.change(DEACTIVATE)
    assert managed.change(CLEANUP)
    managed.client.received["/diagnostics"].clear()
    # Nobody but a manager brings it up again.
    managed.client.diagnosed("lifecycle", "unconfigured")
    assert managed.state == UNCONFIGURED
    managed.end(signal.SIGINT)


def test_transitions_in_any_order_with_images(
    manage: Callable[[str], Managed], parts: Any
) -> None:
    managed = manage("/erratic")
    generator = random.Random(5)
    state, memory = UNCONFIGURED, []
    for _ in range(TRANSITIONS):
        leading = [asked for (begin, asked) in LEADS if begin == state]
        transition = generator.choice(leading if generator.random() < 0.4 else ASKED)
        label = "no such transition" if generator.random() < 0.1 else ""
        wanted = None if label else LEADS.get((state, transition))
        assert managed.change(transition, label) == (wanted is not None), (state, transition)
        state = wanted or state
        for _ in range(generator.randrange(4)):
            managed.client.publish(*parts)
        # As long as a frame takes, or less.
        time.sleep(0.1 * generator.random())
        memory.append(managed.process.memory)
    assert managed.state == state
    if state == UNCONFIGURED:
        assert managed.change(CONFIGURE)
    if state != ACTIVE:
        assert managed.change(ACTIVATE)
    managed.client.connect(*parts)
    assert managed.client.diagnosed("callbacks", "").numbers["failed callbacks"] == "0"
    # A frame's memory, times the rounds, would be more.
    third = TRANSITIONS // 3
    assert max(memory[2 * third :]) - max(memory[third : 2 * third]) < 20.0
    managed.end(signal.SIGINT)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signal_after_clean_up(manage: Callable[[str], Managed], number: int) -> None:
    managed = manage(f"/cleaned_{int(number)}")
    assert managed.change(CONFIGURE)
    assert managed.change(CLEANUP)
    managed.end(number)


def test_signal_while_a_worker_that_was_cleaned_up_still_compiles(
    start_node: Callable[..., Any]
) -> None:
    # Python's exit would wait for whatever runs in a pool of threads.
    node = start_node(code=COMPILING, ready=False)
    assert (node.process.wait(50), "Traceback" in node.log) == (0, False), node.log


def test_configuration_that_fails_leaves_nothing_behind(
    start_node: Callable[..., Any], make_client: Callable[..., Any]
) -> None:
    process = start_node(
        "-r", "__ns:=/refused", "-p", "qos_overrides./refused/nothing.publisher.depth:=3",
        module="lifecycle", ready=False,
    )
    managed = Managed(process, make_client(namespace="/refused"))
    for _ in range(2):
        assert not managed.change(CONFIGURE)
        assert managed.state == UNCONFIGURED
    assert "did you mean qos_overrides./refused/" in process.log
    status = managed.client.diagnosed(
        "lifecycle", "unconfigured: cannot be configured: unknown parameter qos_overrides.")
    assert status.level == DiagnosticStatus.ERROR
    node = managed.client.node
    for count in (node.count_publishers, node.count_subscribers):
        topic = "disparity" if count == node.count_publishers else "left/image_rect"
        managed.client.wait(lambda c=count, t=topic: c(t) == 0, f"the end of {topic}")
    managed.end(signal.SIGINT)
