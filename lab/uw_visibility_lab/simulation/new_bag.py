# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""New bag: written beside its target, renamed when complete, never over foreign files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from glob import escape
from pathlib import Path

from uw_visibility.config.files import (
    WORK_MARK,
    Products,
    aside_of,
    check_replaced,
    identity,
    replace_folder,
    sole_writer,
    work_folder,
)
from uw_visibility.errors import InputError
from uw_visibility.replay.bags.writer import WRITER, BagWriter

# Older simulated bags have this topic instead of the writer's mark.
TRUTH = "/ground_truth/mean_attenuation"


def _products_of(bag: Path) -> Products:
    """Return the files of a bag that this program wrote."""
    return Products(
        "metadata.yaml", (f"{escape(bag.name)}.mcap", "lighting.yaml"),
        "not a bag that this program wrote", keys=(WRITER, TRUTH))


def check_bag(path: Path, overwrite: bool) -> None:
    """Refuse to replace an existing bag, unless allowed and written by this program."""
    if not path.exists() and not path.is_symlink():
        return
    if not overwrite:
        raise InputError(f"{path} exists already: give another name, or --force to replace it")
    if identity(path) is None:
        raise InputError(f"{path} exists already and is not a bag: give another name")
    _products_of(path).check(path)


@contextmanager
def new_bag(
    path: Path, topics: Mapping[str, str], *, overwrite: bool = False
) -> Iterator[BagWriter]:
    """Yield the writer of a bag, which takes its place at `path` when complete.

    After an error or an interruption the incomplete bag is removed.
    """
    check_bag(path, overwrite)
    before, products, folder = identity(path), _products_of(path), escape(path.name)
    names = (f"{folder}/", *(f"{folder}/{name}" for name in (products.mark, *products.files)))
    work = Products(WORK_MARK, names, "no folder of an unfinished run")
    with sole_writer(path, work, products), work_folder(aside_of(path), work) as aside:
        # Files of the bag are named after its folder.
        bag = BagWriter(aside / path.name, topics, place=path)
        yield bag
        bag.close()
        try:
            check_replaced(path, products, before)
        except InputError as error:
            named = aside_of(path)
            kept = bag.path.rename(named.with_name(named.name.removeprefix(".")))
            raise InputError(f"{error}; the bag is in {kept}") from error
        replace_folder(bag.path, path, products, before)
