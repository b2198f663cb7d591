# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Frames of the last minutes."""

import math

from hypothesis import given
from hypothesis import strategies as st

from uw_visibility.config.schema import SurveyConfig
from uw_visibility.water.window import FrameWindow


def test_an_empty_window_has_no_newest_frame_and_any_frame_continues_it():
    window = FrameWindow(SurveyConfig())
    assert math.isnan(window.newest) and window.duration == 0.0 and len(window) == 0
    assert window.continued_by(-5.0)


def test_frames_that_left_the_window_are_forgotten_also_by_a_frame_that_adds_nothing():
    window = FrameWindow(SurveyConfig(window=10.0))
    for stamp in (0.0, 4.0, 9.0):
        window.add(stamp, stamp)
    window.add(None, 12.0)
    assert window.items == [4.0, 9.0]
    assert (window.newest, window.duration) == (9.0, 5.0)
    assert not window.continued_by(9.0)


@given(st.lists(st.floats(0.01, 2.0), min_size=1, max_size=60))
def test_thinned_out_frames_keep_the_first_and_last_and_their_order(gaps):
    window = FrameWindow(SurveyConfig(window=600.0, min_frames=2, max_frames=8))
    stamps = [sum(gaps[:i + 1]) for i in range(len(gaps))]
    for stamp in stamps:
        window.add(stamp, stamp)
    assert len(window) == min(len(stamps), 8)
    assert window.items == sorted(window.items)
    assert window.items[0] == stamps[0] and window.items[-1] == stamps[-1]


def test_the_frame_with_the_closest_neighbours_is_left_out():
    window = FrameWindow(SurveyConfig(window=600.0, min_frames=2, max_frames=4))
    for stamp in (0.0, 10.0, 11.0, 12.0, 30.0):
        window.add(stamp, stamp)
    assert window.items == [0.0, 10.0, 12.0, 30.0]
