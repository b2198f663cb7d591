# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Damaged recordings, read message by message: whatever is lost is told."""

from __future__ import annotations

import random
import shutil
from collections import Counter
from pathlib import Path

from fuzz import Outcome
from hostile import damage_database, damage_mcap, damage_metadata
from mutations import mutate
from small_bags import write_all

from uw_visibility.errors import InputError
from uw_visibility.replay.bags.reader import BagReader


class DamagedBags:
    """Bags of every form; the file with the messages or metadata.yaml is damaged."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.files = write_all(folder)

    def damage(self, rng: random.Random) -> tuple[str, Path]:
        """Make a damaged bag; returns what was done, and where it is."""
        form = rng.choice(list(self.files))
        file = self.files[form]
        ros2 = file.suffix != ".bag"
        damaged = self._folder / "damaged"
        shutil.rmtree(damaged, ignore_errors=True)
        if ros2:
            shutil.copytree(file.parent, damaged)
        else:
            damaged.mkdir()
            shutil.copy(file, damaged)
        case = f"{form}: {self._damage(damaged / file.name, rng)}"
        # As a folder, or one file of it.
        source = damaged if ros2 and rng.random() < 0.8 else damaged / file.name
        return case, source

    @staticmethod
    def _damage(file: Path, rng: random.Random) -> str:
        metadata = file.with_name("metadata.yaml")
        choice = rng.random()
        if choice < 0.1 and metadata.exists():
            return f"metadata, {damage_metadata(metadata, rng)}"
        if choice < 0.2 and metadata.exists():
            file = metadata
        elif choice < 0.5 and file.suffix == ".db3":
            return damage_database(file, rng)
        elif choice < 0.5 and file.suffix == ".mcap":
            file.write_bytes(damage_mcap(file.read_bytes(), rng))
            return "structure"
        what, content = mutate(file.read_bytes(), rng)
        file.write_bytes(content)
        return f"{file.suffix} {what}"


class Cases:
    """Damaged bags, read message by message."""

    case = ""

    def __init__(self, folder: Path) -> None:
        self._bags = DamagedBags(folder)
        self._count = self._read(self._bags.files["mcap"].parent)[0].total()

    def run(self, seed: int) -> Outcome:
        """Damage a bag and read it."""
        self.case, source = self._bags.damage(random.Random(seed))
        try:
            read, told = self._read(source)
        except InputError as error:
            return Outcome(self.case, "refused", str(error))
        lost = self._count - read.total()
        if lost <= 0:
            return Outcome(self.case, "read", told)
        # The metadata of a file that is read by itself is not looked at.
        counted = bool(told) or source.is_file()
        return Outcome(self.case, "partly" if counted else "silent", f"{lost} lost; {told}")

    @staticmethod
    def _read(path: Path) -> tuple[Counter[str], str]:
        """Return what can be used by topic, and what the reader says of the rest."""
        read: Counter[str] = Counter()
        told: Counter[str] = Counter()
        usable: Counter[str] = Counter()
        with BagReader(path) as reader:
            assert reader.span is None or reader.span[0] <= reader.span[1]
            for message in reader.messages():
                read[message.topic] += 1
                try:
                    reader.deserialize(message)
                    usable[message.topic] += 1
                except InputError as error:
                    told[str(error)] += 1
            missing = [
                topic for topic, channel in reader.channels.items()
                if channel.count is not None and channel.count > read[topic]
            ]
            return usable, "; ".join([*reader.damage, *told, *missing])
