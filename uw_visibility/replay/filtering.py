# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The water filtered over frames, where the frames' estimates arrive in order.

The filter is the only part of a frame's way that needs the frames before it. It
is applied here, to estimates that other processes may have made.
"""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from uw_visibility.config.schema import NodeConfig, PipelineConfig
from uw_visibility.messages.images import stamp_to_nanoseconds
from uw_visibility.messages.output_images import Source
from uw_visibility.messages.outputs import all_topics, each_message
from uw_visibility.optics.spectra import load_response
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.replay.bags.types import jazzy_types
from uw_visibility.replay.table import number
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.assessment import Assessor, Visibility
from uw_visibility.water.estimation import WaterEstimate
from uw_visibility.water.tracking import WaterTracker

FOLDER, RAW = "visibility/", "visibility/raw/"


@dataclass(frozen=True)
class FrameEstimate:
    """What the filter and its messages need of a frame.

    Attributes
    ----------
    water, visibility
        Of the frame alone.
    rig : StereoRig
        Another one begins anew.
    shape : tuple of int
        Height and width of the images.
    seconds, nanoseconds, frame_id
        Of the left image's header.
    """

    water: WaterEstimate
    visibility: Visibility
    rig: StereoRig
    shape: tuple[int, int]
    seconds: int
    nanoseconds: int
    frame_id: str

    @classmethod
    def of(cls, result: FrameResult, rig: StereoRig, header: Any) -> FrameEstimate:
        """Take it from a result, without what is large."""
        height, width = result.disparity.shape
        return cls(
            replace(result.water, envelope=None), result.visibility, rig, (height, width),
            int(header.stamp.sec), int(header.stamp.nanosec), str(header.frame_id),
        )


def split_topics(pipeline: PipelineConfig, node: NodeConfig) -> tuple[list[str], list[str]]:
    """Return the topics that a frame alone fills, and those of the filter."""
    topics = list(all_topics(node))
    if not pipeline.tracking.enabled:
        return topics, []
    filtered = [t for t in topics if t.startswith(FOLDER) and not t.startswith(RAW)]
    return [t for t in topics if t not in filtered], filtered


class FilterStage:
    """Filters estimates in order and makes the messages of the filtered ones.

    Parameters
    ----------
    pipeline, node : PipelineConfig, NodeConfig
        Parameters.
    """

    def __init__(self, pipeline: PipelineConfig, node: NodeConfig) -> None:
        camera = pipeline.camera
        self._node = node
        self._topics = split_topics(pipeline, node)[1]
        self._types = all_topics(node)
        self._store, self._make = jazzy_types()
        self._assessor = Assessor(
            pipeline.assessment, load_response(camera.response), camera.white_reference
        )
        self._tracker = WaterTracker(pipeline.tracking)
        self._rig: StereoRig | None = None

    def add(self, estimate: FrameEstimate) -> tuple[list[tuple[str, bytes]], dict[str, str]]:
        """Take a frame's estimate.

        Parameters
        ----------
        estimate : FrameEstimate
            Of the next frame.

        Returns
        -------
        messages : list of tuple
            Topic and serialised message.
        columns : dict of str to str
            Of the table.
        """
        if not self._topics:
            return [], {}
        if estimate.rig != self._rig:
            self._tracker.reset()
            self._rig = estimate.rig
        header = SimpleNamespace(
            stamp=SimpleNamespace(sec=estimate.seconds, nanosec=estimate.nanoseconds),
            frame_id=estimate.frame_id,
        )
        water = self._tracker.update(
            estimate.water, 1e-9 * stamp_to_nanoseconds(header.stamp)
        )
        visibility = self._assessor.assess(water)
        source = self._source(estimate, header, water, visibility)
        return [
            (topic, bytes(self._store.serialize_cdr(message, self._types[topic])))
            for topic, message in each_message(source, self._topics)
        ], self._columns(visibility)

    def _source(
        self, estimate: FrameEstimate, header: Any, water: WaterEstimate, visibility: Visibility
    ) -> Source:
        """Return what messages of the filtered estimate are made from."""
        result: Any = SimpleNamespace(
            water=estimate.water, visibility=estimate.visibility, tracked=water,
            tracked_visibility=visibility, disparity=np.broadcast_to(np.nan, estimate.shape),
        )
        frame: Any = SimpleNamespace(left=SimpleNamespace(header=header))
        pair: Any = SimpleNamespace(rig=estimate.rig)
        return Source(self._make, frame, pair, result, self._node)

    def _columns(self, visibility: Visibility) -> dict[str, str]:
        return {
            "filtered_mean_attenuation": number(visibility.mean_attenuation),
            "filtered_mean_attenuation_stddev": number(visibility.mean_attenuation_stddev),
            "filtered_visibility_distance": number(visibility.distance),
            "filtered_visibility_distance_stddev": number(visibility.distance_stddev),
            "filtered_depth": number(visibility.depth),
            "filtered_depth_stddev": number(visibility.depth_stddev),
            "filtering": str(self._tracker.event or ""),
        }


class EstimateLog:
    """Keeps estimates of a replay under way, so that it can be gone on from.

    Parameters
    ----------
    folder : Path
        Where the replay writes.
    """

    NAME = "estimates.pickle"

    def __init__(self, folder: Path) -> None:
        self._path = folder / self.NAME
        self._file = self._path.open("wb")

    def write(self, frame: str, estimate: FrameEstimate) -> None:
        """Add a frame's."""
        pickle.dump((frame, estimate), self._file)
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def remove(self) -> None:
        """Remove the file: the replay is complete."""
        self._path.unlink()

    @classmethod
    def read(cls, folder: Path) -> Iterator[tuple[str, FrameEstimate]]:
        """Yield number and estimate of frames, up to where the file ends."""
        path = folder / cls.NAME
        if not path.is_file():
            return
        with path.open("rb") as file:
            while True:
                try:
                    yield pickle.load(file)
                except (EOFError, pickle.UnpicklingError):
                    return
