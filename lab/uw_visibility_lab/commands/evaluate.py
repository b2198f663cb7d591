# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`uw_visibility evaluate`: the paper's simulation experiments, with peers and an oracle."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uw_visibility.config.files import Products, gathered, refuse_inputs, sole_writer
from uw_visibility.errors import InputError, check_range
from uw_visibility.replay.progress import progress_bar, say
from uw_visibility_lab.commands.described import REQUIRED, Options, add_described

if TYPE_CHECKING:
    from uw_visibility.config.schema import PipelineConfig
    from uw_visibility_lab.evaluation.parallel import Progress

# Each takes up to 1 GB.
MOST_JOBS = 256
RESULT = "evaluation.json"
# Files of earlier versions are replaced, too.
EARLIER = ("adverse_cases", "adverse", "edges", "transect", "table1", "fig10", "noisy_cases",
           "noise", "lamp_cases", "lamps")
TABLES = ("cases", "conditions", "reliability", "survey", *EARLIER)
FIGURES = ("fig3_*", "fig5", "fig6", "fig7", "fig7_pictures", "fig9", "reliability", "survey",
           *EARLIER)
PRODUCTS = Products(
    RESULT, (
        *(f"{name}.csv" for name in TABLES),
        *(f"{name}.{kind}" for name in FIGURES for kind in ("png", "pdf", "svg"))),
    "not left by an evaluation")

HELP = "the paper's simulation experiments, with peers and an oracle"
DESCRIPTION = """\
Rerun section III of the paper: simulate stereo scenes with known disparity under water,
for each mean attenuation and depth of a grid, and compare the pipeline's results with
the truth, with OpenCV's matcher and histogram methods, and with the oracle, which knows
the water and the ranges.

Scene and water have the same light, and the parameter water.veil is paper by default.

With --lamps, a survey of the sea floor at night is rendered instead, lit by the vehicle's
lamps. Results are the water, estimated from single frames and with earlier frames, and the
variation of the same ground's colours over the frames.

A DATASET is a scene or a folder of scenes in the form of Middlebury 2005 or 2006: view1
and view5 (images), disp1.png and optionally disp5.png. Without a DATASET, scenes of our
own are rendered."""

EPILOG = """\
written to DIR:
  cases.csv         a row for each scene, noise of the sensor (0: none) and water: every
                    estimate and its truth, disparities and colours of all methods
  conditions.csv    means over the scenes for each noise and water
  reliability.csv   share of right disparities by confidence, for each noise
  evaluation.json   all of these, the settings, and the summary
  fig3_SCENE.png    pixels over range, envelopes and fitted curves (Fig. 3)
  fig5.png          disparities of the raw and of the enhanced pair (Fig. 5)
  fig6.png          attenuation, unmatched and correct disparities over turbidity (Fig. 6),
                    and these with noise
  fig7.png          attenuation and colour difference over depth (Fig. 7), and
                    fig7_pictures.png the images
  fig9.png          histogram equalisation, CLAHE, ours, oracle (Fig. 9)
  reliability.png   right share of disparities over confidence, for each noise

with --lamps:
  survey.csv        each frame of the survey: its estimate, and that with earlier frames
  survey.png        frames by method, and attenuation over the frames
  evaluation.json   all of these, the settings, and the summary

Columns of estimates are those of `uw_visibility judge --help`.
An empty field, or null, is not assessable; the status gives the reason. A disparity is
correct within 1 px (2 px for images wider than 1000 px), of all pixels whose truth is
known. All matchers search the same disparities: up to the scene's largest, unless
stereo.max_disparity is set. The result does not depend on --jobs.

exit code: 0 done, 2 unusable input or options, 1 a failure inside"""

QUICK_ATTENUATIONS, QUICK_DEPTHS = (0.0, 0.2), (2.0,)
QUICK_SURVEY = 12
NOISES, QUICK_NOISES = ("1", "2", "4", "camera"), ("2",)

# Options of one study only: the experiments, and the survey.
GRID, SURVEY = ("attenuation", "depth", "noise", "paper"), ("frames",)

OPTIONS: Options = {
    "-o --output DIR": (REQUIRED, "folder for tables and figures", Path),
    "--force": (False, "replace the results of an earlier evaluation"),
    "--attenuation A ...": (None, "mean attenuations α, 1/m (0 0.1 0.2 0.3)"),
    "--depth Z ...": (None, "depths z, m (1 2 5)"),
    "--noise N ...": (
        None, "noises of the sensor in addition to none, at one depth: Gaussian of N codes of "
        f"255, or camera for shot and read noise; 0 for no other ({' '.join(NOISES)})", str),
    "--paper": (
        False, "the grid of section III: α 0 to 0.3 1/m by 0.05, z 0 to 5 m; four times as many "
        "waters"),
    "--format {png,pdf,svg}": ("png", "format of the figures: png, or pdf or svg for print"),
    "--quick": (
        False, "a small grid (α 0 and 0.2 1/m, z 2 m, noise of 2 codes)"),
    "--jobs N": (1, "processes that share the work; each takes up to 1 GB"),
    "--params-file YAML": (
        None, "parameters of the pipeline, such as stereo.matcher and stereo.model for a network, "
        "in the form of config/uw_visibility.yaml", Path),
    "survey under lamps": {
        "--lamps": (False, "a survey at night"),
        "--frames N": (None, "frames of the survey (100)", int),
    },
}


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "datasets", metavar="DATASET", type=Path, nargs="*",
        help="a scene or a folder of scenes; none for rendered ones",
    )
    add_described(parser, OPTIONS)


Written = tuple[Callable[[Path], object], str]
"""Function that writes a study's results to a folder, and the summary as text."""


def run(arguments: argparse.Namespace) -> None:
    check_range("--jobs", arguments.jobs, 1, MOST_JOBS)
    if arguments.output.exists() and not arguments.output.is_dir():
        raise InputError(f"{arguments.output} is a file: give a folder with -o")
    PRODUCTS.check_room(arguments.output, force=arguments.force)
    refuse_inputs(
        [*arguments.datasets, arguments.params_file], PRODUCTS.present(arguments.output))
    _refuse_ignored(arguments)
    study = _run_survey if arguments.lamps else _run_experiments
    with sole_writer(arguments.output):
        write, text = study(
            arguments, lambda done, total: progress_bar(done, "evaluate", total))
        with gathered(arguments.output, PRODUCTS, force=arguments.force) as folder:
            write(folder)
    print(text)
    say("")
    say(f"tables and figures: {arguments.output}")


def _refuse_ignored(arguments: argparse.Namespace) -> None:
    """Refuse options of the other study, which would run without them."""
    others, what = (
        (GRID, "not for --lamps: leave out one of them") if arguments.lamps
        else (SURVEY, "for --lamps: give both, or neither"))
    for name in others:
        if getattr(arguments, name) not in (None, False):
            raise InputError(f"--{name} is {what}")


def _run_experiments(arguments: argparse.Namespace, progress: Progress) -> Written:
    from uw_visibility_lab.evaluation import experiments
    from uw_visibility_lab.evaluation.figures import write_figures
    from uw_visibility_lab.evaluation.report import summarise, summary_text, write_evaluation
    from uw_visibility_lab.evaluation.scenes import find_scenes

    quick = arguments.quick
    if quick and arguments.paper:
        raise InputError("--paper and --quick are two grids: give one of them")
    attenuations, depths = (
        (experiments.PAPER_ATTENUATIONS, experiments.PAPER_DEPTHS) if arguments.paper
        else (QUICK_ATTENUATIONS, QUICK_DEPTHS) if quick
        else (experiments.ATTENUATIONS, experiments.DEPTHS))
    plan = experiments.Plan(
        scenes=find_scenes(arguments.datasets),
        attenuations=tuple(arguments.attenuation or attenuations),
        depths=tuple(arguments.depth or depths),
        # In the paper's experiments the veil has the light of the scene.
        config=read_config(arguments.params_file, {"water.veil": "paper"}),
        noises=tuple(arguments.noise or (QUICK_NOISES if quick else NOISES)),
    )
    evaluation = experiments.evaluate(plan, arguments.jobs, progress)
    summary = summarise(evaluation)

    def write(folder: Path) -> None:
        write_evaluation(folder, evaluation, summary)
        write_figures(folder, evaluation, arguments.format)

    return write, summary_text(evaluation, summary)


def _run_survey(arguments: argparse.Namespace, progress: Progress) -> Written:
    if arguments.datasets:
        raise InputError("--lamps renders its own ground: leave out the DATASET")
    from uw_visibility_lab.evaluation import report, survey
    from uw_visibility_lab.evaluation.figures import draw_survey

    frames = QUICK_SURVEY if arguments.quick else survey.FRAMES
    if arguments.frames is not None:
        frames = arguments.frames
    check_range("number of frames of the survey", frames, survey.FEWEST_FRAMES, 10_000)
    config = read_config(arguments.params_file, {})
    found = survey.run_survey(frames, config, arguments.jobs, progress)
    summary = report.summarise_survey(found)

    def write(folder: Path) -> None:
        report.write_survey(folder, config, found, summary)
        draw_survey(folder / "survey.png", found)

    return write, report.survey_text(found, summary)


def read_config(path: Path | None, defaults: dict[str, Any]) -> PipelineConfig:
    """Read the parameters; `defaults` replace some of the package's."""
    from uw_visibility.commands.options import read_params_file
    from uw_visibility.config.schema import PipelineConfig

    config = PipelineConfig.from_parameters({**defaults, **read_params_file(path)})
    if config.camera.transfer != "linear":
        raise InputError(
            f"{path}: camera.transfer is {config.camera.transfer}: "
            "simulated images are linear, leave it out"
        )
    return config
