# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""`uw_visibility judge`: one table of the accuracy of estimators of the water, by kind of case."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from uw_visibility.config.files import write_whole
from uw_visibility.errors import InputError, check_range
from uw_visibility.replay.progress import progress_bar, say
from uw_visibility_lab.commands.described import Options, add_described

if TYPE_CHECKING:
    from uw_visibility_lab.evaluation.judging import Judged
    from uw_visibility_lab.posterior.judge import Case, Estimator

HELP = "one table of the accuracy of estimators of the water, by kind of case"
DESCRIPTION = """\
Test estimators of attenuation and visibility, ours and published ones, with the same cases: random
views of scenes with all effects, with none, and with each alone; path-traced scenes; and frames
after changes that should have no effect: noise of one code, one row and column cut off, mirroring.
Frames of the sea have no truth: their distances, and those of their halves, are listed.

With --lamps the cases are frames under lamps that are declared correctly or with errors; with
additional daylight; and frames under lamps that are declared as daylight.

Do not test an estimator with the scenes that it was trained on: give others."""

EPILOG = """\
columns:
  told         part of the cases with a distance whose 16 and 84 % differ by at most 2.5 times
  ln β, ln d   root mean square of the error of their logarithms, of the told cases
  score        root mean square of the distance's error over its σ: 1 if calibrated
  1 σ .. 3 σ   part of the distances within; .68, .95, 1.00 if calibrated
  >3 σ         part of the cases with any channel's β, or the distance, beyond 3 σ
  long, short  part of the distances that are wrong by more than a fifth
  low          part of the intervals whose lower end is above the truth; .16 if calibrated
  crps         continuous ranked probability score of ln d: less is better
  ms           median time of a case

columns with --pictures:
  step, 8 px   99th percentile of the steps of the gain between neighbours, and between pixels 8 px
               apart, that have equal values in the raw picture; codes
  noise        of the flattest areas, relative to the raw picture
  ΔE           mean colour difference to the scene without water, at the best exposure
  flicker      change of blocks' means between frames of the same scene with other noise; codes"""

OPTIONS: Options = {
    "--scenes POOL": (
        None, "scenes for random views: a folder that `python -m uw_visibility_lab.worlds pool` "
        "made", Path),
    "--middlebury FOLDER": (None, "folder of Middlebury's scenes, for random views", Path),
    "--traced FOLDER": (None, "scenes that `uw_visibility render` made", Path),
    "--sea FOLDER": (None, "frames of FLSea with their ranges", Path),
    "--pairs FOLDER": (
        None, "real pairs: left_*.png, right_*.png and calibration.json; with --pictures", Path),
    "--estimator NAME ...": (
        ["free"], "free or paper, for the package's with that water.veil; plain, the paper's own "
        "fit; sea-thru, the fit of the backscatter by Sea-thru; or a file that `uw_visibility "
        "train` wrote"),
    "--csv FILE": (None, "table to write: a row for each case and estimator", Path),
    "--cases N": (100, "number of cases of each kind"),
    "--seed S": (0, "seed of the cases"),
    "--each": (False, "a row for every effect alone, too"),
    "--lamps": (False, "judge the estimator for lamps instead, by nights of --scenes"),
    "--pictures": (
        False, "judge enhanced pictures instead, of --pairs and --traced: seams, noise, colour"),
}


def add_options(parser: argparse.ArgumentParser) -> None:
    add_described(parser, OPTIONS)


def run(arguments: argparse.Namespace) -> None:
    check_range("--cases", arguments.cases, 1, 1_000_000)
    check_range("--seed", arguments.seed, 0)
    _check_table(arguments)
    if arguments.pictures:
        _judge_pictures(arguments)
        return
    if arguments.lamps and arguments.scenes is None:
        raise InputError("no scenes for lamps: give --scenes")
    if not (arguments.scenes or arguments.middlebury or arguments.traced or arguments.sea):
        raise InputError("nothing to judge by: give --scenes, --middlebury, --traced or --sea")
    from uw_visibility_lab.evaluation.judging import HEAD, line_of, row_of
    from uw_visibility_lab.evaluation.tables import as_csv, flat
    from uw_visibility_lab.posterior.cases import sea
    from uw_visibility_lab.posterior.judge import ask, flips

    estimators = {name: _estimator(name) for name in arguments.estimator}
    rows: list[dict[str, Any]] = []
    # Folders without cases are refused before hours of work with those of others.
    kinds = list(_nights(arguments) if arguments.lamps else _kinds(arguments, estimators))
    frames = arguments.sea if not arguments.lamps else None
    if frames:
        next(sea(frames))
    if kinds:
        say(HEAD)
    for kind in kinds:
        judged: dict[str, list[Judged]] = {name: [] for name in kind.estimators}
        for case in progress_bar(kind.cases(kind.number), kind.name, kind.number):
            for name, estimator in kind.estimators.items():
                judged[name].append(ask(estimator, case))
        for place, (name, estimator) in enumerate(kind.estimators.items()):
            say(line_of(f"  {name}" if place else kind.name, row_of(judged[name])))
            if kind.disturbed:
                changed, moved = flips(estimator, list(kind.cases(max(kind.number // 4, 1))))
                say(f"{'':24} slightly changed frames: {changed:.3f} flip between told and not "
                    f"told, ln d moves by {moved:.2f} σ")
            rows += [
                flat({"cases": kind.name, "estimator": name, **each.row()})
                for each in judged[name]]
    if arguments.csv is not None:
        write_whole(arguments.csv, as_csv(rows))
    if frames:
        for name, estimator in estimators.items():
            _list_sea(name, estimator, frames)


def _check_table(arguments: argparse.Namespace) -> None:
    """Refuse a table that could not be written, before hours of work, or would have no row."""
    table = arguments.csv
    if table is None:
        return
    if table.exists():
        raise InputError(f"{table} exists already: give another name")
    if not table.absolute().parent.is_dir():
        raise InputError(f"the folder of --csv {table} does not exist: make it first")
    if arguments.pictures or not (arguments.scenes or arguments.middlebury or arguments.traced):
        raise InputError(
            "--csv has rows for --scenes, --middlebury and --traced without --pictures only: "
            "give one of these, or leave it out")


def _estimator(name: str) -> Estimator:
    from uw_visibility_lab.posterior.judge import OnBoard, plain, sea_thru

    published = {"plain": plain, "sea-thru": sea_thru}
    if name in published:
        return published[name]
    return OnBoard(name) if name in ("free", "paper") else OnBoard(weights=Path(name))


def _judge_pictures(arguments: argparse.Namespace) -> None:
    if not (arguments.pairs or arguments.traced):
        raise InputError("no pictures to judge: give --pairs or --traced")
    from uw_visibility.config.schema import PipelineConfig
    from uw_visibility_lab.posterior.pictures import (
        HEAD,
        compare,
        line_of,
        real_pairs,
        summary,
        traced_pairs,
    )

    head = HEAD
    for folder, pairs in ((arguments.pairs, real_pairs), (arguments.traced, traced_pairs)):
        every = []
        for pair in pairs(folder) if folder else ():
            rows = compare(pair, PipelineConfig(), arguments.seed)
            if head:
                say(head)
                head = ""
            for row in rows:
                say(line_of(pair.name, row))
            every += rows
        for row in summary(every):
            say(line_of(f"all {folder.name}", row))


class _Kind(NamedTuple):
    """A row of the table: `cases` yields its first so many cases, of which `number` are judged.

    If `disturbed`, a quarter of them is judged again after changes that should have no effect.
    """

    name: str
    number: int
    cases: Callable[[int], Iterator[Case]]
    estimators: Mapping[str, Estimator]
    disturbed: bool = False


def _kinds(
    arguments: argparse.Namespace, estimators: Mapping[str, Estimator]
) -> Iterator[_Kind]:
    from uw_visibility_lab.posterior.cases import drawn, traced, traced_scenes
    from uw_visibility_lab.worlds.draw import EFFECTS

    number, seed = arguments.cases, arguments.seed
    for name in ("scenes", "middlebury"):
        folder = getattr(arguments, name)
        if folder is None:
            continue
        views = partial(drawn, _scenes(name, folder), seed=seed)
        yield _Kind(f"{name}, no effect", number, partial(views, effects=()), estimators)
        yield _Kind(f"{name}, all effects", number, views, estimators, True)
        for effect in EFFECTS if arguments.each else ():
            yield _Kind(
                f"{name}, {effect}", number, partial(views, effects=(effect,)), estimators)
    if arguments.traced:
        yield _Kind(
            "traced", len(traced_scenes(arguments.traced)),
            lambda first: islice(traced(arguments.traced, seed), first), estimators)


# Exponent of reflectance relative to its median: scenes of a pool vary by a factor of two, sand and
# rock by 25 % (issue 31).
_OF_GROUND = 0.35
# Shares of daylight in the light of surfaces under lamps.
_DAYLIGHT = (0.0, 0.02, 0.1, 0.3, 0.6, 0.9)


def _nights(arguments: argparse.Namespace) -> Iterator[_Kind]:
    from uw_visibility_lab.posterior.cases import by_lamps
    from uw_visibility_lab.posterior.judge import OnBoard, under_lamps
    from uw_visibility_lab.posterior.lamps import reefs
    from uw_visibility_lab.worlds.night import EFFECTS

    frames = partial(by_lamps, _scenes("scenes", arguments.scenes), seed=arguments.seed)
    kinds: dict[str, dict[str, Any]] = {
        "lamps, no effect": {"effects": ()}, "lamps, random effects": {},
        "lamps, even ground": {"effects": (), "contrast": _OF_GROUND}}
    if arguments.each:
        kinds |= {f"lamps, {effect}": {"effects": (effect,)} for effect in EFFECTS}
    kinds |= {f"daylight {share:g} beside": {"daylight": share} for share in _DAYLIGHT}
    for name, what in kinds.items():
        yield _Kind(name, arguments.cases, partial(frames, **what), {"lamps": under_lamps})
    yield _Kind(
        "lamps, rendered reefs", arguments.cases, partial(reefs, first=arguments.seed),
        {"lamps": under_lamps})
    yield _Kind("told as daylight", arguments.cases, frames, {"free": OnBoard()})


def _scenes(name: str, folder: Path) -> list:  # type: ignore[type-arg]
    from uw_visibility_lab.worlds.scenes import load_scene, middlebury, pool

    if name == "scenes":
        return [load_scene(path) for path in pool(folder)]
    folders = [path for path in sorted(folder.iterdir()) if path.is_dir()]
    if not folders:
        raise InputError(f"{folder} holds no scenes: give the folder with those of Middlebury")
    return [middlebury(path) for path in folders]


def _list_sea(name: str, estimator: Estimator, folder: Path) -> None:
    from uw_visibility_lab.posterior.cases import halves, sea
    from uw_visibility_lab.posterior.judge import describe

    say(f"frames of the sea, {name}: visibility, m, with its 16 and 84 % quantiles")
    for case in sea(folder):
        for part in (case, *halves(case)):
            say(f"  {part.name:12} {describe(estimator(part))}")
