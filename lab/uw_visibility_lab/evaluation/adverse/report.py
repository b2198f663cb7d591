# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Summary and report of the adverse study."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from uw_visibility_lab.evaluation.adverse.cases import METHODS, AdversePlan
from uw_visibility_lab.evaluation.adverse.effects import CONTROL
from uw_visibility_lab.evaluation.studies import StudyResult, by_estimate, having, statistics_text
from uw_visibility_lab.evaluation.summary import Summary
from uw_visibility_lab.evaluation.tables import (
    as_text,
    flat,
    number,
    percent,
    told,
    write_report,
)

COLUMNS = {
    "cases": "cases", "refused": "refused", "beyond.attenuation": "> 3 σ: β",
    "beyond.visibility": "visib.", "beyond.depth": "depth", "beyond_any": "any",
    "ratio": "ratio", "too_long": "long", "visibility_relative_stddev": "σ",
}
"""Headings of the table of effects, by statistic."""


def summarise_adverse(results: Sequence[StudyResult]) -> Summary:
    """Reduce a study to its summary.

    Returns: ``effects``: by effect, then by the names of `METHODS`; ``levels``: the same by effect
        and level; ``adverse``: over all cases but the control's; ``control``: over the control's,
        with and without open water in view.
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


def write_adverse(
    folder: Path, plan: AdversePlan, results: Sequence[StudyResult], summary: Summary
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
    settings = {
        "effects": list(summary["effects"]),
        "attenuations": plan.attenuations,
        "depths": plan.depths,
        "seeds": plan.seeds,
        "ranges": "matched" if plan.matched else "true",
        "parameters": told(plan.config),
    }
    write_report(
        folder, {"adverse_cases": cases, "adverse": rows},
        {"settings": settings, "summary": summary, "cases": cases})


def adverse_text(summary: Summary) -> str:
    """Return the summary as tables for a terminal; the last line is the total of ours."""
    effects, adverse = summary["effects"], summary["adverse"]
    parts = [
        f"{summary['cases']} cases: {', '.join(summary['scenes'])}\n"
        "shares of all cases in %; > 3 σ: published and farther from the truth; ratio: median of\n"
        "published over true visibility; long: beyond 1.2; σ: median of visibility's, in %"
    ]
    for method, title in METHODS.items():
        groups = [(name, found[method]) for name, found in effects.items()]
        if adverse:
            groups.append(("all but none", adverse[method]))
        parts.append(statistics_text(title, COLUMNS, groups))
    parts.append(as_text(["mean |error| / mean σ, ours", "β [1/m]", "depth [m]", "no depth"], [
        [name, _with_stddev(found["ours"], "attenuation", 3),
         _with_stddev(found["ours"], "depth", 2), percent(found["ours"]["refused_depth"])]
        for name, found in effects.items()]))
    refused = [line for name, found in effects.items() for line in _reasons(name, found["ours"])]
    parts.append("\n".join(["refused, ours", *refused] if refused else ["refused, ours: none"]))
    totals = []
    for where, words in (("open_water", "with open water"), ("no_open_water", "without")):
        if summary["control"][where]:
            found = summary["control"][where]["ours"]
            totals.append(
                f"in the model's water, {words}: assessed {percent(1.0 - found['refused'])} %, "
                f"σ of visibility up to 15 %: {percent(found['certain'])} %, "
                f"> 3 σ: {percent(found['beyond_any'])} %")
    if adverse:
        totals += [
            f"{title}: {_total(adverse[method])}" for method, title in reversed(METHODS.items())]
    parts.append("\n".join(totals))
    return "\n\n".join(parts)


def _with_stddev(found: Summary, what: str, digits: int) -> str:
    return " / ".join(number(found[f"{what}_{kind}"], digits) for kind in ("error", "stddev"))


def _reasons(effect: str, found: Summary) -> list[str]:
    """Tell why the estimate was refused, and the depth where the estimate was not."""
    lines = []
    for what, known in (("reasons", {}), ("reasons_depth", found["reasons"])):
        # The advice after the reason is in evaluation.json.
        told = "; ".join(
            f"{reason.split(' (')[0]}: {n}" for reason, n in found[what].items()
            if n > known.get(reason, 0))
        if told:
            lines.append(f"  {effect}{' (depth)' if what == 'reasons_depth' else ''}: {told}")
    return lines


def _total(found: Summary) -> str:
    beyond = found["beyond"]
    return (
        f"{found['cases']} adverse cases, refused {percent(found['refused'])} %, > 3 σ: "
        f"β {percent(beyond['attenuation'])}, visibility {percent(beyond['visibility'])}, "
        f"depth {percent(beyond['depth'])}, any {percent(found['beyond_any'])} %; "
        f"too long {percent(found['too_long'])} %"
    )
