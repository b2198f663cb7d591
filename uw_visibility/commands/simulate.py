# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`uw_visibility simulate`: an underwater stereo transect as a bag, with its truth."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from uw_visibility.commands.progress import say
from uw_visibility.errors import InputError, check_range

if TYPE_CHECKING:
    from uw_visibility.simulation.camera import Sensor
    from uw_visibility.simulation.lamps import Lighting
    from uw_visibility.simulation.water import WaterEffects

Made = TypeVar("Made")

MOST_THREADS = 64

HELP = "an underwater stereo transect with its ground truth"
DESCRIPTION = """\
Render a stereo camera that swims over a reef while depth and turbidity change, and
record it as a rosbag2 (mcap): images, calibration and a depth sensor as a vehicle
has them, a transmissometer (/transmissometer, beam attenuation of the green channel, 1/m,
with a noise of 2 %), and the truth about water, depth and disparity under /ground_truth.
The same options give the same recording.

The water is the paper's: clear water and grey particles, one light on the scene and in
the water. Options under "water", "disturbances" and "camera" depart from it, each by
itself or together, so that every way in which an estimate fails can be made.

With --lamps or --lamp-positions the vehicle carries lamps, at night unless --daylight is
given. Exposure is one for all frames then."""

EPILOG = """\
truth in the recording:
  /ground_truth/attenuation       β. With a water type, a layer or a plume the effective
                                  one: its e^(−βd) fits the transmission over the ranges
                                  in view best
  /ground_truth/ambient_light     what open water is seen as: the veil B
  /ground_truth/scene_light       what lights the scene: W; the same without --veil
  /ground_truth/mean_attenuation  mean of β less clear water's
  /ground_truth/visibility        where contrast falls to 0.05 in the clearest channel, m
  /ground_truth/depth, /ground_truth/disparity
Light is given as the left image shows it, with its white balance, before its curve.
--range-scale falsifies the recorded CameraInfo alone.

with lamps also:
  /ground_truth/lamps             a row for each lamp that fired: position (m, left camera:
                                  x right, y down, z forward), axis, beam (degrees), power
                                  (irradiance of white 1 m in front of it, in the image)
  /ground_truth/reflectance       of the surfaces, without light and shade; open water is 0
  BAG/lighting.yaml               the lamps as parameters, for --params-file
Ambient and scene light are daylight's alone: 0 at night."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the sub-command."""
    parser.add_argument(
        "-o", "--output", metavar="BAG", type=Path, required=True, help="folder of the new bag"
    )
    parser.add_argument("--force", action="store_true", help="replace a bag of that name")
    add = parser.add_argument
    add("--frames", metavar="N", type=int, default=60, help="stereo frames (%(default)s)")
    add("--rate", metavar="HZ", type=float, default=2.0, help="frames per second (%(default)s)")
    add("--width", metavar="PX", type=int, default=640, help="width of an image (%(default)s)")
    add("--height", metavar="PX", type=int, default=480, help="height of an image (%(default)s)")
    add(
        "--focal-length", metavar="PX", type=float,
        help="focal length (default: 15/16 of the width)",
    )
    add(
        "--baseline", metavar="M", type=float, default=0.12,
        help="distance of the cameras (%(default)s)",
    )
    add("--seed", metavar="N", type=int, default=0, help="seed of reef and noise (%(default)s)")
    add(
        "--depth", metavar=("A", "B"), type=float, nargs=2, default=(2.0, 6.0),
        help="depth at start and end, m (2 6)",
    )
    add(
        "--attenuation", metavar=("A", "B"), type=float, nargs=2, default=(0.05, 0.3),
        help="mean attenuation at start and end, 1/m (0.05 0.3)",
    )
    add(
        "--altitude", metavar="M", type=float, nargs="+", default=[1.5],
        help="height over the floor, or two between which the camera rises and sinks, m (1.5)",
    )
    add(
        "--downward", action="store_true", help="look straight down, as in a survey of the floor")
    add("--speed", metavar="M/S", type=float, default=0.4, help="over ground (%(default)s)")
    add(
        "--exposure", metavar="GAIN", type=float,
        help="fixed exposure, where white at the surface comes to GAIN (default: automatic)",
    )
    add(
        "--depth-stddev", metavar="M", type=float, default=0.05,
        help="noise of the depth sensor (%(default)s)",
    )
    add(
        "--position", metavar=("LAT", "LON"), type=float, nargs=2,
        help="record positions too, /gps/fix: from here on to the east",
    )
    add("--threads", metavar="N", type=int, default=0, help="threads; 0 takes one per processor")
    _add_lamps(parser)
    _add_water(parser)
    _add_disturbances(parser)
    _add_camera(parser)


def _add_lamps(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("lamps")
    add = group.add_argument
    add("--lamps", metavar="N", type=int, help="1, 2 or 4 lamps where vehicles carry them")
    add(
        "--lamp-positions", metavar="M", type=float, nargs="+",
        help="x y z of each lamp instead, from the left camera: right, down, forward",
    )
    add(
        "--lamp-directions", metavar="X", type=float, nargs="+",
        help="x y z of each lamp's axis (default: ahead, or the rig's)",
    )
    add(
        "--lamp-beam", metavar="DEG", type=float,
        help="full angle of the beams at half power; 0 for all directions (90)",
    )
    add(
        "--lamp-power", metavar="X", type=float, nargs="+", default=[1.0],
        help="irradiance of white 1 m in front of a lamp, where daylight's is 1 at the "
        "surface; one, or R G B (1)",
    )
    light = group.add_mutually_exclusive_group()
    light.add_argument("--night", action="store_true", help="lamps alone, the default with lamps")
    light.add_argument("--daylight", action="store_true", help="daylight beside the lamps")
    add(
        "--strobe", choices=("steady", "alternate"), default="steady",
        help="alternate: lamps fire with every second frame (%(default)s)",
    )
    add(
        "--lamp-jitter", metavar="SHARE", type=float, default=0.0,
        help="change of each lamp's power from frame to frame, standard deviation (0)",
    )
    add(
        "--scattering-albedo", metavar=("R", "G", "B"), type=float, nargs=3,
        default=(0.6, 0.75, 0.8), help="share of scattering in attenuation (0.6 0.75 0.8)",
    )
    add(
        "--phase-function", metavar="NAME", default="henyey-greenstein",
        help="henyey-greenstein or fournier-forand (%(default)s)",
    )
    add(
        "--no-shading", action="store_true",
        help="every surface faces every lamp, as in the paper's model (default: Lambertian)",
    )


def _add_water(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument_group("water").add_argument
    add(
        "--veil", metavar="RATIO", type=float, nargs="+", default=[1.0],
        help="veil B over light W on the scene, one ratio or R G B (1)",
    )
    add(
        "--water-type", metavar="TYPE",
        help="integrate over wavelength: clear, or Jerlov's IB, II, III, 1C, 3C, 5C; grey "
        "particles of --attenuation come on top (default: one β per channel)",
    )
    add(
        "--cdom", metavar="A", type=float, default=0.0,
        help="dissolved organic matter, absorption at 440 nm, 1/m; with --water-type (0)",
    )
    add(
        "--particle-slope", metavar="G", type=float, default=0.0,
        help="colour of particles: exponent of (550 nm/λ); with --water-type (0)",
    )
    add(
        "--channel-attenuation", metavar=("R", "G", "B"), type=float, nargs=3,
        default=(0.0, 0.0, 0.0), help="attenuation beyond that of grey particles, 1/m (0 0 0)",
    )
    add(
        "--blur", metavar="PX/M", type=float, default=0.0,
        help="forward scattering: standard deviation of a point's image per m of range (0)",
    )
    add(
        "--layer", metavar=("A", "H"), type=float, nargs=2, default=(0.0, 0.0),
        help="grey particles below height H over the sea floor, m, add A 1/m",
    )
    add(
        "--plume", metavar=("A", "SHARE"), type=float, nargs=2, default=(0.0, 0.5),
        help="grey particles in a share of the view, at the right, add A 1/m",
    )
    add(
        "--veil-gradient", metavar="G", type=float, default=0.0,
        help="relative change of the veil from bottom to top of the image (0)",
    )
    add(
        "--light-gradient", metavar="G", type=float, default=0.0,
        help="relative change of the light on the scene from left to right (0)",
    )


def _add_disturbances(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument_group("disturbances").add_argument
    add(
        "--marine-snow", metavar="SHARE", type=float, default=0.0,
        help="share of the pixels that particles cover, 0 .. 0.5 (%(default)s)",
    )
    add(
        "--snow-brightness", metavar="X", type=float, default=1.0,
        help="how bright these are, where open water is 1 (%(default)s)",
    )
    add(
        "--caustics", metavar="SHARE", type=float, default=0.0,
        help="change of light by waves, 0 .. 1 (%(default)s)",
    )


def _add_camera(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument_group("camera").add_argument
    noise = parser.add_argument_group("noise of the sensor").add_argument
    noise("--noiseless", action="store_true", help="quantisation only, no noise of the sensor")
    noise(
        "--noise-codes", metavar="N", type=float,
        help="Gaussian noise of N codes of 255 instead of shot and read noise",
    )
    noise(
        "--full-well", metavar="E", type=float, default=15000.0,
        help="electrons of a saturated pixel: shot noise (%(default)g)",
    )
    noise(
        "--read-noise", metavar="E", type=float, default=20.0,
        help="read noise, electrons (%(default)g)",
    )
    add(
        "--transfer", choices=("linear", "srgb"), default="linear",
        help="how code values follow light (%(default)s)",
    )
    add(
        "--white-balance", metavar=("R", "G", "B"), type=float, nargs=3,
        default=(1.0, 1.0, 1.0), help="gains (1 1 1)",
    )
    add(
        "--automatic-white-balance", action="store_true",
        help="each frame's channels are made equal on average",
    )
    add(
        "--vignetting", metavar="SHARE", type=float, default=0.0,
        help="light that is lost in the corners, 0 .. 1 (%(default)s)",
    )
    add(
        "--exposure-difference", metavar="X", type=float, default=0.0,
        help="relative difference of the right image's exposure (%(default)s)",
    )
    add("--bayer", action="store_true", help="a mosaic of colour filters (RGGB), interpolated")
    add(
        "--jpeg", metavar="QUALITY", type=int, default=0,
        help="compress and decompress, 1 .. 100 (default: not)",
    )
    add(
        "--range-scale", metavar="X", type=float, default=1.0,
        help="wrong calibration: the recorded baseline is X times the true one (%(default)s)",
    )


def run(arguments: argparse.Namespace) -> None:
    """Run the sub-command.

    Raises
    ------
    InputError
        If an option cannot be used or the bag exists already.
    """
    from uw_visibility.commands.progress import progress_bar
    from uw_visibility.compute.threads import Workers
    from uw_visibility.simulation.bag import write_transect
    from uw_visibility.simulation.camera import StereoCamera
    from uw_visibility.simulation.camera_effects import CameraEffects
    from uw_visibility.simulation.frame import Effects
    from uw_visibility.simulation.transect import Transect

    check_range("--threads", arguments.threads, 0, MOST_THREADS)
    focal_length = arguments.focal_length
    if focal_length is None:
        focal_length = arguments.width * 15 / 16
    transect = _of_arguments(
        Transect, arguments,
        altitude=_altitude(arguments.altitude),
        tilt=90.0 if arguments.downward else Transect.tilt,
        camera=_of_arguments(StereoCamera, arguments, focal_length=focal_length),
        sensor=_sensor(arguments),
        effects=_of_arguments(Effects, arguments),
        workers=Workers(arguments.threads),
        camera_effects=_of_arguments(CameraEffects, arguments),
        water_effects=_water_effects(arguments),
        lighting=_lighting(arguments),
    )
    write_transect(
        arguments.output,
        transect,
        depth_stddev=arguments.depth_stddev,
        range_scale=arguments.range_scale,
        position=None if arguments.position is None else tuple(arguments.position),
        overwrite=arguments.force,
        progress=lambda frames: progress_bar(frames, "simulate", transect.frames),
    )
    say(f"{arguments.output}: {transect.frames} stereo frames at {transect.rate:g} Hz")


def _of_arguments(
    kind: Callable[..., Made], arguments: argparse.Namespace, **others: Any
) -> Made:
    """Make a dataclass of the arguments that are named as its fields, and of others."""
    given = {
        field.name: getattr(arguments, field.name) for field in fields(kind)  # type: ignore[arg-type]
        if field.name not in others and hasattr(arguments, field.name)
    }
    values = {
        name: tuple(value) if isinstance(value, list) else value for name, value in given.items()}
    return kind(**values, **others)


def _altitude(heights: list[float]) -> tuple[float, float]:
    if len(heights) > 2:
        raise InputError(f"--altitude has {len(heights)} values: give one, or two")
    return heights[0], heights[-1]


def _lighting(arguments: argparse.Namespace) -> Lighting:
    from uw_visibility.simulation.lamps import BEAM, Lamp, Lighting, default_rig

    power = arguments.lamp_power
    if len(power) not in (1, 3):
        raise InputError(f"--lamp-power has {len(power)} values: give one, or three for R, G, B")
    colour = tuple(power * (3 // len(power)))
    beam = BEAM if arguments.lamp_beam is None else arguments.lamp_beam
    positions = _triples("--lamp-positions", arguments.lamp_positions)
    axes = _triples("--lamp-directions", arguments.lamp_directions)
    if positions and arguments.lamps is not None:
        raise InputError("--lamps and --lamp-positions both place lamps: give one of them")
    lamps: tuple[Lamp, ...] = ()
    if positions:
        lamps = tuple(Lamp(place, beam_angle=beam, power=colour) for place in positions)
    elif arguments.lamps is not None:
        lamps = default_rig(arguments.lamps, beam, colour)
    if axes and len(axes) != len(lamps):
        raise InputError(
            f"--lamp-directions has {len(axes)} axes for {len(lamps)} lamps: give one each")
    if axes:
        lamps = tuple(replace(lamp, direction=axis) for lamp, axis in zip(lamps, axes, strict=True))
    if arguments.night and not lamps:
        raise InputError("--night has no light without lamps: give --lamps 2, say")
    return _of_arguments(
        Lighting, arguments, lamps=lamps, daylight=arguments.daylight or not lamps,
        shaded=not arguments.no_shading, jitter=arguments.lamp_jitter,
    )


def _triples(option: str, values: list[float] | None) -> list[tuple[float, float, float]]:
    if values is None:
        return []
    if len(values) % 3:
        raise InputError(f"{option} has {len(values)} values: give x y z for each lamp")
    return [(values[k], values[k + 1], values[k + 2]) for k in range(0, len(values), 3)]


def _sensor(arguments: argparse.Namespace) -> Sensor:
    from uw_visibility.simulation.camera import NOISELESS, Sensor

    if arguments.noiseless:
        return NOISELESS
    if arguments.noise_codes is not None:
        return Sensor.gaussian(arguments.noise_codes)
    return _of_arguments(Sensor, arguments)


def _water_effects(arguments: argparse.Namespace) -> WaterEffects:
    from uw_visibility.simulation.water import WaterEffects

    veil = tuple(arguments.veil)
    if len(veil) not in (1, 3):
        raise InputError(f"--veil has {len(veil)} values: give one ratio, or three for R, G, B")
    (layer, layer_height), (plume, plume_share) = arguments.layer, arguments.plume
    return _of_arguments(
        WaterEffects, arguments, veil=veil * (3 // len(veil)),
        layer=layer, layer_height=layer_height, plume=plume, plume_share=plume_share,
    )
