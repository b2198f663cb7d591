# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Topics to join that some of several recordings lack, and those that all of them lack."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Iterator
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
    if lacking:
        name, why = next(iter(lacking.items()))
        raise InputError(f"no recording has {name}: {why}; --list shows what there is")


def _lacks(reader: BagReader, options: ReplayOptions) -> Iterator[tuple[str, str]]:
    """Yield what a recording lacks of what is to be joined, and why."""
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
