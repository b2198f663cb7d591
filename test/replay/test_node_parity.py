# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Node and replay publish the same of the same recording, over DDS and without it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from bag_copies import DARK, DIVE_FRAMES, SENSOR_DELAY, copy_bag, disturbed, run

pytest.importorskip("rclpy", reason="ROS is not installed")

from node_run import run_node
from rosbags.typesys import Stores, get_typestore

from uw_visibility.config.schema import NodeConfig
from uw_visibility.messages.estimates import NIS_TOPICS
from uw_visibility.messages.outputs import all_topics
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.columns import FAILED
from uw_visibility_lab.simulation.bag import TOPICS as RECORDED

pytestmark = pytest.mark.node

# The node reads neither the truth nor a transmissometer.
INPUTS = {
    topic: kind for topic, kind in RECORDED.items()
    if "ground_truth" not in topic and topic != "/transmissometer"
}
OUTPUTS = {
    f"/{topic}": kind
    for topic, kind in (
        all_topics(NodeConfig(publish_depth_image=True, publish_points=True)) | NIS_TOPICS
    ).items()
}

# The filter, a learned bias of the sensor, and every optional output.
PARAMETERS = {
    "publish_depth_image": True, "publish_points": True, "tracking.enabled": True,
    "plausibility.max_gate": 50.0,
}


def by_topic(bag: Path) -> dict[str, list[tuple[int, bytes]]]:
    """Return times and serialised messages of each topic."""
    found = defaultdict(list)
    with BagReader(bag) as reader:
        for message in reader.messages():
            found[message.topic].append((message.time, message.data))
    return found


def played(bag: Path, folder: Path, params: Path, expected: dict[str, Any]) -> dict[str, Any]:
    """Play a recording into the node, as much at once as it answers, and return its answers."""
    with BagReader(bag) as reader, run_node(
        folder / "node.log", params, INPUTS, OUTPUTS
    ) as node:
        messages = list(reader.messages(INPUTS))
        for position, message in enumerate(messages):
            node.publish(message)
            following = messages[position + 1].time if message is not messages[-1] else 2**63
            if following > message.time:
                # Frames are answered before what comes next; a comparison with the
                # sensor once its value after the frame is there.
                node.wait_for({
                    topic: sum(
                        time <= message.time - SENSOR_DELAY * (topic[1:] in NIS_TOPICS)
                        for time, _ in answers
                    )
                    for topic, answers in expected.items()
                })
    return node.received


def differences(one: Any, other: Any, where: str) -> Iterator[str]:
    """Yield fields that differ: numbers by more than 1e-6, the rest at all."""
    if is_dataclass(one):
        for field in fields(one):
            if field.name != "__msgtype__":
                name = f"{where}.{field.name}"
                yield from differences(getattr(one, field.name), getattr(other, field.name), name)
    elif isinstance(one, list) and one and is_dataclass(one[0]):
        assert len(one) == len(other), where
        for index, (a, b) in enumerate(zip(one, other, strict=True)):
            yield from differences(a, b, f"{where}[{index}]")
    elif isinstance(one, (float, np.floating)) or getattr(one, "dtype", None) == np.float64:
        if not np.allclose(one, other, rtol=1e-6, atol=1e-9, equal_nan=True):
            yield f"{where}: {one} and {other}"
    elif not np.array_equal(one, other):
        yield where


def test_node_and_replay_publish_the_same(
    dive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    recording = copy_bag(dive, tmp_path / "recording", edit=disturbed)
    params = tmp_path / "params.yaml"
    params.write_text(yaml.safe_dump({"/**": {"ros__parameters": PARAMETERS}}))
    done = run(recording, tmp_path / "out", "--params-file", str(params))
    assert [row["frame"] for row in done.rows if row["status"] == FAILED] == [str(DARK)]
    # The clock that is set back begins the filter anew.
    assert [row["filtering"] for row in done.rows].count("started") == 2
    replayed = by_topic(tmp_path / "out" / "results.mcap")
    assert set(replayed) == set(OUTPUTS)
    received = played(recording, tmp_path, params, replayed)
    types = get_typestore(Stores.ROS2_JAZZY)
    for topic, kind in OUTPUTS.items():
        assert len(received[topic]) == len(replayed[topic]) >= DIVE_FRAMES // 2, topic
        for index, (data, (_, expected)) in enumerate(
            zip(received[topic], replayed[topic], strict=True)
        ):
            found = types.deserialize_cdr(bytes(data), kind)
            wanted = types.deserialize_cdr(expected, kind)
            assert list(differences(found, wanted, f"{topic}[{index}]")) == []
