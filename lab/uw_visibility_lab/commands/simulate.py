# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`uw_visibility simulate`: an underwater stereo transect as a bag, with ground truth."""

from __future__ import annotations

import argparse
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uw_visibility.commands.options import of_arguments
from uw_visibility.errors import InputError, check_range
from uw_visibility.replay.progress import say
from uw_visibility_lab.commands.described import REQUIRED, Options, add_described

if TYPE_CHECKING:
    from uw_visibility_lab.simulation.camera import Sensor
    from uw_visibility_lab.simulation.lamps import Lighting
    from uw_visibility_lab.simulation.water import WaterEffects

MOST_THREADS = 64


def _stamp(text: str) -> int:
    """Return a time as ns since 1970 (UTC)."""
    try:
        time = datetime.fromisoformat(text)
        seconds = time.replace(tzinfo=time.tzinfo or UTC).timestamp()
    except (ValueError, OverflowError) as error:
        raise argparse.ArgumentTypeError(
            f"{text} is not a time: give one such as 2024-05-01T12:00:00Z") from error
    # A ROS stamp has 31 bits of seconds.
    if not 0 <= seconds < 1 << 31:
        raise argparse.ArgumentTypeError(f"{text} is out of range: give a time from 1970 to 2037")
    return round(seconds * 1e6) * 1000


HELP = "an underwater stereo transect with its ground truth"
DESCRIPTION = """\
Render the images of a stereo camera that moves over a reef while depth and turbidity
change, and record them as a rosbag2 (mcap), with the calibration, a depth sensor, a
transmissometer (/transmissometer, beam attenuation, 1/m: twice the attenuation that the
green channel sees, with a noise of 2 %), and the truth about water, depth and disparity
under /ground_truth. The same options give the same recording.

By default the water is that of the paper: clear water and grey particles, with the same
light on the scene and in the water. Options under "water", "disturbances" and "camera"
are departures from it, alone or together, to test when estimates fail.

With --lamps or --lamp-positions the vehicle carries lamps, at night unless --daylight is
given. All frames then have the same exposure."""

EPILOG = """\
truth in the recording:
  /ground_truth/attenuation       β. With a water type, a layer or a plume the effective
                                  one: its e^(−βd) fits the transmission over the ranges
                                  in view best
  /ground_truth/ambient_light     colour of open water: the veil B
  /ground_truth/scene_light       light on the scene, W; equal to B without --veil
  /ground_truth/mean_attenuation  mean of β minus that of clear water
  /ground_truth/visibility        distance at which contrast is 0.05, clearest channel, m
  /ground_truth/depth, /ground_truth/disparity
Light is in units of the left image: with white balance, before the transfer curve.
--range-scale changes the recorded CameraInfo only.

with lamps also:
  /ground_truth/lamps             a row for each lamp that fired: position (m, left camera:
                                  x right, y down, z forward), axis, beam (degrees), power
                                  (irradiance of white 1 m in front of it, in the image)
  /ground_truth/reflectance       of the surfaces, without light and shade; open water is 0
  BAG/lighting.yaml               the lamps as parameters, for --params-file
Ambient and scene light are those of daylight: 0 at night."""


OF_LAMPS: dict[str, tuple[Any, ...]] = {
    "--lamps N": (None, "1, 2 or 4 lamps at usual places on a vehicle", int),
    "--lamp-positions M ...": (
        None, "x y z of each lamp instead, from the left camera: right, down, forward"),
    "--lamp-directions X ...": (
        None, "x y z of each lamp's axis (default: ahead, or the rig's)"),
    "--lamp-beam DEG": (
        None, "full angle of the beams at half power; 0 for all directions (90)"),
    "--lamp-power X ...": (
        [1.0], "irradiance of white 1 m in front of a lamp, relative to daylight's at the "
        "surface; one, or R G B"),
    "--night": (False, "lamps without daylight, the default with lamps"),
    "--daylight": (False, "daylight in addition to lamps"),
    "--strobe {steady,alternate}": (
        "steady", "alternate: lamps fire in every second frame"),
    "--lamp-jitter SHARE": (
        0.0, "relative standard deviation of each lamp's power from frame to frame"),
    "--scattering-albedo R G B": (
        (0.6, 0.75, 0.8), "share of scattering in attenuation"),
    "--phase-function NAME": (
        "henyey-greenstein", "henyey-greenstein or fournier-forand"),
    "--no-shading": (
        False, "every surface faces every lamp, as in the paper's model (default: Lambertian)"),
}

OPTIONS: Options = {
    "-o --output BAG": (REQUIRED, "folder of the new bag", Path),
    "--force": (False, "replace a simulated bag of that name"),
    "--frames N": (60, "stereo frames"),
    "--rate HZ": (2.0, "frames per second"),
    "--width PX": (640, "width of an image"),
    "--height PX": (480, "height of an image"),
    "--focal-length PX": (None, "focal length (default: 15/16 of the width)"),
    "--baseline M": (0.12, "distance of the cameras"),
    "--start TIME": (
        "2023-11-14T22:13:20Z", "time of the first frame, ISO 8601, UTC by default", _stamp),
    "--seed N": (0, "seed of reef and noise"),
    "--depth A B": ((2.0, 6.0), "depth at start and end, m"),
    "--attenuation A B": ((0.05, 0.3), "mean attenuation at start and end, 1/m"),
    "--altitude M ...": (
        [1.5], "height over the floor, or two between which the camera rises and sinks, m"),
    "--downward": (False, "look straight down, as in a survey of the floor"),
    "--speed M/S": (0.4, "speed over ground"),
    "--exposure GAIN": (
        None, "fixed exposure: irradiance of white at the surface (default: automatic)"),
    "--depth-stddev M": (0.05, "noise of the depth sensor"),
    "--threads N": (0, "threads; 0: one per processor"),
    "lamps": OF_LAMPS,
    "water": {
        "--veil RATIO ...": ([1.0], "veil B over light W on the scene, one ratio or R G B"),
        "--water-type TYPE": (
            None, "integrate over wavelength: clear, or Jerlov's IB, II, III, 1C, 3C, 5C; grey "
            "particles of --attenuation are added (default: one β per channel)", str),
        "--blur PX/M": (
            0.0, "forward scattering: standard deviation of a point's image per m of range"),
        "--layer A H": (
            (0.0, 1.0), "grey particles below height H over the sea floor, m, add A 1/m "
            "(default: none)"),
        "--plume A SHARE": (
            (0.0, 0.5), "grey particles in a share of the view, at the right, add A 1/m "
            "(default: none)"),
        "--veil-gradient G": (
            0.0, "relative change of the veil from bottom to top of the image"),
    },
    "disturbances": {
        "--marine-snow SHARE": (0.0, "share of the pixels that particles cover, 0 .. 0.5"),
        "--snow-brightness X": (1.0, "their brightness, relative to open water"),
        "--caustics SHARE": (0.0, "change of light by waves, 0 .. 1"),
    },
    "camera": {
        "--transfer {linear,srgb}": ("linear", "transfer function from light to code values"),
        "--white-balance R G B": ((1.0, 1.0, 1.0), "gains"),
        "--automatic-white-balance": (False, "equalise the channels' means in each frame"),
        "--vignetting SHARE": (0.0, "share of light that is lost in the corners, 0 .. 1"),
        "--bayer": (False, "a mosaic of colour filters (RGGB), interpolated"),
        "--jpeg QUALITY": (0, "JPEG compression, 1 .. 100 (default: none)"),
        "--range-scale X": (
            1.0, "wrong calibration: the recorded baseline is X times the true one"),
    },
    "noise of the sensor": {
        "--noiseless": (False, "quantisation only, no noise of the sensor"),
        "--noise-codes N": (
            None, "Gaussian noise of N codes of 255 instead of shot and read noise"),
    },
}


def add_options(parser: argparse.ArgumentParser) -> None:
    add_described(parser, OPTIONS)


def run(arguments: argparse.Namespace) -> None:
    from uw_visibility.compute.threads import Workers
    from uw_visibility.images.pair import MIN_HEIGHT, MIN_WIDTH
    from uw_visibility.replay.progress import progress_bar
    from uw_visibility_lab.simulation.bag import write_transect
    from uw_visibility_lab.simulation.camera import LARGEST_SIDE, CameraEffects, StereoCamera
    from uw_visibility_lab.simulation.frame import Effects
    from uw_visibility_lab.simulation.transect import Transect

    check_range("--threads", arguments.threads, 0, MOST_THREADS)
    # No command takes smaller images.
    check_range("--width", arguments.width, MIN_WIDTH, LARGEST_SIDE, "px")
    check_range("--height", arguments.height, MIN_HEIGHT, LARGEST_SIDE, "px")
    if len(arguments.altitude) > 2:
        raise InputError(f"--altitude has {len(arguments.altitude)} values: give one, or two")
    focal_length = arguments.focal_length
    if focal_length is None:
        focal_length = arguments.width * 15 / 16
    transect = of_arguments(
        Transect, arguments,
        altitude=(arguments.altitude[0], arguments.altitude[-1]),
        tilt=90.0 if arguments.downward else Transect.tilt,
        camera=of_arguments(StereoCamera, arguments, focal_length=focal_length),
        sensor=_sensor(arguments),
        effects=of_arguments(Effects, arguments),
        camera_effects=of_arguments(CameraEffects, arguments),
        water_effects=_water_effects(arguments),
        lighting=_lighting(arguments),
    )
    write_transect(
        arguments.output,
        transect,
        start=arguments.start,
        depth_stddev=arguments.depth_stddev,
        range_scale=arguments.range_scale,
        overwrite=arguments.force,
        workers=Workers(arguments.threads),
        progress=lambda frames: progress_bar(frames, "simulate", transect.frames),
    )
    say(f"{arguments.output}: {transect.frames} stereo frames at {transect.rate:g} Hz")


def _lighting(arguments: argparse.Namespace) -> Lighting:
    from uw_visibility_lab.simulation.lamps import BEAM, Lamp, Lighting, default_rig

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
    if arguments.night and arguments.daylight:
        raise InputError("--night and --daylight exclude each other: give one of them")
    if arguments.night and not lamps:
        raise InputError("--night has no light without lamps: give some, as in --lamps 2")
    if not lamps:
        _refuse_ignored(arguments)
    return of_arguments(
        Lighting, arguments, lamps=lamps, daylight=arguments.daylight or not lamps,
        shaded=not arguments.no_shading, jitter=arguments.lamp_jitter,
    )


def _refuse_ignored(arguments: argparse.Namespace) -> None:
    """Refuse options of lamps, but for --daylight, which is what there is without them."""
    for option, (default, *_) in OF_LAMPS.items():
        name = option.split()[0]
        given = getattr(arguments, name.removeprefix("--").replace("-", "_"))
        if given != default and name != "--daylight":
            raise InputError(f"{name} changes nothing without lamps: give some, as in --lamps 2")


def _triples(option: str, values: list[float] | None) -> list[tuple[float, float, float]]:
    if values is None:
        return []
    if len(values) % 3:
        raise InputError(f"{option} has {len(values)} values: give x y z for each lamp")
    return [(values[k], values[k + 1], values[k + 2]) for k in range(0, len(values), 3)]


def _sensor(arguments: argparse.Namespace) -> Sensor:
    from uw_visibility_lab.simulation.camera import NOISELESS, Sensor

    if arguments.noiseless:
        return NOISELESS
    codes = arguments.noise_codes
    return Sensor() if codes is None else Sensor.gaussian(codes)


def _water_effects(arguments: argparse.Namespace) -> WaterEffects:
    from uw_visibility_lab.simulation.water import WaterEffects

    veil = tuple(arguments.veil)
    if len(veil) not in (1, 3):
        raise InputError(f"--veil has {len(veil)} values: give one ratio, or three for R, G, B")
    (layer, layer_height), (plume, plume_share) = arguments.layer, arguments.plume
    return of_arguments(
        WaterEffects, arguments, veil=veil * (3 // len(veil)),
        layer=layer, layer_height=layer_height, plume=plume, plume_share=plume_share,
    )
