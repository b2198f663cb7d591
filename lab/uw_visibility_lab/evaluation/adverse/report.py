# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Summary and report of the adverse study."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from uw_visibility_lab.evaluation.adverse.cases import METHODS
from uw_visibility_lab.evaluation.adverse.effects import CONTROL
from uw_visibility_lab.evaluation.studies import (
    LEGEND,
    StudyResult,
    Summary,
    by_estimate,
    grouped,
    reasons_text,
    statistics_text,
)
from uw_visibility_lab.evaluation.tables import Row, flat, write_report


def summarise_adverse(results: Sequence[StudyResult]) -> Summary:
    """Reduce a study to its summary.

    Returns: ``effects``: by effect, then by the names of `METHODS`; ``levels``: the same by effect
        and level; ``adverse``: over all cases but the control's; ``control``: over the control's,
        with and without open water in view.
    """
    effects = grouped(results, lambda result: result.labels["effect"])
    control = effects.get(CONTROL, [])
    return {
        "cases": len(results),
        "scenes": list(dict.fromkeys(result.labels["scene"] for result in results)),
        "effects": {name: by_estimate(some) for name, some in effects.items()},
        "levels": {
            name: {
                level: by_estimate(same)
                for level, same in grouped(some, lambda result: result.labels["level"]).items()
            }
            for name, some in effects.items()
        },
        "adverse": by_estimate([r for r in results if r.labels["effect"] != CONTROL]),
        "control": {
            name: by_estimate([r for r in control if r.labels["open_water"] == seen])
            for name, seen in (("open_water", True), ("no_open_water", False))
        },
    }


def write_adverse(
    folder: Path, settings: Row, results: Sequence[StudyResult], summary: Summary
) -> None:
    """Write ``adverse_cases.csv``, ``adverse.csv`` and ``evaluation.json``."""
    cases = [result.row() for result in results]
    reasons = ("reasons", "reasons_depth")
    rows = [
        {
            "effect": effect, "level": level, "method": method,
            **flat({k: v for k, v in found.items() if k not in reasons}),
            **{k: "; ".join(f"{reason}: {n}" for reason, n in found[k].items()) for k in reasons},
        }
        for effect, levels in summary["levels"].items()
        for level, methods in levels.items()
        for method, found in methods.items()
    ]
    write_report(
        folder, {"adverse_cases": cases, "adverse": rows},
        {"settings": {"effects": list(summary["effects"]), **settings}, "summary": summary,
         "cases": cases})


def adverse_text(summary: Summary) -> str:
    """Return the summary as tables for a terminal, one for each method."""
    parts = [f"{summary['cases']} cases: {', '.join(summary['scenes'])}\n{LEGEND}"]
    groups = {
        **summary["effects"], f"all but {CONTROL}": summary["adverse"],
        f"{CONTROL}, open water in view": summary["control"]["open_water"],
        f"{CONTROL}, no open water": summary["control"]["no_open_water"],
    }
    for method, title in METHODS.items():
        found = [(name, group[method]) for name, group in groups.items() if group]
        parts.append("\n".join([
            statistics_text(title, found),
            *(line for name, each in found[:len(summary["effects"])]
              for line in reasons_text(each, name)),
        ]))
    return "\n\n".join(parts)
