# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Options that several commands have: parameter file of the node, recordings."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from uw_visibility.compute.threads import number_of_threads
from uw_visibility.errors import InputError, naming, needing
from uw_visibility.replay.progress import say

if TYPE_CHECKING:
    from uw_visibility.replay.inputs.options import ReplayOptions
    from uw_visibility.replay.stores import Place

Made = TypeVar("Made")
# Most processes per processor: more only need memory.
MOST_JOBS = 8


def of_arguments(
    kind: Callable[..., Made], arguments: argparse.Namespace, **others: Any
) -> Made:
    """Make a dataclass from the arguments that are named like its fields, and from `others`."""
    given = {
        field.name: getattr(arguments, field.name) for field in fields(kind)  # type: ignore[arg-type]
        if field.name not in others and hasattr(arguments, field.name)
    }
    values = {
        name: tuple(value) if isinstance(value, list) else value for name, value in given.items()}
    return kind(**values, **others)


def add_camera_options(parser: argparse.ArgumentParser, known: str) -> None:
    """Add parameter file, transfer and calibration, which replaces what is `known` otherwise."""
    parser.add_argument(
        "--calibration", metavar="FILE", type=Path, action="append", default=[],
        help=f"JSON with P1 and P2, or two YAML files of CameraInfo, instead of {known}")
    parser.add_argument(
        "--params-file", metavar="YAML", type=Path,
        help="parameters, in the format of config/uw_visibility.yaml")
    parser.add_argument(
        "--transfer", choices=("linear", "srgb"),
        help="transfer from light to code values: linear, as in machine vision cameras, or srgb, "
        "as in most video and JPEG (parameter camera.transfer)")


def read_params_file(path: Path | None, transfer: str | None = None) -> dict[str, Any]:
    """Read and check a parameter file for `PipelineConfig` and `NodeConfig`.

    `transfer` is that of the command line, which overrides the file; this is told.
    """
    from uw_visibility.config.schema import NodeConfig, PipelineConfig, read_yaml

    values: dict[str, Any] = {} if path is None else read_yaml(path)
    if transfer is not None:
        stated = values.get("camera.transfer", transfer)
        if stated != transfer:
            say(f"--transfer {transfer} is used, not the {stated} of {path}", error=True)
        values["camera.transfer"] = transfer
    with naming(path):
        NodeConfig.from_parameters(values)
        PipelineConfig.from_parameters(values)
    return values


def named_place(text: str) -> Place:
    """Return the URL or path that an argument names."""
    from uw_visibility.replay.stores import place

    try:
        return place(text)
    except InputError as error:
        # For other errors argparse would show the argument, with credentials in the URL.
        raise argparse.ArgumentTypeError(str(error)) from None


def add_recording_options(parser: argparse.ArgumentParser) -> None:
    """Add the recordings and their options."""
    add = parser.add_argument
    add("bags", metavar="BAG", type=named_place, nargs="+", help="recording")
    add("--rectify", action="store_true", help="rectify raw images (parameter rectify); "
        "recordings that only have rectified images are used as they are")
    add_camera_options(parser, "the recorded ones")
    add("--left", metavar="TOPIC", help="left images")
    add("--right", metavar="TOPIC", help="right images")
    add("--left-info", metavar="TOPIC", help="CameraInfo of the left camera")
    add("--right-info", metavar="TOPIC", help="CameraInfo of the right camera")
    add("--depth-sensor", metavar="TOPIC", help="depth sensor")
    add("--start", metavar="S", type=float, default=0.0, help="skip the first S seconds")
    add("--duration", metavar="S", type=float, default=math.inf, help="replay S seconds")
    add("--every", metavar="N", type=int, default=1, help="process every Nth frame")
    add("--jobs", metavar="N", type=int, default=0, help="processes; 0 for one per processor")


def read_recording_options(arguments: argparse.Namespace, **others: Any) -> ReplayOptions:
    """Return the options of a replay from the arguments of the same names, and from `others`.

    Raises `InputError` if an option or a file that it names cannot be used.
    """
    from uw_visibility.commands.calibration_file import read_camera_infos
    from uw_visibility.config.schema import NodeConfig, PipelineConfig
    from uw_visibility.replay.inputs.options import ReplayOptions
    from uw_visibility.replay.inputs.topics import Wanted

    values = read_params_file(arguments.params_file, arguments.transfer)
    pipeline, node = PipelineConfig.from_parameters(values), NodeConfig.from_parameters(values)
    if arguments.rectify:
        node = replace(node, rectify=True)
    return of_arguments(
        ReplayOptions, arguments, pipeline=pipeline, node=node,
        wanted=of_arguments(Wanted, arguments, depth=arguments.depth_sensor),
        sensor_type=values.get("plausibility.sensor_type"), told=tuple(sorted(values)),
        infos=(
            read_camera_infos(arguments.calibration, rectify=node.rectify)
            if arguments.calibration else None),
        **others,
    )


@contextmanager
def reading(command: str) -> Iterator[None]:
    """Exit with code 1 and one sentence if a recording cannot be read."""
    with needing("report", command):
        from uw_visibility.replay.bags.reader import UnreadableError
    try:
        yield
    except UnreadableError as error:
        say(f"uw_visibility: {error}", error=True)
        raise SystemExit(1) from error


def jobs(arguments: argparse.Namespace) -> int:
    """Return the number of processes.

    Raises `InputError` if it is negative, or above `MOST_JOBS` per processor.
    """
    most = MOST_JOBS * number_of_threads(0)
    if not 0 <= arguments.jobs <= most:
        raise InputError(
            f"--jobs is {arguments.jobs}: give from 1 to {most} on this computer, or 0"
        )
    return number_of_threads(arguments.jobs)
