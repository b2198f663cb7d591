# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Summary and reports of the adverse study: text for a terminal, CSV and JSON."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from uw_visibility.evaluation.adverse.cases import METHODS, AdversePlan
from uw_visibility.evaluation.adverse.effects import CONTROL
from uw_visibility.evaluation.readings import flat
from uw_visibility.evaluation.studies import StudyResult, by_estimate, having, line
from uw_visibility.evaluation.summary import Summary
from uw_visibility.evaluation.tables import number, percent, told, write_report, write_rows

COLUMNS = (
    ("cases", 6, "cases"), ("refused", 9, "refused"), ("> 3 σ: β", 10, "beyond.attenuation"),
    ("visib.", 8, "beyond.visibility"), ("depth", 7, "beyond.depth"), ("any", 6, "beyond_any"),
    ("ratio", 8, "ratio"), ("long", 6, "too_long"), ("σ", 6, "visibility_relative_stddev"),
)
"""Of the table of effects: name, width, statistic."""


def summarise_adverse(results: Sequence[StudyResult]) -> Summary:
    """Reduce a study to its summary.

    Returns
    -------
    dict
        ``effects``: by effect, then by the names of `METHODS`; ``levels``: the same
        by effect and level; ``adverse``: over all cases but the control's;
        ``control``: over the control's, with and without open water in view.
    """
    effects = {
        name: having(results, effect=name)
        for name in dict.fromkeys(result.labels["effect"] for result in results)
    }
    return {
        "cases": len(results),
        "scenes": list(dict.fromkeys(result.labels["scene"] for result in results)),
        "effects": {name: by_estimate(some) for name, some in effects.items()},
        "levels": {
            name: {
                level: by_estimate(having(some, level=level))
                for level in dict.fromkeys(result.labels["level"] for result in some)
            }
            for name, some in effects.items()
        },
        "adverse": by_estimate([r for r in results if r.labels["effect"] != CONTROL]),
        "control": {
            name: by_estimate(having(results, effect=CONTROL, open_water=seen))
            for name, seen in (("open_water", True), ("no_open_water", False))
        },
    }


def adverse_text(summary: Summary) -> str:
    """Return the summary as tables of up to 100 columns for a terminal."""
    parts = [
        f"{summary['cases']} cases: {', '.join(summary['scenes'])}\n"
        "shares of all cases in %; > 3 σ: published and farther from the truth; ratio: median of\n"
        "published over true visibility; long: beyond 1.2; σ: median of visibility's, in %"
    ]
    for method, title in METHODS.items():
        lines = [line(title, COLUMNS)]
        lines += [
            line(f"  {name}", COLUMNS, found[method])
            for name, found in summary["effects"].items()]
        if summary["adverse"]:
            lines.append(line("  all but none", COLUMNS, summary["adverse"][method]))
        parts.append("\n".join(lines))
    parts.append(_accuracy(summary))
    parts.append(_reasons(summary))
    parts.append(_totals(summary))
    return "\n\n".join(part for part in parts if part)


def write_adverse(
    folder: Path, plan: AdversePlan, results: list[StudyResult], summary: Summary
) -> None:
    """Write ``adverse_cases.csv``, ``adverse.csv`` and ``evaluation.json``."""
    cases = [result.row() for result in results]
    rows = [
        {"effect": effect, "level": level, "method": method, **_without_reasons(found)}
        for effect, levels in summary["levels"].items()
        for level, methods in levels.items()
        for method, found in methods.items()
    ]
    write_rows(folder, {"adverse_cases": cases, "adverse": rows})
    settings = {
        "effects": list(summary["effects"]),
        "attenuations": plan.attenuations,
        "depths": plan.depths,
        "seeds": plan.seeds,
        "ranges": "matched" if plan.matched else "true",
        "parameters": told(plan.config),
    }
    report = {"settings": settings, "summary": summary, "cases": cases}
    write_report(folder, report)


def _accuracy(summary: Summary) -> str:
    """Mean errors beside the mean σ that goes with them, ours."""
    lines = [
        f"{'mean |error| / mean σ, ours':26s}{'β [1/m]':>20s}{'depth [m]':>18s}"
        f"{'no depth':>10s}"
    ]
    for name, methods in summary["effects"].items():
        found = methods["ours"]
        beta, depth = (
            " / ".join(number(found[f"{what}_{kind}"], digits) for kind in ("error", "stddev"))
            for what, digits in (("attenuation", 3), ("depth", 2))
        )
        lines.append(f"  {name:24s}{beta:>20s}{depth:>18s}{percent(found['refused_depth']):>10s}")
    return "\n".join(lines)


def _reasons(summary: Summary) -> str:
    lines = []
    for name, methods in summary["effects"].items():
        for what, key in (("", "reasons"), (" (depth)", "reasons_depth")):
            reasons = methods["ours"][key]
            # What stops the estimate stops the depth: only what is lacking beyond it is new.
            if what:
                known = methods["ours"]["reasons"]
                reasons = {r: n for r, n in reasons.items() if n > known.get(r, 0)}
            if reasons:
                # What to check is in evaluation.json.
                told = "; ".join(f"{r.split(' (')[0]}: {n}" for r, n in reasons.items())
                lines.append(f"  {name}{what}: {told}")
    return "\n".join(["refused, ours", *lines]) if lines else "refused, ours: none"


def _totals(summary: Summary) -> str:
    lines = []
    for where, words in (("open_water", "with open water"), ("no_open_water", "without")):
        if summary["control"][where]:
            found = summary["control"][where]["ours"]
            lines.append(
                f"in the model's water, {words}: assessed {percent(1.0 - found['refused'])} %, "
                f"σ of visibility up to 15 %: {percent(found['certain'])} %, "
                f"> 3 σ: {percent(found['beyond_any'])} %"
            )
    for method, title in METHODS.items():
        if summary["adverse"]:
            lines.append(f"{title}: {_total(summary['adverse'][method])}")
    # The last line is ours.
    return "\n".join([*lines[:-3], *lines[:-4:-1]] if summary["adverse"] else lines)


def _total(found: Summary) -> str:
    beyond = found["beyond"]
    return (
        f"{found['cases']} adverse cases, refused {percent(found['refused'])} %, > 3 σ: "
        f"β {percent(beyond['attenuation'])}, visibility {percent(beyond['visibility'])}, "
        f"depth {percent(beyond['depth'])}, any {percent(found['beyond_any'])} %; "
        f"too long {percent(found['too_long'])} %"
    )


def _without_reasons(found: Summary) -> dict[str, Any]:
    """Return the numbers as one row, and the reasons as text."""
    row = flat({k: v for k, v in found.items() if not k.startswith("reasons")})
    for key in ("reasons", "reasons_depth"):
        row[key] = "; ".join(f"{reason}: {n}" for reason, n in found[key].items())
    return row
