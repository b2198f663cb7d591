# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Options of a replay, and the topics to join that a recording lacks."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from uw_visibility.config.parameters import flatten
from uw_visibility.config.schema import NodeConfig, PipelineConfig
from uw_visibility.errors import InputError, check_range
from uw_visibility.images.network import digests
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.inputs.sensors import LONGEST_TOLERANCE, ScalarTopic, check_join
from uw_visibility.replay.inputs.topics import POSITION_TYPES, Wanted, check_topic, depth_types
from uw_visibility.replay.line_fit import LineFit
from uw_visibility.replay.stores import Place, recording_here

ATTRIBUTES = (
    "title", "summary", "keywords", "institution", "license", "id", "naming_authority", "project",
    "program", "acknowledgement", "comment", "platform", "platform_vocabulary", "instrument",
    "instrument_vocabulary", "metadata_link", "date_created", "date_issued",
    *(f"{role}_{what}" for role in ("creator", "publisher")
      for what in ("name", "email", "url", "type", "institution")),
    "contributor_name", "contributor_role",
)
"""Global attributes of the ACDD that a user may give; others come from the table."""
# Longest recording, s.
LONGEST = 1e9


@dataclass(frozen=True)
class ReplayOptions:
    """Options of a replay: configuration, topics, part of the recording, outputs."""

    pipeline: PipelineConfig = field(default_factory=PipelineConfig)
    node: NodeConfig = field(default_factory=NodeConfig)
    wanted: Wanted = field(default_factory=Wanted)  # given topics
    sensor_type: str | None = None  # type of the depth sensor, if given
    # names of the parameters that the user gave; others have defaults
    told: tuple[str, ...] = ()
    infos: tuple[Any, Any] | None = None  # calibration instead of the recorded one
    # start, duration: seconds of the recording that are skipped, and that are replayed
    start: float = 0.0
    duration: float = math.inf
    # every, images: every Nth frame is processed, or written to ``images/``; 0 for none
    every: int = 1
    images: int = 0
    # video, geo, netcdf, parquet: whether ``video.mp4`` and ``frames`` in these formats are written
    video: bool = False
    geo: bool = False
    netcdf: bool = False
    parquet: bool = False
    all_topics: bool = False  # whether ``results.mcap`` has all topics of the Foxglove layout
    match_original: bool = False  # whether the raw pair is also matched, for comparison
    # latitude and longitude, in degrees, of the origin of an Odometry
    origin: tuple[float, float] | None = None
    joins: tuple[ScalarTopic, ...] = ()  # numbers of other topics that are joined to the frames
    join_tolerance: float = 2.0  # longest gap between their values for interpolation, s
    # fit that predicts the turbidity of a sensor from attenuation
    turbidity: LineFit | None = None
    # global attributes of ``frames.nc`` by name, of ACDD, that only a user knows
    attributes: Mapping[str, str] = field(default_factory=dict)
    # whether this is one of several recordings: missing topics to join are then reported, and the
    # result is written without them
    several: bool = False

    def __post_init__(self) -> None:
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
                "in degrees, not at the poles"
            )
        columns = [join.column for join in self.joins]
        twice = [str(join) for join in self.joins if columns.count(join.column) > 1]
        if twice:
            raise InputError(f"--join names {twice[0]} twice: once is enough")
        if self.attributes and not self.netcdf:
            raise InputError("--attribute is given without --netcdf: only frames.nc has attributes")
        unknown = [name for name in self.attributes if name not in ATTRIBUTES]
        if unknown:
            raise InputError(
                f"--attribute names {unknown[0]}: give one of {', '.join(ATTRIBUTES)}")

    def parameters(self) -> dict[str, Any]:
        """Return everything that affects results, as JSON values, for provenance."""
        values = {
            **{k: v for k, v in self.pipeline.to_parameters().items() if k != "threads"},
            **digests(self.pipeline),
            **flatten(self.node),
            "replay.start": self.start,
            "replay.duration": None if math.isinf(self.duration) else self.duration,
            "replay.every": self.every,
            "replay.calibration": None if self.infos is None else repr(self.infos),
            "replay.match_original": self.match_original,
            "replay.origin": self.origin,
            "replay.join": [
                f"{join}={join.unit}" if join.unit else str(join) for join in self.joins],
            "replay.join_tolerance": self.join_tolerance,
            "replay.turbidity": None if self.turbidity is None else asdict(self.turbidity),
            **{f"replay.{name}": topic for name, topic in asdict(self.wanted).items()},
        }
        return {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}

    def extras(self) -> dict[str, Any]:
        """Return the outputs in addition to table and messages, as JSON values."""
        names = ("images", "video", "geo", "netcdf", "parquet", "all_topics")
        return {name: getattr(self, name) for name in names} | {
            "attributes": dict(self.attributes)}

    def with_one_thread(self) -> ReplayOptions:
        """Return the options with one thread per frame, unless a number is given."""
        return replace(
            self, pipeline=replace(self.pipeline, threads=self.pipeline.threads or 1))


def without_lacking(
    reader: BagReader, options: ReplayOptions
) -> tuple[ReplayOptions, dict[str, str]]:
    """Return options without missing topics to join, and these with reasons."""
    lacks = dict(_lacks(reader, options))
    wanted = options.wanted
    if wanted.position in lacks:
        wanted = replace(wanted, position=None)
    # Without the named depth sensor, no other one is used.
    kind = "none" if wanted.depth in lacks else options.sensor_type
    joins = tuple(join for join in options.joins if str(join) not in lacks)
    return replace(options, joins=joins, wanted=wanted, sensor_type=kind), lacks


def check_in_any(bags: Iterable[Place], options: ReplayOptions) -> None:
    """Refuse a topic to join that no recording has, before any is replayed."""
    lacking: dict[str, str] | None = None
    for bag in bags:
        if lacking is not None and not lacking:
            return
        try:
            with recording_here(bag) as recording, BagReader(recording) as reader:
                found = dict(_lacks(reader, options))
        except InputError:
            continue
        before = found if lacking is None else lacking
        # Prefer a reason for an existing topic to a missing topic elsewhere.
        lacking = {
            name: why if name.partition(".")[0] in reader.channels else before[name]
            for name, why in found.items() if name in before}
    if lacking:
        name, why = next(iter(lacking.items()))
        raise InputError(f"no recording has {name}: {why}; --list shows what there is")


def _lacks(reader: BagReader, options: ReplayOptions) -> Iterator[tuple[str, str]]:
    """Yield each missing topic to join of a recording, with the reason."""
    channels, wanted = reader.channels, options.wanted
    checks: list[tuple[str, str, Callable[[], None]]] = [
        (str(join), join.topic, functools.partial(check_join, reader, join))
        for join in options.joins
    ]
    sensors = tuple(depth_types(options.sensor_type)) if options.sensor_type != "none" else ()
    checks += [
        (topic, topic, functools.partial(check_topic, channels, topic, types))
        for topic, types in ((wanted.position, POSITION_TYPES), (wanted.depth, sensors))
        if topic is not None and types
    ]
    for name, topic, check in checks:
        try:
            if topic in channels:
                check()
            else:
                yield name, f"there is no topic {topic} in the recording"
        except InputError as error:
            yield name, str(error)
