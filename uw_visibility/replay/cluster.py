# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Replay on a Dask cluster, one recording a task."""

from __future__ import annotations

import importlib
import sys
import threading
import time
import uuid
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TextIO, cast

from uw_visibility import __version__
from uw_visibility.errors import InputError, needing, refusing
from uw_visibility.replay.batch import replay_bags, settle
from uw_visibility.replay.inputs.lacks import check_in_any
from uw_visibility.replay.inputs.options import ReplayOptions
from uw_visibility.replay.progress import PERIOD
from uw_visibility.replay.results.folder import partial_of
from uw_visibility.replay.results.summary import Summary
from uw_visibility.replay.stores import Place, absolute, check_place

# A scheduler answers at once, or is not there.
TIMEOUT = "10s"
# A worker tells of its frames this often, s.
TOLD_PERIOD = 1.0


def replay_on_cluster(
    address: str,
    targets: Mapping[Place, Place],
    options: ReplayOptions,
    *,
    force: bool = False,
    resume: bool = False,
) -> list[Summary]:
    """Replay recordings on an existing cluster.

    The workers must see recordings and folders under the same paths or URLs, and have
    this version of the package. What a lost worker had not finished, another one goes
    on with, from the last frame that is on disk; where the result goes to a URL, from the
    beginning.

    Parameters
    ----------
    address : str
        Of the scheduler, such as ``tcp://10.0.0.5:8786``.
    targets, options, force, resume
        As `replay_bags` takes them.

    Returns
    -------
    list of Summary
        In the order of the recordings.

    Raises
    ------
    InputError
        If `distributed` is not installed, the scheduler cannot be reached, a worker has
        another version, every recording or its folder cannot be used, or no recording
        has a topic to join.
    """
    with needing("distributed", "--scheduler"):
        distributed = importlib.import_module("distributed")
    refused = _check_targets(targets, force, resume)
    if len(targets) > 1:
        if not resume:
            check_in_any(targets, options)
        options = replace(options, several=True)
    with refusing(f"cannot reach the scheduler {address}", OSError, ValueError):
        client = distributed.Client(address, timeout=TIMEOUT)
    with client:
        _check_workers(client)
        topic = f"uw_visibility-{uuid.uuid4().hex}"
        progress = ClusterProgress(len(targets) - len(refused))
        client.subscribe_topic(topic, progress.told)
        futures = {
            bag: client.submit(
                _replay_one, absolute(bag), absolute(target), options, force, topic, pure=False,
            )
            for bag, target in targets.items() if bag not in refused
        }
        try:
            for _ in distributed.as_completed(list(futures.values())):
                progress.finished()
            return settle(targets, [
                refused.get(bag) or _outcome(bag, futures[bag], distributed.KilledWorker)
                for bag in targets
            ])
        finally:
            client.cancel(list(futures.values()))
            client.unsubscribe_topic(topic)


class ClusterProgress:
    """Progress over all workers, a line every 10 s: recordings and frames done, and the rate.

    Parameters
    ----------
    recordings : int
    stream : TextIO, optional
        Where to; standard error.
    """

    def __init__(self, recordings: int, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._recordings, self._done = recordings, 0
        self._frames: dict[str, int] = {}
        self._totals: dict[str, int | None] = {}
        self._begin = self._shown = time.monotonic()
        self._lock = threading.Lock()

    def told(self, event: tuple[float, Mapping[str, Any]]) -> None:
        """Take what a worker tells: recording, frames done, and how many it has."""
        _, content = event
        with self._lock:
            if not self._frames:
                # Before it, workers load kernels, which says nothing of the rate.
                self._begin = time.monotonic()
            bag = str(content["bag"])
            # Done again by another worker, frames are counted again from none.
            self._frames[bag], self._totals[bag] = content["frames"], content["total"]
            self._show()

    def finished(self) -> None:
        """Count a recording that is done, or cannot be."""
        with self._lock:
            self._done += 1
            self._show(at_once=True)

    def _show(self, at_once: bool = False) -> None:
        now = time.monotonic()
        if not at_once and now - self._shown < PERIOD:
            return
        self._shown = now
        frames, elapsed = sum(self._frames.values()), now - self._begin
        rate = f", {frames / elapsed:.1f} frames/s" if elapsed > 1.0 else ""
        # Recordings that no worker has opened yet are not counted.
        totals = list(self._totals.values())
        known = len(totals) == self._recordings and None not in totals
        of = f" of {sum(total or 0 for total in totals)}" if known else ""
        print(
            f"{self._done} of {self._recordings} recordings, {frames}{of} frames{rate}",
            file=self._stream, flush=True,
        )


class _Reporter:
    """Counter of frames in a worker, which tells the client now and then."""

    def __init__(self, topic: str, bag: str, total: int | None) -> None:
        self._worker = importlib.import_module("distributed").get_worker()
        self._topic, self._bag, self._total = topic, bag, total
        self._count, self._told = 0, time.monotonic()

    def add(self) -> None:
        """Count a frame."""
        self._count += 1
        if time.monotonic() - self._told >= TOLD_PERIOD:
            self._tell()

    def close(self) -> None:
        """Tell how many there were."""
        self._tell()

    def _tell(self) -> None:
        self._told = time.monotonic()
        self._worker.log_event(
            self._topic, {"bag": self._bag, "frames": self._count, "total": self._total})


def _check_targets(
    targets: Mapping[Place, Place], force: bool, resume: bool
) -> dict[Place, InputError]:
    """Return the recordings with a partial result that nobody asked to go on from.

    It is looked for here, before the work: in a worker it may be that of another worker,
    which was lost, and is gone on from.

    Raises
    ------
    InputError
        If a folder must not be replaced.
    """
    refused: dict[Place, InputError] = {}
    for bag, target in targets.items():
        if not resume:
            check_place(target, force)
        if isinstance(target, str):
            continue
        partial = partial_of(target)
        if partial.exists() and not (resume or force):
            refused[bag] = InputError(
                f"{partial} is a partial result: --resume goes on from it, --force begins anew")
    return refused


def _check_workers(client: Any) -> None:
    """Refuse workers that would make other results, or none.

    Raises
    ------
    InputError
        Naming them.
    """
    wanted = f"a worker cannot run uw_visibility {__version__}, install it there"
    with refusing(wanted, Exception):
        versions = client.run(_version)
    for worker, version in versions.items():
        if version != __version__:
            raise InputError(
                f"worker {worker} has uw_visibility {version}, and here is {__version__}: "
                "install one version everywhere"
            )


def _version() -> str:
    return __version__


def _outcome(bag: Place, future: Any, killed: type[Exception]) -> Summary | InputError:
    """Return the outcome of a task; any error but bad input is raised here."""
    try:
        return cast(Summary, future.result())
    except InputError as error:
        return error
    except killed as error:
        return InputError(
            f"{bag}: every worker that replayed it was lost, for want of memory perhaps; "
            f"--resume goes on from what there is ({error})"
        )


def _replay_one(
    bag: Place, target: Place, options: ReplayOptions, force: bool, topic: str
) -> Summary:
    """Replay one recording on whatever machine this is, from where a lost worker was."""
    return replay_bags(
        {bag: target}, options, jobs=1, force=force, resume=not force,
        counter=lambda name, total: _Reporter(topic, str(bag), total),
    )[0]
