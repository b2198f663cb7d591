# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Stereo frames from four inputs: whatever arrives is used or counted, and memory is bounded."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uw_visibility.config.schema import SynchronizationConfig
from uw_visibility.messages.synchronizer import SynchronizedFrame, Synchronizer


class Payload(NamedTuple):
    """What is handed over: an image, or a CameraInfo."""

    seconds: float


def at(seconds: float) -> tuple[int, Payload]:
    """Make a stamp, ns, and what has it."""
    return round(seconds * 1e9), Payload(seconds)


LEFT_INFO, RIGHT_INFO = at(0.0), at(0.0)


def synchronizer(tolerance: float = 0.0, queue_size: int = 10) -> Synchronizer:
    """Make one that has its CameraInfo."""
    result = Synchronizer(SynchronizationConfig(tolerance=tolerance, queue_size=queue_size))
    result.add_info("left", *LEFT_INFO)
    result.add_info("right", *RIGHT_INFO)
    return result


def feed(sync: Synchronizer, *arrivals: tuple[str, float]) -> list[tuple[float, float]]:
    """Add images; return the stamps of the frames."""
    return [
        (frame.left.seconds, frame.right.seconds)
        for side, seconds in arrivals for frame in sync.add_image(side, *at(seconds))
    ]


def test_equal_stamps_make_a_frame_in_either_order() -> None:
    sync = synchronizer()
    assert feed(sync, ("left", 1.0), ("right", 1.0), ("right", 2.0), ("left", 2.0)) == [
        (1.0, 1.0), (2.0, 2.0)
    ]
    assert not sync.dropped
    assert sync.waiting == 0


def test_frame_holds_the_messages_themselves() -> None:
    sync = synchronizer()
    left, right = object(), object()
    sync.add_image("left", 7, left)
    assert sync.add_image("right", 7, right) == [
        SynchronizedFrame(7, 7, left, right, LEFT_INFO[1], RIGHT_INFO[1])]


def test_without_tolerance_stamps_must_be_equal() -> None:
    sync = synchronizer()
    assert feed(sync, ("left", 1.0), ("right", 1.000001), ("left", 1.1), ("right", 1.1)) == [
        (1.1, 1.1)
    ]
    assert sync.dropped == {"left image unmatched": 1, "right image unmatched": 1}


def test_within_a_tolerance_the_nearest_waiting_image_is_taken() -> None:
    sync = synchronizer(tolerance=0.02)
    arrivals = [("left", 1.0), ("left", 1.015), ("right", 1.017), ("left", 1.1), ("right", 1.13)]
    assert feed(sync, *arrivals) == [(1.015, 1.017)]
    assert sync.dropped == {"left image unmatched": 1}


def test_camera_at_twice_the_rate_loses_every_other_image() -> None:
    sync = synchronizer()
    arrivals = [("left", 1 + 0.05 * i) for i in range(40)]
    arrivals += [("right", 1 + 0.1 * i) for i in range(20)]
    arrivals.sort(key=lambda arrival: arrival[1])
    assert len(feed(sync, *arrivals)) == 20
    assert sync.dropped == {"left image unmatched": 19}


def recording(
    start: float, count: int, skew: float, *lost: tuple[str, int]
) -> list[tuple[str, float]]:
    """List the images of two cameras at 10 Hz, the right one behind by a skew, but the lost ones.

    Stamps are multiples of 1 ms, which are compared.
    """
    return [
        (side, round(start + 0.1 * number + (skew if side == "right" else 0.0), 3))
        for number in range(count) for side in ("left", "right") if (side, number) not in lost
    ]


@pytest.mark.parametrize("tolerance", [0.1, 0.25])
@pytest.mark.parametrize("skew", [0.0, 0.02])
def test_lost_image_costs_one_pair_where_the_tolerance_reaches_the_next_image(
    tolerance: float, skew: float
) -> None:
    sync = synchronizer(tolerance)
    lost = ("left", 3), ("right", 20), ("left", 40), ("left", 41)
    frames = feed(sync, *recording(1.0, 60, skew, *lost))
    gaps = [right - left for left, right in frames]
    # What waited for the lost image may be given to the next one, but nothing after it.
    assert sum(abs(gap - skew) > 1e-6 for gap in gaps) <= 2
    assert len(frames) >= 56
    assert 2 * len(frames) + sync.dropped.total() + sync.waiting == 120 - len(lost)


@pytest.mark.parametrize("back", [0.25, 0.5, 50.0])
def test_recording_that_starts_again_after_a_lost_image_is_followed(back: float) -> None:
    # The last pair is of different images, so that stamps near it are compared.
    sync = synchronizer(tolerance=0.1)
    frames = feed(sync, *recording(50.0, 5, 0.0, ("left", 3)))
    assert frames[-1] == (50.4, 50.3)
    # All left images come first.
    again = feed(sync, *sorted(recording(50.4 - back, 5, 0.0)))
    assert [left for left, right in again if left == right] == [
        round(50.4 - back + 0.1 * number, 3) for number in range(5)
    ]
    assert sync.restarts == 1


def test_the_end_releases_the_last_pair_and_counts_what_has_no_partner() -> None:
    sync = synchronizer()
    sync.add_info("left", *at(1.0))
    assert feed(sync, ("left", 1.0), ("right", 1.0)) == [(1.0, 1.0)]
    # CameraInfo comes with every image, so this pair waits for the one that is lost.
    assert feed(sync, ("left", 2.0), ("right", 2.0), ("left", 3.0), ("left", 4.0)) == []
    assert [frame.left.seconds for frame in sync.finish()] == [2.0]
    assert sync.dropped == {"left image unmatched": 2}
    assert sync.waiting == 0
    assert sync.finish() == []


def test_tolerance_can_change_between_images() -> None:
    sync = synchronizer()
    assert feed(sync, ("left", 1.0), ("right", 1.01)) == []
    sync.config = SynchronizationConfig(tolerance=0.05)
    assert feed(sync, ("left", 1.02)) == [(1.02, 1.01)]


def test_late_camera_info_completes_the_newest_pair() -> None:
    sync = Synchronizer(SynchronizationConfig())
    sync.add_info("left", *LEFT_INFO)
    assert feed(sync, ("left", 1.0), ("right", 1.0), ("left", 2.0), ("right", 2.0)) == []
    assert sync.dropped == {
        "left image while there is no right/camera_info": 1,
        "right image while there is no right/camera_info": 1,
    }
    assert [frame.left.seconds for frame in sync.add_info("right", *RIGHT_INFO)] == [2.0]
    assert sync.add_info("right", *RIGHT_INFO) == []


def test_camera_info_without_the_images_stamp_is_the_newest_one() -> None:
    sync = synchronizer()
    newest = at(0.5)
    sync.add_info("left", *newest)
    sync.add_info("left", *at(0.4))
    sync.add_info("left", *newest)
    sync.add_image("left", *at(1.0))
    assert sync.add_image("right", *at(1.0))[0].left_info is newest[1]


def test_frames_have_the_camera_info_of_their_own_stamp_however_late() -> None:
    sync = synchronizer()
    frames = []
    for second in range(1, 6):
        frames += sync.add_info("left", *at(second))
        for side in ("left", "right"):
            frames += sync.add_image(side, *at(second))
        frames += sync.add_info("right", *at(second))
    # Only the first frame could not know that more would come.
    assert [frame.left.seconds for frame in frames] == [1, 2, 3, 4, 5]
    assert [frame.left_info.seconds for frame in frames] == [1, 2, 3, 4, 5]
    assert [frame.right_info.seconds for frame in frames] == [0, 2, 3, 4, 5]
    assert not sync.dropped


def test_camera_info_that_stops_coming_is_waited_for_once() -> None:
    sync = synchronizer()
    for side in ("left", "right"):
        sync.add_info(side, *at(1.0))
    assert feed(sync, ("left", 1.0), ("right", 1.0)) == [(1.0, 1.0)]
    assert feed(sync, ("left", 2.0), ("right", 2.0)) == []
    assert feed(sync, ("left", 3.0), ("right", 3.0)) == [(2.0, 2.0), (3.0, 3.0)]
    assert feed(sync, ("left", 4.0), ("right", 4.0)) == [(4.0, 4.0)]


def test_lost_camera_info_does_not_hold_up_the_last_pair() -> None:
    sync = synchronizer()
    for side in ("left", "right"):
        sync.add_info(side, *at(1.0))
    feed(sync, ("left", 1.0), ("right", 1.0), ("left", 2.0), ("right", 2.0))
    assert sync.end_wait() == []
    assert [frame.left.seconds for frame in sync.end_wait()] == [2.0]
    assert sync.end_wait() == []


def test_pair_that_has_no_camera_info_at_all_goes_on_waiting() -> None:
    sync = Synchronizer(SynchronizationConfig())
    feed(sync, ("left", 1.0), ("right", 1.0))
    assert sync.end_wait() == sync.end_wait() == []
    sync.add_info("left", *LEFT_INFO)
    assert len(sync.add_info("right", *RIGHT_INFO)) == 1


@pytest.mark.parametrize(("arrivals", "dropped"), [
    ([("left", 0.0), ("right", 0.0)], {
        "left image without a stamp": 1, "right image without a stamp": 1,
    }),
    ([("left", 5.1), ("left", 5.1)], {"left image with a stamp seen before": 1}),
    ([("left", 5.0)], {"left image with a stamp seen before": 1}),
    ([("right", 4.5), ("right", 4.5)], {"right image with a stamp seen before": 1}),
    ([("right", 4.5), ("right", 4.4)], {"right image out of order": 1}),
])
def test_stamps_that_cannot_be_used_are_counted(
    arrivals: list[tuple[str, float]], dropped: dict[str, int]
) -> None:
    sync = synchronizer()
    assert feed(sync, ("left", 5.0), ("right", 5.0)) == [(5.0, 5.0)]
    assert feed(sync, *arrivals) == []
    assert sync.dropped == dropped
    assert feed(sync, ("left", 6.0), ("right", 6.0)) == [(6.0, 6.0)]


def test_one_stray_image_from_the_past_or_the_future_changes_nothing() -> None:
    sync = synchronizer(queue_size=3)
    feed(sync, ("left", 50.0), ("right", 50.0))
    arrivals = [("left", 1.0), ("right", 9e5)]
    arrivals += [(side, 51.0 + i) for i in range(5) for side in ("left", "right")]
    assert len(feed(sync, *arrivals)) == 5
    assert sync.restarts == 0


def test_every_drop_is_told() -> None:
    told: Counter[str] = Counter()
    sync = Synchronizer(
        SynchronizationConfig(queue_size=2), lambda reason: told.update([reason])
    )
    feed(sync, *[("left", 1.0 + i) for i in range(9)], ("left", 0.0))
    assert told == sync.dropped
    assert told["left image unmatched"] == 7


def test_late_image_is_out_of_order_once_its_side_goes_on() -> None:
    sync = synchronizer()
    feed(sync, ("left", 5.0), ("right", 5.0), ("left", 4.5))
    assert (sync.waiting, sync.dropped.total()) == (1, 0)
    assert feed(sync, ("left", 5.1), ("right", 5.1)) == [(5.1, 5.1)]
    assert (sync.waiting, sync.dropped, sync.restarts) == (0, {"left image out of order": 1}, 0)


def test_reset_and_the_end_count_whatever_waited() -> None:
    for end in (Synchronizer.reset, Synchronizer.finish):
        sync = synchronizer()
        sync.add_info("left", *at(1.0))
        feed(sync, ("left", 1.0), ("right", 1.0), ("left", 2.0), ("right", 2.0), ("left", 0.5))
        feed(sync, ("right", 3.0))
        end(sync)
        assert sync.waiting == 0
        assert 2 * sync.frames + sync.dropped.total() == 6


@given(
    bags=st.lists(
        st.tuples(st.integers(100, 130), st.integers(2, 8), st.integers(1, 4)), min_size=1,
        max_size=3,
    ),
    plays=st.lists(st.integers(0, 2), min_size=1, max_size=6),
    lead=st.integers(0, 3),
    informed=st.booleans(),
)
def test_recordings_are_answered_whenever_they_are_played(
    bags: list[tuple[int, int, int]], plays: list[int], lead: int, informed: bool
) -> None:
    sync = synchronizer()
    images = 0
    for play in plays:
        start, count, step = bags[play % len(bags)]
        stamps = [(start + step * number) / 10 for number in range(count)]
        answered, dropped = sync.frames, sync.dropped.copy()
        # One side is ahead of the other, as at high rates.
        for number in range(count + lead):
            for side, index in (("left", number), ("right", number - lead)):
                if 0 <= index < count:
                    images += 1
                    sync.add_image(side, *at(stamps[index]))
                    if informed:
                        sync.add_info(side, *at(stamps[index]))
        sync.end_wait()
        sync.end_wait()
        # Of one image nobody can tell whether it is late, or the first one of a recording.
        lost = count - (sync.frames - answered)
        assert lost <= 1
        reasons = {reason.split(" image ")[1] for reason in sync.dropped - dropped}
        assert reasons <= {"with a stamp seen before", "out of order"}
    assert 2 * sync.frames + sync.waiting + sync.dropped.total() == images


ARRIVALS = st.lists(
    st.tuples(st.sampled_from(["left", "right"]), st.integers(0, 60).map(lambda i: i / 10)),
    max_size=80,
)


@given(ARRIVALS, st.sampled_from([0.0, 0.15]), st.integers(1, 4), st.booleans())
def test_every_image_is_used_waits_or_is_counted(
    arrivals: list[tuple[str, float]], tolerance: float, queue_size: int, informed: bool
) -> None:
    sync = Synchronizer(SynchronizationConfig(tolerance=tolerance, queue_size=queue_size))
    if informed:
        sync = synchronizer(tolerance, queue_size)
    for side, seconds in arrivals:
        for frame in sync.add_image(side, *at(seconds)):
            assert abs(frame.left.seconds - frame.right.seconds) <= tolerance + 1e-9
        assert sync.waiting <= 2 * queue_size + 4
    used = 2 * sync.frames
    assert used + sync.waiting + sum(sync.dropped.values()) == len(arrivals)
