# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Options of a replay."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from uw_visibility.config.parameters import flatten
from uw_visibility.config.schema import NodeConfig, PipelineConfig
from uw_visibility.errors import InputError, check_range
from uw_visibility.replay.inputs.scalars import LONGEST_TOLERANCE, ScalarTopic
from uw_visibility.replay.inputs.topics import Wanted
from uw_visibility.replay.line_fit import LineFit

# Seconds that no recording is longer than.
LONGEST = 1e9


@dataclass(frozen=True)
class ReplayOptions:
    """Options of a replay: configuration, topics, part of the recording, outputs.

    Attributes
    ----------
    pipeline, node : PipelineConfig, NodeConfig
        The node's parameters; `node.rectify` says whether images are raw.
    wanted : Wanted
        Topics that are given.
    sensor_type : str or None
        Type of the depth sensor, where it is given.
    infos : tuple of two CameraInfo, or None
        Calibration to use instead of the recording's.
    start : float
        Seconds of the recording that are left out.
    duration : float
        Seconds that are replayed.
    every : int
        One frame of so many is processed.
    images : int
        One frame of so many is written to ``images/``; 0 for none.
    video : bool
        Whether ``video.mp4`` is written.
    geo : bool
        Whether ``frames.geojson`` is written.
    netcdf, parquet : bool
        Whether ``frames.nc`` or ``frames.parquet`` is written.
    all_topics : bool
        Whether ``results.mcap`` holds all that the Foxglove layout shows.
    match_original : bool
        Whether the raw pair is matched too, for comparison.
    origin : tuple of float or None
        Latitude and longitude, in degrees, of the origin of an Odometry.
    joins : tuple of ScalarTopic
        Numbers of other topics that are joined to the frames.
    join_tolerance : float
        Values of theirs further apart than this are not neighbours, s.
    turbidity : LineFit or None
        What turns attenuation into the turbidity that a sensor would read.
    several : bool
        Whether this is one of several recordings: what it lacks of the topics to join is told,
        and the rest has its result.
    """

    pipeline: PipelineConfig = field(default_factory=PipelineConfig)
    node: NodeConfig = field(default_factory=NodeConfig)
    wanted: Wanted = field(default_factory=Wanted)
    sensor_type: str | None = None
    infos: tuple[Any, Any] | None = None
    start: float = 0.0
    duration: float = math.inf
    every: int = 1
    images: int = 0
    video: bool = False
    geo: bool = False
    netcdf: bool = False
    parquet: bool = False
    all_topics: bool = False
    match_original: bool = False
    origin: tuple[float, float] | None = None
    joins: tuple[ScalarTopic, ...] = ()
    join_tolerance: float = 2.0
    turbidity: LineFit | None = None
    several: bool = False

    def __post_init__(self) -> None:
        """Validate the options."""
        check_range("--start", self.start, 0.0, LONGEST, "s")
        if self.duration != math.inf:
            check_range("--duration", self.duration, 0.0, LONGEST, "s", above=True)
        check_range("--every", self.every, 1)
        if self.images:
            check_range("--images", self.images, 1)
        check_range(
            "--join-tolerance", self.join_tolerance, 0.0, LONGEST_TOLERANCE, "s", above=True)
        if self.origin is not None and not (
            abs(self.origin[0]) < 90.0 and abs(self.origin[1]) <= 360.0
        ):
            raise InputError(
                f"--origin is {self.origin[0]:g} {self.origin[1]:g}: give latitude and longitude "
                "in degrees, off the poles"
            )
        columns = [join.column for join in self.joins]
        twice = [str(join) for join in self.joins if columns.count(join.column) > 1]
        if twice:
            raise InputError(f"--join names {twice[0]} twice: once is enough")

    def parameters(self) -> dict[str, Any]:
        """Return everything that changes results, for provenance, as JSON has it."""
        values = {
            **{k: v for k, v in self.pipeline.to_parameters().items() if k != "threads"},
            **flatten(self.node),
            "replay.start": self.start,
            "replay.duration": None if math.isinf(self.duration) else self.duration,
            "replay.every": self.every,
            "replay.calibration": None if self.infos is None else repr(self.infos),
            "replay.match_original": self.match_original,
            "replay.origin": self.origin,
            "replay.join": [str(join) for join in self.joins],
            "replay.join_tolerance": self.join_tolerance,
            "replay.turbidity": None if self.turbidity is None else asdict(self.turbidity),
            **{f"replay.{name}": topic for name, topic in asdict(self.wanted).items()},
        }
        return {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}

    def extras(self) -> dict[str, Any]:
        """Return the outputs beside the table and the messages, for JSON."""
        return {
            "images": self.images, "video": self.video, "geo": self.geo, "netcdf": self.netcdf,
            "parquet": self.parquet, "all_topics": self.all_topics,
        }

    def with_threads(self, threads: int) -> ReplayOptions:
        """Return the options with so many threads for each frame, if none are given."""
        if self.pipeline.threads:
            return self
        return replace(self, pipeline=replace(self.pipeline, threads=threads))
