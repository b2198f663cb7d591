# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Signals to the plain and to the managed node, at any moment: each ends it, with exit code 0."""

from __future__ import annotations

import random
import signal
import time
from pathlib import Path
from typing import Any

import live
from fuzz import Outcome

NODE = "import sys; from uw_visibility.ros.start import {0}; sys.exit({0}())"
SIGNALS = (signal.SIGINT, signal.SIGTERM)
# What an operator waits for, with a margin for a machine under load, s.
LONGEST_END = 10.0
# lifecycle_msgs/Transition: configure, cleanup, activate, deactivate, and some that are none.
TRANSITIONS = (1, 1, 2, 3, 3, 4, 0, 8, 255)


class Cases:
    """Nodes that are started, used, and told to end."""

    case = ""

    def __init__(self, folder: Path) -> None:
        self._parts = live.load()
        self._folder = folder
        self._client: Any = None
        # Compiling does not count.
        first = self._parts.NodeProcess(folder, "-r", "__ns:=/first", code=NODE.format("node"))
        first.wait_for("ready after", self._parts.READY_TIMEOUT)
        first.stop()
        scene = self._parts.make_scene()
        self._frame = [
            *(self._parts.image_message(p, "rgb8") for p in (scene.left, scene.right)),
            *(self._parts.info_message(side) for side in live.SIDES),
        ]

    def run(self, seed: int) -> Outcome:
        """Start a node and end it."""
        rng = random.Random(seed)
        name = ("node", "lifecycle_node")[seed % 2]
        number = rng.choice(SIGNALS)
        moments = {"import": self._importing, "start": self._starting, "work": self._working}
        moment = rng.choice(sorted(moments))
        self.case = f"{name}: {number.name} at its {moment}"
        # What the node before has left in discovery must not be called instead of this one.
        namespace = f"/signals_{seed}_{time.monotonic_ns()}"
        self._client = self._parts.Client(self._parts.input_topics(), namespace)
        node = self._parts.NodeProcess(
            self._folder, "-r", f"__ns:={namespace}", "-p", "stereo.max_disparity:=40",
            code=NODE.format(name), fresh=True,
        )
        try:
            moments[moment](node, rng, name)
            if rng.random() < 0.3:
                # Ctrl-C reaches a node from the terminal and from its launcher.
                node.process.send_signal(rng.choice(SIGNALS))
                time.sleep(0.1 * rng.random())
                self.case += ", twice"
            code, seconds = node.stop(number)
        finally:
            if node.process.poll() is None:
                node.process.kill()
                node.process.wait()
            self._client.close()
        log = node.log
        if code or "Traceback" in log or seconds > LONGEST_END:
            return Outcome(self.case, f"code {code} after {seconds:.1f} s", log[-3000:])
        return Outcome(self.case, "read", f"{seconds:.2f} s")

    def _importing(self, node: Any, rng: random.Random, name: str) -> None:
        # The wheels of ROS start the interpreter again; until then signals are not the node's.
        maps = Path(f"/proc/{node.process.pid}/maps")
        while "numpy" not in maps.read_text() and node.process.poll() is None:
            time.sleep(0.005)
        time.sleep(rng.random())

    def _starting(self, node: Any, rng: random.Random, name: str) -> None:
        if name == "node":
            node.wait_for("preparing the pipeline", 60.0)
        else:
            self._change(1)
        time.sleep(0.5 * rng.random())

    def _working(self, node: Any, rng: random.Random, name: str) -> None:
        if name == "node":
            node.wait_for("ready after", self._parts.READY_TIMEOUT)
        else:
            for _ in range(rng.randrange(1, 8)):
                self._change(rng.choice(TRANSITIONS))
                self._client.publish(*self._frame)
        for _ in range(rng.randrange(6)):
            self._client.publish(*self._frame)
            time.sleep(0.05 * rng.random())

    def _change(self, transition: int) -> None:
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        request = ChangeState.Request(transition=Transition(id=transition))
        self._client.call("uw_visibility/change_state", request)
