# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Topics to join that some of several recordings lack, and those that all of them lack."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from uw_visibility.errors import InputError
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.inputs.options import ReplayOptions
from uw_visibility.replay.inputs.scalars import check_join
from uw_visibility.replay.inputs.topics import POSITION_TYPES, check_topic, depth_types
from uw_visibility.replay.stores import Place, recording_here


def without_lacking(
    reader: BagReader, options: ReplayOptions
) -> tuple[ReplayOptions, dict[str, str]]:
    """Return options without the topics to join that a recording lacks.

    Returns
    -------
    ReplayOptions
    dict of str to str
        Why not, by what was to be joined: numbers, depth sensor, position.
    """
    lacks = dict(_lacks(reader, options))
    wanted = options.wanted
    if wanted.position in lacks:
        wanted = replace(wanted, position=None)
    # Another depth sensor than the one asked for is none.
    kind = "none" if wanted.depth in lacks else options.sensor_type
    joins = tuple(join for join in options.joins if str(join) not in lacks)
    return replace(options, joins=joins, wanted=wanted, sensor_type=kind), lacks


def check_in_any(bags: Iterable[Place], options: ReplayOptions) -> None:
    """Refuse a topic to join that none of the recordings has, before any of them is replayed.

    Parameters
    ----------
    bags : iterable of (Path or str)
        Recordings; one that cannot be read says so when it is its turn.
    options : ReplayOptions

    Raises
    ------
    InputError
        Naming it.
    """
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
        # Where the topic is there, what is wrong with it tells more than that it is missing.
        lacking = {
            name: why if name.partition(".")[0] in reader.channels else before[name]
            for name, why in found.items() if name in before}
    for name, why in (lacking or {}).items():
        raise InputError(f"no recording has {name}: {why}; --list shows what there is")


def _lacks(reader: BagReader, options: ReplayOptions) -> Iterator[tuple[str, str]]:
    for join in options.joins:
        try:
            if join.topic in reader.channels:
                check_join(reader, join)
            else:
                yield str(join), _missing(join.topic)
        except InputError as error:
            yield str(join), str(error)
    wanted = options.wanted
    depth = None if options.sensor_type == "none" else wanted.depth
    for topic, types in (
        (wanted.position, POSITION_TYPES), (depth, tuple(depth_types(options.sensor_type)))
    ):
        if topic is None:
            continue
        try:
            if topic in reader.channels:
                check_topic(reader.channels, topic, types)
            else:
                yield topic, _missing(topic)
        except InputError as error:
            yield topic, str(error)


def _missing(topic: str) -> str:
    return f"there is no topic {topic} in the recording"
