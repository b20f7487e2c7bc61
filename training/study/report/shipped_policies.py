"""Success of the shipped policies in every engine: a table, and the tables in their cards."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from cdcsr.errors import CdcsrError
from cdcsr.files import write_text
from cdcsr.simulation.engines import backend_names, engine_title
from cdcsr.tables import markdown
from training.measure.statistics import wilson
from training.study.lines import read_lines
from training.study.report.cells import Table
from training.study.store import SHIPPED

_TABLE = re.compile(r"(?:^\|.*\n)+", re.MULTILINE)


def shipped(results: Path) -> Table:
    """Build the table of the shipped policies and the scripted controllers.

    Its columns κ and "κ, interval" are text: an interval is Wilson's, over the episodes of one
    policy.
    """
    path = results / SHIPPED
    rows = []
    for line in read_lines(path) if path.is_file() else ():
        success = [int(one) for one in str(line["success"])]
        low, high = wilson(sum(success), len(success))
        rate = f"{np.mean(success):.2f}"
        length = np.array(line["length"])
        rows.append(
            [
                *(str(line[key]) for key in ("controller", "space", "start", "backend")),
                rate,
                f"{rate} ({low:.2f} to {high:.2f})",
                f"{length.mean():.1f} ± {length.std():.1f}",
            ]
        )
    head = ("controller", "space", "start", "engine", "κ", "κ, interval", "l_epi")
    note = "100 held-out targets (seed 10000) each; one policy, whose interval is over episodes."
    return Table("shipped", "Shipped policies", note, head, rows)


def write_card(folder: Path, results: Path) -> None:
    """Write the results of a shipped policy into the table of its card `README.md`.

    Raises:
        CdcsrError: the card has no table, or several.
    """
    path = folder / "README.md"
    text = path.read_text("utf-8")
    if len(_TABLE.findall(text)) != 1:
        raise CdcsrError(f"{path} has {len(_TABLE.findall(text))} tables, not one.")
    cells = {
        (space, start, engine): (rate, length)
        for name, space, start, engine, _, rate, length in shipped(results).rows
        if name == folder.name
    }
    places = list(dict.fromkeys((space, start) for space, start, _ in cells))
    head = ["space", "start"]
    for engine in backend_names():
        head += [engine_title(engine), "length"]
    none = "not measured", "-"
    body = [
        [*place, *(str(x) for engine in backend_names() for x in cells.get((*place, engine), none))]
        for place in places
    ]
    write_text(path, _TABLE.sub(lambda _: markdown(head, body) + "\n", text))
