# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Synchroniser of the four input topics; everything dropped has a counted reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

from uw_visibility.config.schema import SynchronizationConfig
from uw_visibility.messages.frames import StereoFrame
from uw_visibility.messages.images import stamp_to_nanoseconds

SIDES = ("left", "right")

# A pair that is older than the last one by more than this comes from a
# recording that was started again; one that is less old came out of order.
RESTART_NANOSECONDS = 1_000_000_000


class Synchronizer:
    """Synchroniser that pairs images by their stamps and adds each side's CameraInfo.

    An image is paired as soon as a partner within the tolerance is there: the
    nearest of those that wait. Where a camera sends a CameraInfo with every
    image, a pair waits for those of its own stamps, until the next pair or
    `end_wait` at the latest; where it does not, the newest one is taken at once. Every image
    leaves as part of a frame or is counted in `dropped`, and what waits is
    bounded.

    Parameters
    ----------
    config : SynchronizationConfig
        Tolerance and length of the queues.
    on_drop : callable
        Called with the reason for every image dropped.

    Attributes
    ----------
    config : SynchronizationConfig
        May be replaced at any time.
    received : Counter of str
        Messages by input: left, right, left info, right info.
    dropped : Counter of str
        Images by the reason why they are in no frame.
    frames : int
        Frames made.
    restarts : int
        How often the stamps jumped back.
    """

    def __init__(
        self,
        config: SynchronizationConfig,
        on_drop: Callable[[str], None] = lambda reason: None,
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
        self._pair: dict[str, Any] | None = None
        self._waited: dict[str, Any] | None = None
        self._last: int | None = None
        # Stamps of the last frame, to see whether CameraInfo comes with every image.
        self._sent: dict[str, int] = {}
        self._with_every_image = dict.fromkeys(SIDES, False)

    @property
    def waiting(self) -> int:
        """Images that wait, for a partner or for their CameraInfo."""
        return sum(map(len, self._waiting.values())) + (2 if self._pair else 0)

    def reset(self) -> None:
        """Drop what waits and accept any stamp next; CameraInfo and counters stay."""
        for side, queue in self._waiting.items():
            for _ in range(len(queue)):
                self._drop(f"{side} image unmatched")
            queue.clear()
        self._pair = self._waited = self._last = None
        self._sent = {}

    def add_info(self, side: str, info: Any) -> list[StereoFrame]:
        """Take a CameraInfo.

        Parameters
        ----------
        side : str
            "left" or "right".
        info : object
            The message.

        Returns
        -------
        list of StereoFrame
            The frame that waited for this message, or nothing.
        """
        self.received[f"{side} info"] += 1
        stamp = stamp_to_nanoseconds(info.header.stamp)
        infos = self._infos[side]
        # Taken out first, so that the newest arrival is always the last one.
        infos.pop(stamp, None)
        infos[stamp] = info
        while len(infos) > self.config.queue_size:
            del infos[next(iter(infos))]
        if stamp == self._sent.get(side):
            self._with_every_image[side] = True
        return self._release(at_once=False)

    def add_image(self, side: str, image: Any) -> list[StereoFrame]:
        """Take an image.

        Parameters
        ----------
        side : str
            "left" or "right".
        image : object
            The message; its stamp decides.

        Returns
        -------
        list of StereoFrame
            The frame that it completes, after one that it ends the wait of.
        """
        self.received[side] += 1
        stamp = stamp_to_nanoseconds(image.header.stamp)
        reason = self._refusal(side, stamp)
        if reason:
            self._drop(f"{side} image {reason}")
            return []
        other = SIDES[side == "left"]
        partner = self._partner(other, stamp)
        if partner is None:
            self._wait(side, stamp, image)
            return []
        pair = {side: image, other: self._waiting[other].pop(partner)}
        self._advance(min(stamp, partner))
        frames = self._release(at_once=True)
        self._pair = pair
        return frames + self._release(at_once=False)

    def end_wait(self) -> list[StereoFrame]:
        """Release a pair that was there at the last call already, with the newest CameraInfo.

        Called from time to time, so that a CameraInfo that was lost does not
        hold up the last pair of a sequence.

        Returns
        -------
        list of StereoFrame
            The frame, or nothing.
        """
        waited, self._waited = self._waited, self._pair
        known = all(self._infos.values())
        return self._release(at_once=True) if known and waited is self._pair else []

    def finish(self) -> list[StereoFrame]:
        """End a sequence: release the pair that is there, and drop what has no partner.

        Returns
        -------
        list of StereoFrame
            The frame, or nothing.
        """
        frames = self._release(at_once=True)
        for side, queue in self._waiting.items():
            for _ in range(len(queue)):
                self._drop(f"{side} image unmatched")
            queue.clear()
        return frames

    def _refusal(self, side: str, stamp: int) -> str:
        if stamp == 0:
            return "without a stamp"
        if stamp in self._waiting[side]:
            return "with a stamp seen before"
        if self._last is not None and 0 <= self._last - stamp < RESTART_NANOSECONDS:
            return "with a stamp seen before" if stamp == self._last else "out of order"
        return ""

    def _partner(self, side: str, stamp: int) -> int | None:
        """Return the stamp of the nearest image that waits within the tolerance."""
        tolerance = round(self.config.tolerance * 1e9)
        stamps = self._waiting[side]
        if tolerance == 0:
            return stamp if stamp in stamps else None
        nearest = min(stamps, key=lambda other: abs(other - stamp), default=None)
        return nearest if nearest is not None and abs(nearest - stamp) <= tolerance else None

    def _wait(self, side: str, stamp: int, image: Any) -> None:
        queue = self._waiting[side]
        queue[stamp] = image
        # The oldest arrival leaves, not the oldest stamp: a stamp from the
        # future must not stay for ever.
        while len(queue) > self.config.queue_size:
            del queue[next(iter(queue))]
            self._drop(f"{side} image unmatched")

    def _advance(self, stamp: int) -> None:
        """Note the time of a new pair, and let go of images that it leaves behind."""
        restarted = self._last is not None and stamp < self._last
        if restarted:
            self.restarts += 1
        self._last = stamp
        for side, queue in self._waiting.items():
            for other in [other for other in queue if restarted or other < stamp]:
                del queue[other]
                self._drop(f"{side} image unmatched")

    def _release(self, at_once: bool) -> list[StereoFrame]:
        """Return the pair that waits with its CameraInfo, if that is there or not waited for."""
        if self._pair is None:
            return []
        missing = [side for side in SIDES if not self._infos[side]]
        if missing:
            if at_once:
                self._drop_pair(missing)
            return []
        stamps = {side: stamp_to_nanoseconds(self._pair[side].header.stamp) for side in SIDES}
        late = [side for side in SIDES if stamps[side] not in self._infos[side]]
        if not at_once and any(self._with_every_image[side] for side in late):
            return []
        for side in SIDES:
            self._with_every_image[side] = side not in late
        infos = {
            side: self._infos[side].get(stamps[side]) or next(reversed(self._infos[side].values()))
            for side in SIDES
        }
        frame = StereoFrame(self._pair["left"], self._pair["right"], infos["left"], infos["right"])
        self._pair = None
        self._sent = stamps
        self.frames += 1
        return [frame]

    def _drop_pair(self, missing: list[str]) -> None:
        self._pair = None
        names = " and ".join(f"{side}/camera_info" for side in missing)
        for side in SIDES:
            self._drop(f"{side} image while there is no {names}")

    def _drop(self, reason: str) -> None:
        self.dropped[reason] += 1
        self._on_drop(reason)
