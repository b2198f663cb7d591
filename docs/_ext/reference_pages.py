# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Reference of parameters, commands, topics and statuses, as Markdown generated from the code.

Sphinx writes the result of `pages` to docs/generated before it reads the sources, which include
it.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from uw_visibility.cli import make_parser
from uw_visibility.config.parameters import ParameterInfo, describe
from uw_visibility.config.schema import NodeConfig, PipelineConfig
from uw_visibility.messages.outputs import all_topics
from uw_visibility.plausibility.comparison import Verdict
from uw_visibility.replay.columns import COLUMNS, word
from uw_visibility.replay.report.meaning import MEANINGS, REMEDIES
from uw_visibility.status import Status

FOLDER = Path(__file__).resolve().parents[1] / "generated"

VERDICTS = {
    Verdict.OK: "Sensor and estimate agree, except for a constant error of the camera.",
    Verdict.WARN: "They disagree, as with a correct sensor only once in "
    "`plausibility.warn_interval`.",
    Verdict.ERROR: "They disagree, as with a correct sensor only once in "
    "`plausibility.error_interval`: check scale, sign and offset of the sensor, then the camera's "
    "white reference.",
    Verdict.STALE: "No recent values of the sensor.",
    Verdict.NOT_ASSESSABLE: "The estimate is too uncertain, or there is none.",
}


def pages() -> dict[str, str]:
    """Return the generated parts of the reference by file name."""
    makers: dict[str, Callable[[], Iterator[str]]] = {
        "parameters.md": parameters, "commands.md": commands, "topics.md": topics,
        "statuses.md": statuses, "verdicts.md": verdicts, "columns.md": columns,
    }
    return {name: "\n".join(make()) + "\n" for name, make in makers.items()}


def parameters() -> Iterator[str]:
    """Yield a table for each section of parameters."""
    for title, group in (("Pipeline", PipelineConfig), ("Node", NodeConfig)):
        yield f"## {title}"
        sections: dict[str, list[ParameterInfo]] = {}
        for info in describe(group):
            sections.setdefault(info.name.rpartition(".")[0], []).append(info)
        for section, infos in sorted(sections.items()):
            if section:
                yield from ("", f"### {section}")
            rows = [(f"`{i.name}`", _code(i.default), _limits(i), i.description) for i in infos]
            yield from _table(("Parameter", "Default", "Allowed", "Meaning"), rows)
        yield ""


def commands() -> Iterator[str]:
    """Yield a section for each command: description, options and outputs."""
    for name, parser in _subparsers().items():
        yield from (f"## {name}", "")
        yield from _text(parser.description or "")
        formatter = parser.formatter_class(prog=parser.prog, width=80)
        formatter.add_usage(
            parser.usage, _named(parser._actions), parser._mutually_exclusive_groups, prefix="")
        yield from _text(formatter.format_help().rstrip())
        for group in parser._action_groups:
            if actions := _named(group._group_actions):
                yield from (f"**{(group.title or '').capitalize()}**", "")
                yield from _table(("Argument", "Meaning"), [_option(parser, a) for a in actions])
        yield from _text(parser.epilog or "")


def topics() -> Iterator[str]:
    """Yield a table of all topics that node and replay publish."""
    config = NodeConfig(publish_depth_image=True, publish_points=True)
    rows = [
        (f"`{topic}`", f"`{kind.replace('/msg/', '/')}`")
        for topic, kind in all_topics(config).items()
    ]
    yield from _table(("Topic", "Type"), rows)


def statuses() -> Iterator[str]:
    """Yield a table of statuses with meaning and what to do."""
    rows = [
        (f"{status} (`{word(status)}`)", MEANINGS[status], REMEDIES[status])
        for status in Status if status is not Status.OK
    ]
    yield from _table(("As shown", "Meaning", "What to do"), rows)


def verdicts() -> Iterator[str]:
    """Yield a table of the verdicts on a depth sensor."""
    yield from _table(("Verdict", "Meaning"), [(f"`{v}`", VERDICTS[v]) for v in Verdict])


def columns() -> Iterator[str]:
    """Yield a table of the columns of frames.csv, each with its standard deviation."""
    deviations = {column.stddev_of for column in COLUMNS.values()}
    rows = [
        (f"`{name}`" + (" (`…_stddev`)" if name in deviations else ""),
         "" if column.unit in ("", "1") else column.unit,
         f"{column.title}. {column.description}".strip())
        for name, column in COLUMNS.items() if not column.stddev_of
    ]
    yield from _table(("Column", "Unit", "Meaning"), rows)


def _subparsers() -> dict[str, argparse.ArgumentParser]:
    actions = make_parser()._actions
    choices: Any = next(a for a in actions if isinstance(a, argparse._SubParsersAction)).choices
    return dict(choices)


def _named(actions: Iterable[argparse.Action]) -> list[argparse.Action]:
    """Return the actions that only some commands have."""
    return [action for action in actions if action.dest not in ("help", "debug")]


def _option(parser: argparse.ArgumentParser, action: argparse.Action) -> tuple[str, str]:
    """Return an option with its arguments, and its help with the default."""
    formatter = parser.formatter_class(prog=parser.prog)
    names = formatter._format_action_invocation(action)
    return f"`{names}`", formatter._expand_help(action) if action.help else ""


def _limits(info: ParameterInfo) -> str:
    low, high, unit = info.minimum, info.maximum, f" {info.unit}" if info.unit else ""
    if info.choices:
        text = ", ".join(f"`{choice}`" for choice in info.choices)
    elif low is not None and high is not None:
        text = f"{low:g} to {high:g}{unit}"
    elif low is not None:
        text = f"at least {low:g}{unit}"
    elif high is not None:
        text = f"at most {high:g}{unit}"
    else:
        text = {bool: "`true`, `false`"}.get(info.type, info.unit)
    return f"{text}; at start only" if info.read_only else text


def _code(value: Any) -> str:
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if value == "":
        return "empty"
    return f"`{list(value) if isinstance(value, tuple) else value}`"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    yield from ("", "| " + " | ".join(head) + " |", "| --- " * len(head) + "|")
    for row in rows:
        yield "| " + " | ".join(_cell(cell) for cell in row) + " |"
    yield ""


def _cell(text: str) -> str:
    """Return a table's cell as one line; outside of code nothing is markup."""
    parts = re.split(r"(`[^`]*`)", " ".join(text.split()).replace("|", "\\|"))
    return "".join(p if p.startswith("`") else re.sub(r"([*_<\[\]])", r"\\\1", p) for p in parts)


def _text(text: str) -> Iterator[str]:
    if text:
        yield from ("```text", text, "```", "")


def write(_app: Any = None) -> None:
    """Write the pages where they have changed, so that Sphinx reads what is new only."""
    FOLDER.mkdir(exist_ok=True)
    for name, text in pages().items():
        file = FOLDER / name
        if not file.is_file() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")


def setup(app: Any) -> dict[str, Any]:
    """Let Sphinx write the pages first."""
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True}


