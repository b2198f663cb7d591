# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Replay on a Dask cluster, one task per recording."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from uw_visibility import __version__
from uw_visibility.errors import InputError, needing, refusing
from uw_visibility.replay.batch import replay_bags, settle
from uw_visibility.replay.inputs.options import ReplayOptions, check_in_any
from uw_visibility.replay.results.folder import partial_of, partial_refused
from uw_visibility.replay.results.summary import Summary
from uw_visibility.replay.stores import Place, check_place, check_urls

# A running scheduler answers at once.
TIMEOUT = "10s"


def replay_on_cluster(
    address: str,
    targets: Mapping[Place, Place],
    options: ReplayOptions,
    *,
    force: bool = False,
    resume: bool = False,
) -> list[Summary]:
    """Replay recordings on an existing cluster, by the address of its scheduler; see `replay_bags`.

    The workers must have recordings and folders under the same paths or URLs, and this version
    of the package. If a worker is lost, another one resumes its recording from the last frame on
    disk, or from the beginning if the result goes to a URL.
    """
    with needing("distributed", "--scheduler"):
        distributed = importlib.import_module("distributed")
    check_urls([*targets, *targets.values()])
    for target in () if resume else targets.values():
        check_place(target, force)
        # Workers cannot check this: a partial result may be that of a lost worker, and is resumed.
        if not force and isinstance(target, Path) and partial_of(target).exists():
            raise partial_refused(partial_of(target))
    if len(targets) > 1:
        if not resume:
            check_in_any(targets, options)
        options = replace(options, several=True)
    # Errors depend on the kind of address; tls:// without settings raises a TypeError.
    with refusing(f"cannot reach the scheduler {address}", Exception):
        # Other users of dask in this process, such as xarray, do not use the cluster.
        client = distributed.Client(address, timeout=TIMEOUT, set_as_default=False)
    with client:
        _check_workers(client)
        futures = {
            bag: client.submit(
                _replay_one, *(p.resolve() if isinstance(p, Path) else p for p in (bag, target)),
                options, force, pure=False,
            )
            for bag, target in targets.items()
        }
        try:
            waiting = distributed.as_completed(list(futures.values()), loop=client.loop)
            for done, _ in enumerate(waiting, 1):
                print(f"{done} of {len(futures)} recordings", file=sys.stderr, flush=True)
            return settle(targets, [
                _outcome(bag, future, distributed.KilledWorker) for bag, future in futures.items()
            ])
        finally:
            client.cancel(list(futures.values()))


def _check_workers(client: Any) -> None:
    """Refuse workers of another version."""
    wanted = f"a worker cannot run uw_visibility {__version__}, install it there"
    with refusing(wanted, Exception):
        versions = client.run(_version)
    for worker, version in versions.items():
        if version != __version__:
            raise InputError(
                f"worker {worker} has uw_visibility {version}, this machine {__version__}: "
                "install one version everywhere"
            )


def _version() -> str:
    return __version__


def _outcome(bag: Place, future: Any, killed: type[Exception]) -> Summary | InputError:
    """Return the outcome of a task; errors other than bad input are raised."""
    try:
        return cast(Summary, future.result())
    except InputError as error:
        return error
    except killed as error:
        return InputError(
            f"{bag}: all workers that replayed it were lost, perhaps for lack of memory; "
            f"--resume continues its partial result ({error})"
        )


def _replay_one(bag: Place, target: Place, options: ReplayOptions, force: bool) -> Summary:
    """Replay one recording on a worker; resume where a lost worker stopped."""
    return replay_bags({bag: target}, options, force=force, resume=not force)[0]
