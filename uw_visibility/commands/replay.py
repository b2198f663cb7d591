# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`uw_visibility replay`: outputs of the node from recorded bags, without a ROS graph."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from uw_visibility.commands.options import (
    add_recording_options,
    jobs,
    named_place,
    read_recording_options,
    reading,
)
from uw_visibility.config.assumptions import assumptions
from uw_visibility.config.files import refuse_inputs
from uw_visibility.errors import InputError, refusing
from uw_visibility.replay.progress import say, tell

# Most numbers of a topic that --list shows.
MOST_LISTED = 6

if TYPE_CHECKING:
    from uw_visibility.replay.bags.reader import BagReader
    from uw_visibility.replay.inputs.options import ReplayOptions
    from uw_visibility.replay.results.summary import Summary
    from uw_visibility.replay.stores import Place

HELP = "outputs of the node from recorded bags"
DESCRIPTION = """\
Compute from recorded bags what the node would publish, with a table and a report.

A BAG is the folder of a ROS 2 bag (mcap or sqlite3, split, compressed), one of its
files, or a .bag of ROS 1. The stereo pair is found by type and name: left and right
in the names, and camera_info beside the images.

BAG and DIR may be URLs that fsspec supports (s3://bucket/dive_1, 's3://bucket/dive_*'):
bags are downloaded, processed here, and results uploaded (extra: stores)."""

EPILOG = """\
written to DIR (with several bags: to DIR/NAME for each, and for all together to DIR:
index.html, frames.csv and other requested tables, with a column for the recording):
  results.mcap     topics of the node; stamps as recorded, log times of the left images
  frames.csv       one row per frame: estimates with standard deviations, sensor, statuses.
                   Distances, ranges and depths in m (depths positive down),
                   attenuations in 1/m, light as part of the largest value, stamps in s
                   since 1970 (UTC) and as ISO 8601; frames.csv-metadata.json has units
                   and definitions of all columns, and all statuses (CSV on the Web)
  timings.csv      duration of each stage, ms
  report.html      verdict, time series, pictures, what was not assessable and why
  replay.json      counts, parameters, hash of the input
  images/, video.mp4, frames.geojson, frames.nc, frames.parquet   on request

Results are written to DIR.partial, which is renamed to DIR when complete. After an
interruption DIR.partial remains, and --resume continues it. Other files in DIR are never
removed, nor is a folder that contains an input.

frames.csv and the messages do not depend on --jobs, except under lamps: there a frame is
restored with the light found in earlier frames, of which several jobs leave out the last two
each. Each job uses one thread, unless the parameter threads is set.

exit code: 0 done, with a warning if a bag is damaged; 1 nothing in a bag can be read or no
frame of it has a result, one of several bags has no result or lacks a topic to join, or
an internal error; 2 unusable input or options; 130 interrupted"""


def add_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add_recording_options(parser)
    add("-o", "--output", metavar="DIR", type=named_place, help="folder for the results")
    add("--list", action="store_true", help="show the topics and which would be used, and exit")
    add("--force", action="store_true", help="replace a result, if its folder has no other files")
    add("--resume", action="store_true", help="continue a partial result")
    add(
        "--scheduler", metavar="ADDRESS",
        help="replay bags on a Dask cluster, one bag per task (extra: distributed)",
    )
    add(
        "--images", metavar="N", type=int, default=0,
        help="write every Nth frame's pictures side by side to images/",
    )
    add("--video", action="store_true", help="write video.mp4")
    add(
        "--match-original", action="store_true",
        help="also match the images as recorded, for comparison; takes about a third more time",
    )
    add(
        "--all-topics", action="store_true",
        help="write all topics of the Foxglove layout to results.mcap: depth image, points, "
        "diagnostics, and the left images and the depth sensor as recorded",
    )
    add("--netcdf", action="store_true", help="write frames.nc (CF trajectory; extra: netcdf)")
    add(
        "--attribute", metavar="NAME=TEXT", action="append", default=[],
        help="global attribute of frames.nc, such as institution, license, title, summary or "
        "creator_name (ACDD); may be repeated",
    )
    add("--parquet", action="store_true", help="write frames.parquet (extra: parquet)")
    add(
        "--join", metavar="TOPIC[.FIELD][=UNIT]", action="append", default=[],
        help="join a number of any topic by time: a column, and a fit over the beam attenuation in "
        "the report and in fit_TOPIC.json; UNIT in UDUNITS notation; may be repeated",
    )
    add(
        "--join-tolerance", metavar="S", type=float, default=2.0,
        help="longest gap between joined values to interpolate over (2)",
    )
    add(
        "--turbidity", metavar="FIT.json", type=Path,
        help="turbidity, FNU, by a fit to your own sensor, written with --join",
    )
    add(
        "--geo", metavar="TOPIC",
        help="join a NavSatFix or Odometry to the table and write frames.geojson",
    )
    add(
        "--origin", metavar=("LAT", "LON"), type=float, nargs=2,
        help="position of the origin of the Odometry of --geo, degrees (x east, y north)",
    )


def run(arguments: argparse.Namespace) -> None:
    with reading("replay"):
        from uw_visibility.replay.stores import expand

        options, bags = _options(arguments), expand(arguments.bags)
        if arguments.list:
            _list_all(bags, options)
            return
        targets = _targets(bags, arguments.output)
        from uw_visibility.replay.day import check_day, write_day
        from uw_visibility.replay.report.sentences import definition
        from uw_visibility.replay.results.folder import partial_of, places_of

        refuse_inputs(
            [*targets, arguments.params_file, *arguments.calibration, arguments.turbidity],
            [place for target in targets.values()
             for place in ([target] if isinstance(target, str) else places_of(target))])
        again = arguments.force or arguments.resume
        if len(targets) > 1:
            check_day(arguments.output, again=again)
        try:
            summaries = _replay(arguments, options, targets)
        except KeyboardInterrupt:
            for target in targets.values():
                if isinstance(target, Path) and partial_of(target).exists():
                    say(f"{partial_of(target)}: --resume continues it", error=True)
            raise
        if len(targets) > 1:
            write_day(arguments.output, summaries, options, again=again)
    for summary in summaries:
        _tell(summary)
    told = [s.synopsis for s in summaries if s.synopsis is not None and s.synopsis.told]
    if told:
        say(definition(told[0].contrast))
    if len(targets) > 1:
        say(f"{arguments.output}: index.html and frames.csv cover all recordings")
    if any(summary.lacks or summary.frames == summary.failed for summary in summaries):
        raise SystemExit(1)


def _options(arguments: argparse.Namespace) -> ReplayOptions:
    if arguments.origin is not None and arguments.geo is None:
        raise InputError("--origin is given without --geo: name the Odometry with --geo")
    from uw_visibility.replay.inputs.sensors import ScalarTopic
    from uw_visibility.replay.line_fit import LineFit

    options = read_recording_options(
        arguments, geo=arguments.geo is not None,
        joins=tuple(ScalarTopic.parse(text) for text in arguments.join),
        attributes=dict(map(_attribute, arguments.attribute)),
        turbidity=None if arguments.turbidity is None else LineFit.read(arguments.turbidity),
    )
    node = options.node
    if arguments.all_topics:
        node = replace(node, publish_depth_image=True, publish_points=True)
    return replace(
        options, node=node, wanted=replace(options.wanted, position=arguments.geo))


def _attribute(text: str) -> tuple[str, str]:
    name, _, value = text.partition("=")
    if not value.strip():
        raise InputError(f"--attribute is {text!r}: give a name and a text, as license=CC-BY-4.0")
    return name, value


def _replay(
    arguments: argparse.Namespace, options: ReplayOptions, targets: dict[Place, Place]
) -> list[Summary]:
    flags = {"force": arguments.force, "resume": arguments.resume}
    options = options.with_one_thread()
    if arguments.scheduler is not None:
        from uw_visibility.replay.cluster import replay_on_cluster

        return replay_on_cluster(arguments.scheduler, targets, options, **flags)
    from uw_visibility.replay.batch import replay_bags

    tell("preparing; the first run compiles, for a minute or two")
    return replay_bags(targets, options, jobs=jobs(arguments), **flags)


def _targets(bags: list[Place], output: Place | None) -> dict[Place, Place]:
    """Return the folder of each bag's result."""
    from uw_visibility.replay.results.folder import check_names
    from uw_visibility.replay.stores import child, recording_name

    if output is None:
        raise InputError("-o is missing: name the folder for the results, or give --list")
    if len(bags) == 1:
        return {bags[0]: output}
    names = [recording_name(bag) for bag in bags]
    check_names(names)
    if isinstance(output, Path):
        with refusing(f"cannot make folder {output}"):
            output.mkdir(parents=True, exist_ok=True)
    return {bag: child(output, name) for bag, name in zip(bags, names, strict=True)}


def _list_all(bags: list[Place], options: ReplayOptions) -> None:
    """Show the topics of recordings; one that cannot be read does not stop the others."""
    from uw_visibility.replay.bags.reader import UnreadableError
    from uw_visibility.replay.stores import recording_here

    unread = 0
    options = replace(options, several=len(bags) > 1)
    for bag in bags:
        try:
            with recording_here(bag) as recording:
                _list(recording, options, bag)
        except UnreadableError as error:
            say(f"uw_visibility: {error}", error=True)
            unread += 1
    say(assumptions(options.parameters(), options.told))
    if unread:
        raise SystemExit(1)


def _list(bag: Path, options: ReplayOptions, source: Place) -> None:
    from uw_visibility.replay.bags.reader import BagReader
    from uw_visibility.replay.inputs.options import without_lacking
    from uw_visibility.replay.inputs.topics import find_topics, is_raw
    from uw_visibility.replay.report.sentences import amount

    with BagReader(bag) as reader:
        span = reader.span
        length = "" if span is None else f", {(span[1] - span[0]) / 1e9:.1f} s"
        kind = "ROS 1" if reader.ros1 else "ROS 2"
        say(f"{source}: {kind}, {amount(len(reader.files), 'file')}{length}")
        for note in reader.damage:
            say(f"  damaged: {note}")
        width = max(len(topic) for topic in reader.channels)
        for topic, channel in sorted(reader.channels.items()):
            count = "?" if channel.count is None else str(channel.count)
            say(f"  {topic:{width}}  {count:>7}  {channel.type}")
        lacks: dict[str, str] = {}
        if options.several:
            options, lacks = without_lacking(reader, options)
        try:
            used = find_topics(
                reader.channels, options.wanted, rectify=options.node.rectify,
                calibrated=options.infos is not None, sensor_type=options.sensor_type,
            )
        except InputError as error:
            say(f"would be used: nothing, {error}")
            return
        say("would be used:")
        for name, used_topic in used.by_use().items():
            given = name.endswith("info") and options.infos is not None
            shown = "as --calibration says" if given else used_topic or "none"
            say(f"  {name.replace('_', ' '):{width}}  {shown}")
        for note in [*used.notes, *lacks.values()]:
            say(f"  {note}")
        if not options.node.rectify and is_raw(used.left):
            say(f"  {used.left} is raw by its name: add --rectify")
        taken = {*used.images(), *used.infos(), used.depth}
        _list_joinable(reader, [topic for topic in sorted(reader.channels) if topic not in taken])


def _list_joinable(reader: BagReader, topics: list[str]) -> None:
    """Name the topics that --geo and --join can take."""
    from uw_visibility.replay.inputs.sensors import numbers_of
    from uw_visibility.replay.inputs.topics import ODOMETRY, POSITION_TYPES

    positions, scalars = [], []
    for topic in topics:
        kind = reader.channels[topic].type
        if kind in POSITION_TYPES:
            positions.append(f"{topic} --origin LAT LON" if kind == ODOMETRY else topic)
        names = numbers_of(reader, topic)
        more = f", and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else ""
        if names:
            scalars.append(
                f"{topic} (.{', .'.join(names[:MOST_LISTED])}{more})" if len(names) > 1 else topic)
    for title, found in (("--geo", positions), ("--join", scalars)):
        if found:
            say(f"could be joined with {title}:")
        for each in found:
            say(f"  {each}")


def _tell(summary: Summary) -> None:
    from uw_visibility.replay.report.sentences import amount, verdict
    from uw_visibility.replay.results.summary import WHOLE_FRAME

    if summary.error:
        named = "" if summary.bag in summary.error else f"{summary.bag}: "
        say(f"uw_visibility: {named}{summary.error}", error=True)
        return
    sentences = ["".join(map(str, parts)) for parts in verdict(summary)]
    for place, sentence in enumerate(sentences):
        say(f"  {sentence}" if place else f"{summary.bag}: {sentence}")
    rate = summary.frames / summary.seconds if summary.seconds else 0.0
    again = f", {summary.resumed} of them from before" if summary.resumed else ""
    took = f", {summary.seconds:.1f} s ({rate:.1f} frames/s)" if summary.seconds else ""
    say(
        f"  {amount(summary.frames, 'frame')}{again}, water assessed in {summary.assessed}"
        f"{took}; written to {summary.output}"
    )
    for note in summary.notes:
        say(f"  {note}")
    for refusal in summary.refusals:
        what = f"not assessable: {refusal.what}: {refusal.why}"
        if refusal.what == WHOLE_FRAME:
            what = f"unusable frame: {refusal.why}"
        frames = "frame" if refusal.count == 1 else "frames"
        say(f"  {what} ({refusal.count}), {frames} {refusal.frames}")
    for reason, count in summary.dropped.most_common():
        say(f"  dropped: {reason} ({count})")
    for note in summary.lacks:
        say(f"uw_visibility: {summary.bag}: {note}", error=True)
    for note in summary.damage:
        say(f"uw_visibility: warning: {summary.bag}: {note}", error=True)
