# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Synchroniser of the four input topics; it counts all drops by reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

from uw_visibility.config.schema import SynchronizationConfig

SIDES = ("left", "right")

# A pair that is older than the last one by this or more comes from a recording
# that was restarted. An image that is less old may be out of order: the next
# image of its side decides.
RESTART_NANOSECONDS = 1_000_000_000


class SynchronizedFrame(NamedTuple):
    """Two matching images with the CameraInfo of each; stamps in ns."""

    stamp: int
    right_stamp: int
    left: Any
    right: Any
    left_info: Any
    right_info: Any


class Synchronizer:
    """Synchroniser that pairs images by their stamps and adds each side's CameraInfo.

    An image is paired with the nearest waiting one of the other side within the tolerance. One
    whose partner was given to another is dropped: otherwise it would take that of the next image,
    and so on. If a camera sends a CameraInfo with every image, a pair waits for those with its
    stamps, until the next pair or `end_wait`; otherwise the newest one is used at once. Every image
    becomes part of a frame or is counted in `dropped`; the number of those that wait is limited. If
    the stamps of a side jump back and increase from there, the synchroniser restarts.

    on_drop: called with the reason for every dropped image.
    config: may be replaced at any time.
    received, dropped: numbers of messages by input, and of dropped images by reason.
    frames, restarts: numbers of frames, and of jumps back of stamps or clock.
    """

    def __init__(
        self, config: SynchronizationConfig, on_drop: Callable[[str], None] = lambda reason: None
    ) -> None:
        self.config = config
        self._on_drop = on_drop
        self.received: Counter[str] = Counter()
        self.dropped: Counter[str] = Counter()
        self.frames = 0
        self.restarts = 0
        # By stamp, in the order of arrival.
        self._waiting: dict[str, dict[int, Any]] = {side: {} for side in SIDES}
        self._infos: dict[str, dict[int, Any]] = {side: {} for side in SIDES}
        # By side, the image that is older than the last pair, with its stamp.
        self._late: dict[str, tuple[int, Any]] = {}
        self._pair: dict[str, tuple[int, Any]] | None = None
        self._waited: dict[str, tuple[int, Any]] | None = None
        self._last: int | None = None
        # Stamps of the last pair, by side.
        self._paired: dict[str, int] = {}
        # Stamps of the last frame, to see whether CameraInfo comes with every image.
        self._sent: dict[str, int] = {}
        self._with_every_image = dict.fromkeys(SIDES, False)

    @property
    def waiting(self) -> int:
        """Number of images that wait for a partner, their CameraInfo, or the next image."""
        waiting = sum(map(len, self._waiting.values())) + len(self._late)
        return waiting + (2 if self._pair else 0)

    def reset(self) -> None:
        """Drop waiting images and accept any stamp next; keep CameraInfo and counters."""
        self._drop_waiting()
        for side in SIDES if self._pair is not None else ():
            self._drop(f"{side} image without its camera_info")
        self._pair = self._waited = self._last = None
        self._paired, self._sent = {}, {}

    def restart(self, now: int) -> None:
        """Reset after the clock was set back to `now`, ns; counted unless the stamps were first."""
        self.restarts += self._last is not None and self._last > now
        self.reset()

    def add_info(self, side: str, stamp: int, info: Any) -> list[SynchronizedFrame]:
        """Add a side's CameraInfo of a stamp, ns; return the frame that waited for it, if any."""
        self.received[f"{side} info"] += 1
        infos = self._infos[side]
        # Removed first, so that the newest arrival is always the last one.
        infos.pop(stamp, None)
        infos[stamp] = info
        while len(infos) > self.config.queue_size:
            del infos[next(iter(infos))]
        if stamp == self._sent.get(side):
            self._with_every_image[side] = True
        return self._release(at_once=False)

    def add_image(self, side: str, stamp: int, image: Any) -> list[SynchronizedFrame]:
        """Add a side's image of a stamp, ns; 0 means no stamp.

        Returns the frame that it completes, preceded by one that it ends the wait of.
        """
        self.received[side] += 1
        if stamp == 0 or stamp in self._waiting[side]:
            self._drop(f"{side} image {'with a stamp seen before' if stamp else 'without a stamp'}")
            return []
        # Only an image less than the limit before the last pair, or of its stamp, may be late.
        if self._last is None or not 0 <= self._last - stamp < RESTART_NANOSECONDS:
            self._drop_late(side)
            return self._take(side, stamp, image)
        late = self._late.get(side)
        if late is not None and late[0] < stamp:
            return self._start_again() + self._take(side, stamp, image)
        if stamp == self._last or (late is not None and late[0] == stamp):
            self._drop(f"{side} image with a stamp seen before")
            return []
        self._drop_late(side)
        self._late[side] = stamp, image
        return []

    def refuse_image(self, side: str, reason: str) -> None:
        """Count an image as received and dropped, with the reason."""
        self.received[side] += 1
        self._drop(f"{side} image {reason}")

    def end_wait(self) -> list[SynchronizedFrame]:
        """Release a pair that was waiting at the last call already, with the newest CameraInfo.

        Called by a timer, so that a lost CameraInfo does not hold back the last
        pair of a sequence.
        """
        waited, self._waited = self._waited, self._pair
        known = all(self._infos.values())
        return self._release(at_once=True) if known and waited is self._pair else []

    def finish(self) -> list[SynchronizedFrame]:
        """End a sequence: release the waiting pair, and drop images without a partner."""
        frames = self._release(at_once=True)
        self._drop_waiting()
        return frames

    def _take(self, side: str, stamp: int, image: Any) -> list[SynchronizedFrame]:
        """Pair an image with a waiting one, or let it wait."""
        other = SIDES[side == "left"]
        if self._paired:
            mine, theirs = self._paired[side], self._paired[other]
            if abs(stamp - theirs) < abs(mine - theirs):
                # Its own partner was given to an image that is farther from it.
                self._drop(f"{side} image unmatched")
                return []
        partner = self._partner(other, stamp)
        if partner is None:
            self._wait(side, stamp, image)
            return []
        pair = {side: (stamp, image), other: (partner, self._waiting[other].pop(partner))}
        self._paired = {side: stamp, other: partner}
        restarted = self._advance(min(stamp, partner))
        frames = self._release(at_once=True)
        self._pair = pair
        frames += self._release(at_once=False)
        return frames + (self._take_late() if restarted else [])

    def _take_late(self) -> list[SynchronizedFrame]:
        """Pair the late images, which are the first ones of a restarted recording."""
        late, self._late = self._late, {}
        frames = []
        for side, (stamp, image) in late.items():
            frames += self._take(side, stamp, image)
        return frames

    def _start_again(self) -> list[SynchronizedFrame]:
        """Restart with the late images: a recording was restarted."""
        frames = self._release(at_once=True)
        self._forget_before_restart()
        self._last = None
        self._paired, self._sent = {}, {}
        return frames + self._take_late()

    def _forget_before_restart(self) -> None:
        self.restarts += 1
        # Images older than the last pair belong to the restarted recording.
        self._drop_unmatched(lambda stamp: self._last is not None and stamp > self._last)

    def _partner(self, side: str, stamp: int) -> int | None:
        """Return the stamp of the nearest waiting image within the tolerance."""
        tolerance = round(self.config.tolerance * 1e9)
        near = [other for other in self._waiting[side] if abs(other - stamp) <= tolerance]
        return min(near, key=lambda other: abs(other - stamp), default=None)

    def _wait(self, side: str, stamp: int, image: Any) -> None:
        queue = self._waiting[side]
        queue[stamp] = image
        # The oldest arrival is dropped, not the oldest stamp: an image with a
        # stamp in the future must not stay for ever.
        while len(queue) > self.config.queue_size:
            del queue[next(iter(queue))]
            self._drop(f"{side} image unmatched")

    def _advance(self, stamp: int) -> bool:
        """Store the stamp of a new pair, and drop waiting images that are older.

        Returns whether the pair is from a restarted recording.
        """
        restarted = self._last is not None and stamp < self._last
        if restarted:
            self._forget_before_restart()
        self._last = stamp
        self._drop_unmatched(lambda other: other < stamp)
        return restarted

    def _release(self, at_once: bool) -> list[SynchronizedFrame]:
        """Return the waiting pair with its CameraInfo, if that is there or not waited for."""
        if self._pair is None:
            return []
        missing = [side for side in SIDES if not self._infos[side]]
        if missing:
            if at_once:
                self._pair = None
                names = " and ".join(f"{side}/camera_info" for side in missing)
                for side in SIDES:
                    self._drop(f"{side} image while there is no {names}")
            return []
        stamps = {side: self._pair[side][0] for side in SIDES}
        late = [side for side in SIDES if stamps[side] not in self._infos[side]]
        if not at_once and any(self._with_every_image[side] for side in late):
            return []
        for side in SIDES:
            self._with_every_image[side] = side not in late
        infos = {
            side: self._infos[side].get(stamps[side]) or next(reversed(self._infos[side].values()))
            for side in SIDES
        }
        left, right = (self._pair[side][1] for side in SIDES)
        self._pair = None
        self._sent = stamps
        self.frames += 1
        return [SynchronizedFrame(
            stamps["left"], stamps["right"], left, right, infos["left"], infos["right"]
        )]

    def _drop_waiting(self) -> None:
        self._drop_unmatched(lambda stamp: True)
        for side in SIDES:
            self._drop_late(side)

    def _drop_unmatched(self, dropped: Callable[[int], bool]) -> None:
        """Drop the waiting images of some stamps."""
        for side, queue in self._waiting.items():
            for stamp in list(filter(dropped, queue)):
                del queue[stamp]
                self._drop(f"{side} image unmatched")

    def _drop_late(self, side: str) -> None:
        if self._late.pop(side, None) is not None:
            self._drop(f"{side} image out of order")

    def _drop(self, reason: str) -> None:
        self.dropped[reason] += 1
        self._on_drop(reason)
