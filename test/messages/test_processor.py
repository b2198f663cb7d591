# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""From messages to messages: what nobody wants is not made, and changes no estimate."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from plain_messages import camera_info, image_message, make
from scenes import in_water, processed, row_ranges, stereo_pair, texture

from uw_visibility.config.schema import NodeConfig, PipelineConfig
from uw_visibility.messages.frames import StereoFrame
from uw_visibility.messages.outputs import all_topics
from uw_visibility.messages.processor import FrameProcessor, warm_up
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.status import Status
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.series.filter import FilteredWater
from uw_visibility.water.series.tracking import TrackingEvent

HEIGHT, WIDTH = 96, 128
TOPICS = all_topics(NodeConfig())
ESTIMATES = {topic for topic in TOPICS if topic.startswith("visibility/")}


def frame() -> StereoFrame:
    """Make a pair of three planes under water."""
    disparity = np.repeat((16.0, 10.0, 6.0), HEIGHT // 3)
    ranges = row_ranges(StereoRig(160.0, 0.1, (63.5, 47.5)), disparity, WIDTH)
    pair = [
        in_water(view, ranges, [0.5, 0.3, 0.2], [0.5, 0.5, 0.5])
        for view in stereo_pair(texture((HEIGHT, WIDTH + 16, 3), 5), disparity)
    ]
    infos = (camera_info((WIDTH, HEIGHT), 160.0, (63.5, 47.5), tx) for tx in (0.0, -16.0))
    return StereoFrame(*(image_message(pixels, "rgb8") for pixels in pair), *infos)


def test_matches_are_rated_where_asked_for_and_stay_the_same() -> None:
    processor = FrameProcessor(make, rectify=False)
    settings = PipelineConfig(), NodeConfig()
    without, _ = processed(processor, frame(), *settings, TOPICS)
    rated, _ = processed(processor, frame(), *settings, TOPICS, confidence=True)
    assert without.stereo.confidence is None
    assert rated.stereo.confidence is not None
    np.testing.assert_array_equal(rated.stereo.confidence > 0, np.isfinite(rated.disparity))
    np.testing.assert_array_equal(rated.disparity, without.disparity)


def test_images_that_nobody_wants_are_not_made_and_change_no_estimate() -> None:
    processor = FrameProcessor(make, rectify=False)
    settings = PipelineConfig(), NodeConfig()
    whole, every = processed(processor, frame(), *settings, TOPICS)
    result, few = processed(processor, frame(), *settings, ESTIMATES)
    assert set(few) == ESTIMATES & set(every)
    images = result.images
    assert (images.left.size, images.right.size, images.limited.size) == (0, 0, 0)
    assert np.isnan(result.stereo.filled).all()
    np.testing.assert_array_equal(result.water.attenuation, whole.water.attenuation)
    np.testing.assert_array_equal(result.disparity, whole.disparity)
    assert np.isfinite(whole.water.attenuation).any()
    for side, other in (("left", "right"), ("right", "left")):
        result, messages = processed(processor, frame(), *settings, {f"{side}/enhanced/image"})
        shown, hidden = (getattr(result, f"{name}_enhanced") for name in (side, other))
        np.testing.assert_array_equal(shown, getattr(whole, f"{side}_enhanced"))
        assert hidden.size == 0
        assert list(messages) == [f"{side}/enhanced/image"]


def test_a_filtered_estimate_is_told_apart_from_the_frame_s_own() -> None:
    work = FrameProcessor(make, rectify=False).begin(frame(), PipelineConfig())
    assert (work.pair.rig.focal_length, work.header.seconds) == (160.0, 1.0)
    alone, filtered = (
        WaterEstimate(
            Status.OK, np.full(3, attenuation), np.full(3, 0.5),
            0.01 * np.eye(6), 9, 30, (Status.OK,) * 3,
        )
        for attenuation in (0.2, 0.4)
    )
    result = replace(work.assess(ESTIMATES), water=alone)
    for given, expected in (
        (None, 0.2), (FilteredWater(filtered, result.visibility, TrackingEvent.UPDATED), 0.4),
    ):
        messages = dict(work.messages(result, NodeConfig(), ESTIMATES, given))
        assert messages["visibility/raw/attenuation"].vector.y == 0.2
        assert messages["visibility/attenuation"].vector.y == expected


def test_threads_outlive_the_calibration() -> None:
    processor = FrameProcessor(make, rectify=False)
    before = set(threading.enumerate())
    started = []
    for focal in (160.0, 161.0, 162.0):
        changed = frame()
        for info in (changed.left_info, changed.right_info):
            info.p[0] = info.p[5] = focal
        work = processor.begin(changed, PipelineConfig(threads=3))
        assert work.pair.rig.focal_length == focal
        work.assess(())
        started.append(set(threading.enumerate()) - before)
    assert started[0] and started[0] <= started[1] <= started[2]
    assert len(started[2]) <= 2


def test_a_process_warms_up_once_for_a_configuration(monkeypatch: pytest.MonkeyPatch) -> None:
    """A replay of a hundred short recordings would take frames of its own for each."""
    shapes: list[Any] = []
    monkeypatch.setattr(Pipeline, "warm_up", lambda self, shape, **_: shapes.append(shape))
    warm_up.cache_clear()
    for limit in (40, 40, 48):
        warm_up(PipelineConfig.from_parameters({"stereo.max_disparity": limit}))
    # What was only said to be compiled is not remembered beyond this test.
    warm_up.cache_clear()
    assert len(shapes) == 2
