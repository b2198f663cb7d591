# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Filter over frames in a replay, where the frames' estimates arrive in order.

The filter is the only part of a frame's way that needs the frames before it. It
is applied here, to estimates that other processes may have made.
"""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from uw_visibility.config.schema import NodeConfig, PipelineConfig
from uw_visibility.messages.estimates import ESTIMATES, Estimate, ImageHeader, field_of_view
from uw_visibility.messages.outputs import FILTERED, all_topics
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.replay.bags.types import jazzy_types
from uw_visibility.replay.table import number
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.estimation import WaterEstimate
from uw_visibility.water.filter import FilteredWater, WaterFilter


@dataclass(frozen=True)
class FrameEstimate:
    """Estimate and headers of a frame, for the filter and its messages.

    Attributes
    ----------
    water : WaterEstimate
        Of the frame alone.
    rig : StereoRig
        Another one begins anew.
    field_of_view : float
        Of the left image, rad.
    header : ImageHeader
        Of the left image.
    """

    water: WaterEstimate
    rig: StereoRig
    field_of_view: float
    header: ImageHeader

    @classmethod
    def of(cls, result: FrameResult, rig: StereoRig, header: ImageHeader) -> FrameEstimate:
        """Take it from a result, without what is large."""
        view = field_of_view(result.disparity.shape[1], rig.focal_length)
        return cls(result.water, rig, view, header)


def split_topics(pipeline: PipelineConfig, node: NodeConfig) -> tuple[list[str], list[str]]:
    """Return the topics that a frame alone fills, and those of the filter."""
    topics = list(all_topics(node))
    if not pipeline.tracking.enabled:
        return topics, []
    filtered = [f"{FILTERED}/{name}" for name in ESTIMATES]
    return [t for t in topics if t not in filtered], filtered


class FilterStage:
    """Filter stage: filters estimates in order and makes the messages of the filtered ones.

    Parameters
    ----------
    pipeline, node : PipelineConfig, NodeConfig
        Parameters.
    """

    def __init__(self, pipeline: PipelineConfig, node: NodeConfig) -> None:
        self._node = node
        self._store, self._make = jazzy_types()
        self._filter = WaterFilter(pipeline)

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
        filtered = self._filter.update(estimate.water, estimate.header.seconds, estimate.rig)
        if filtered is None:
            return [], {}
        source = Estimate(
            self._make, estimate.header, filtered.water, filtered.visibility,
            estimate.field_of_view, self._node,
        )
        messages = ((name, kind, source.message(name)) for name, kind in ESTIMATES.items())
        return [
            (f"{FILTERED}/{name}", bytes(self._store.serialize_cdr(message, kind)))
            for name, kind, message in messages if message is not None
        ], _columns(filtered)


def _columns(filtered: FilteredWater) -> dict[str, str]:
    visibility = filtered.visibility
    return {
        "filtered_mean_attenuation": number(visibility.mean_attenuation),
        "filtered_mean_attenuation_stddev": number(visibility.mean_attenuation_stddev),
        "filtered_visibility_distance": number(visibility.distance),
        "filtered_visibility_distance_stddev": number(visibility.distance_stddev),
        "filtered_depth": number(visibility.depth),
        "filtered_depth_stddev": number(visibility.depth_stddev),
        "filtering": str(filtered.event),
    } | ({} if filtered.survey is None else {
        "survey_frames": str(filtered.survey.frames),
        "survey_range_min": number(filtered.survey.range_min),
        "survey_range_max": number(filtered.survey.range_max),
    })


class EstimateLog:
    """Log of the estimates of a replay under way, so that it can be resumed.

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
