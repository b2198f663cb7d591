# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`uw_visibility train`: a posterior of the water, trained on random views."""

from __future__ import annotations

import argparse
import importlib.util
from pathlib import Path

from uw_visibility.config.files import refuse_inputs
from uw_visibility.errors import InputError, check_range
from uw_visibility.replay.progress import progress_bar, say
from uw_visibility_lab.commands.described import REQUIRED, Options, add_described

HELP = "a posterior of the water, trained on random views"
DESCRIPTION = """\
Draw random views of scenes under water (see `python -m uw_visibility_lab.worlds`), reduce each to
the estimator's statistics, and train networks that infer attenuation, veil and light from these.
The same pool, seed and number of views give the same statistics; PyTorch's rounding may differ
from one processor to another.

`uw_visibility judge` compares the result with other estimators. The package's estimator uses the
networks in its `data/daylight_posterior.npz`."""

OPTIONS: Options = {
    "-o --output NPZ": (REQUIRED, "file for the networks", Path),
    "--force": (False, "replace existing networks"),
    "--views N": (50_000, "views to draw; a core draws some 30 per second"),
    "--networks N": (3, "networks whose answers are averaged"),
    "--epochs N": (30.0, "passes over all views"),
    "--seed S": (0, "seed of the views"),
    "--jobs N": (1, "processes that draw views"),
    "--views-file NPZ": (
        None, "statistics of the views: read if the file exists, otherwise written", Path),
    "--lamps SHARE": (None, "share of views under lamps (default: that of the beliefs)", float),
    "--also NPZ": (None, "statistics of further views, which another run wrote", Path),
}


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("pool", metavar="POOL", type=Path, help="folder of scenes")
    add_described(parser, OPTIONS)


def run(arguments: argparse.Namespace) -> None:
    check_range("--views", arguments.views, 500, 10_000_000)
    check_range("--networks", arguments.networks, 1, 16)
    check_range("--epochs", arguments.epochs, 0.1, 1000.0)
    check_range("--jobs", arguments.jobs, 1, 256)
    check_range("--lamps", 0.0 if arguments.lamps is None else arguments.lamps, 0.0, 1.0)
    _check_output(arguments)
    if importlib.util.find_spec("torch") is None:
        raise InputError("train needs PyTorch: pip install 'uw_visibility_lab[train]'")
    from uw_visibility_lab.posterior import examples
    from uw_visibility_lab.posterior.train import provenance, train, write

    kept = arguments.views_file
    if kept is not None and kept.exists():
        views = examples.load(kept)
    else:
        views = examples.draw_all(
            arguments.pool, arguments.views, arguments.seed, arguments.jobs,
            lambda done, blocks: progress_bar(done, "draw", blocks), arguments.lamps)
        if kept is not None:
            examples.save(views, kept)
    if arguments.also is not None:
        views = examples.joined(views, examples.load(arguments.also))
    arrays = train(views, arguments.networks, arguments.epochs, say)
    write(arrays, arguments.output, provenance(arguments.pool, arguments.seed, views))
    say(f"networks: {arguments.output}")


def _check_output(arguments: argparse.Namespace) -> None:
    """Refuse to replace an input or a foreign file; trained networks, unless forced."""
    output: Path = arguments.output
    refuse_inputs([*arguments.pool.glob("*.npz"), arguments.views_file], [output])
    if not output.exists():
        return
    from uw_visibility.water.daylight import network

    try:
        network.load(output)
    except InputError as error:
        raise InputError(
            f"{output} exists already and holds no trained networks of this version: move it, or "
            "give another name") from error
    if not arguments.force:
        raise InputError(f"{output} exists already: give another name, or --force to replace")
