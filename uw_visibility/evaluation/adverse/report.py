# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Reports of the adverse study: text for a terminal, CSV and JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from uw_visibility.evaluation.adverse.cases import METHODS, AdverseResult
from uw_visibility.evaluation.adverse.study import AdversePlan
from uw_visibility.evaluation.adverse.summary import Summary
from uw_visibility.evaluation.summary import columns_of
from uw_visibility.evaluation.tables import as_csv, number, percent, told, write_report


def adverse_text(summary: Summary) -> str:
    """Return the summary as tables of up to 100 columns for a terminal."""
    parts = [
        f"{summary['cases']} cases: {', '.join(summary['scenes'])}\n"
        "shares of all cases in %; > 3 σ: published and farther from the truth; ratio: median of\n"
        "published over true visibility; long: beyond 1.2; σ: median of visibility's, in %"
    ]
    for method, title in METHODS.items():
        lines = [_header(title)]
        lines += [
            _line(f"  {name}", found[method]) for name, found in summary["effects"].items()]
        if summary["adverse"]:
            lines.append(_line("  all but none", summary["adverse"][method]))
        parts.append("\n".join(lines))
    parts.append(_accuracy(summary))
    parts.append(_reasons(summary))
    parts.append(_totals(summary))
    return "\n\n".join(part for part in parts if part)


def write_adverse(
    folder: Path, plan: AdversePlan, results: list[AdverseResult], summary: Summary
) -> None:
    """Write ``adverse_cases.csv``, ``adverse.csv`` and ``evaluation.json``."""
    cases = [result.row() for result in results]
    rows = [
        {"effect": effect, "level": level, "method": method, **_without_reasons(found)}
        for effect, levels in summary["levels"].items()
        for level, methods in levels.items()
        for method, found in methods.items()
    ]
    for name, table in (("adverse_cases", cases), ("adverse", rows)):
        (folder / f"{name}.csv").write_text(as_csv(table), encoding="utf-8")
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


def _header(title: str) -> str:
    return (
        f"{title:26s}{'cases':>6s}{'refused':>9s}{'> 3 σ: β':>10s}{'visib.':>8s}{'depth':>7s}"
        f"{'any':>6s}{'ratio':>8s}{'long':>6s}{'σ':>6s}"
    )


def _line(title: str, found: Summary) -> str:
    beyond = found["beyond"]
    return (
        f"{title:26s}{found['cases']:6d}{percent(found['refused']):>9s}"
        f"{percent(beyond['attenuation']):>10s}{percent(beyond['visibility']):>8s}"
        f"{percent(beyond['depth']):>7s}{percent(found['beyond_any']):>6s}"
        f"{number(found['ratio'], 2):>8s}{percent(found['too_long']):>6s}"
        f"{percent(found['visibility_relative_stddev']):>6s}"
    )


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
    row = columns_of({k: v for k, v in found.items() if not k.startswith("reasons")})
    for key in ("reasons", "reasons_depth"):
        row[key] = "; ".join(f"{reason}: {n}" for reason, n in found[key].items())
    return row
