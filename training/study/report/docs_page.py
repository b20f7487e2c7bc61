"""Fill the numbers of a docs page from the study's tables.

A page is written as a template, a Markdown file with references in double braces:

- ``{{usual preset=tuned; updates=0,6000}}`` sets conditions for all later references; a condition
  names a column and the values it may have, separated by commas;
- ``{{table2 | κ | space=Spatter; algorithm=BATD3}}`` is the value in column κ of the one row that
  meets the conditions; a column named with a trailing `~` is shown with its range;
- ``{{grid table2 | κ | algorithm: BC, BATD3 | space: Anchor, Spatter | seeds=3}}`` is a table of
  such values, a row for each algorithm and a column for each space.

A condition in a reference replaces the usual one on the same column; `column=*` lifts it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from cdcsr.errors import CdcsrError
from cdcsr.tables import markdown
from training.measure.statistics import Estimate
from training.study.report.cells import Spread, Table, Value

Conditions = dict[str, list[str]]

_REFERENCE = re.compile(r"\{\{(.+?)\}\}", re.DOTALL)
_ABSENT = "-"


def render(template: str, tables: Mapping[str, Table]) -> str:
    """Return the page of a template.

    Args:
        template: Markdown with references.
        tables: the study's tables by name.

    Raises:
        CdcsrError: a reference names no table or column, or meets no row or several.
    """
    usual: Conditions = {}

    def fill(match: re.Match[str]) -> str:
        kind, *parts = (part.strip() for part in " ".join(match[1].split()).split("|"))
        word, _, rest = kind.partition(" ")
        if word == "usual":
            usual.update(_conditions(rest))
            return ""
        try:
            if word == "grid":
                return _grid(tables, usual, rest, parts)
            column, conditions = (*parts, "")[:2]
            return _cell(_table(tables, kind), column, {**usual, **_conditions(conditions)})
        except (LookupError, ValueError) as error:
            raise CdcsrError(f"The reference {match[0]} {error}.") from None

    return _REFERENCE.sub(fill, template).lstrip("\n")


def _grid(tables: Mapping[str, Table], usual: Conditions, name: str, parts: Sequence[str]) -> str:
    column, rows, columns, conditions = (*parts, "")[:4]
    (row_name, row_values), (column_name, column_values) = map(_axis, (rows, columns))
    table, shared = _table(tables, name), {**usual, **_conditions(conditions)}
    lines: list[list[str]] = []
    for row in row_values:
        texts = []
        for other in column_values:
            wanted = {**shared, row_name: [row], column_name: [other]}
            found = _rows(table, wanted)
            texts.append(_cell(table, column, wanted) if found else _ABSENT)
        lines.append([row, *texts])
    return markdown(["", *column_values], lines)


def _cell(table: Table, column: str, conditions: Conditions) -> str:
    found = _rows(table, conditions)
    if len(found) != 1:
        raise ValueError(f"meets {len(found)} rows of {table.name}, not one")
    name = column.removesuffix("~")
    if name not in table.head:
        raise LookupError(f"names no column of {table.name}: {', '.join(table.head)}")
    return _text(found[0][list(table.head).index(name)], ranged=column.endswith("~"))


def _rows(table: Table, conditions: Conditions) -> list[Sequence[Value]]:
    head = list(table.head)
    known = {name: values for name, values in conditions.items() if name in head}
    return [
        row
        for row in table.rows
        if all(
            values == ["*"] or _text(row[head.index(name)]) in values
            for name, values in known.items()
        )
    ]


def _text(value: Value, ranged: bool = False) -> str:
    if value is None:
        return _ABSENT
    if isinstance(value, Estimate):
        star = "\\*" if value.over == "episodes" else ""
        # Adding zero to a rounded number makes 0.00 of -0.00.
        middle, low, high = (round(x, 2) + 0.0 for x in (value.value, value.low, value.high))
        spread = f" ({low:.2f} to {high:.2f})" if ranged and not star else ""
        return f"{middle:.2f}{star}{spread}"
    if isinstance(value, Spread):
        return f"{value.mean:.0f}"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _table(tables: Mapping[str, Table], name: str) -> Table:
    if name not in tables:
        raise LookupError(f"names no table; there are {', '.join(sorted(tables))}")
    return tables[name]


def _conditions(text: str) -> Conditions:
    pairs = [part.partition("=") for part in text.split(";") if part.strip()]
    return {name.strip(): _values(values) for name, _, values in pairs}


def _axis(text: str) -> tuple[str, list[str]]:
    name, _, values = text.partition(":")
    return name.strip(), _values(values)


def _values(text: str) -> list[str]:
    # A comma inside a value is written with a backslash.
    parts = re.split(r"(?<!\\),", text)
    return [part.strip().replace("\\,", ",") for part in parts]
