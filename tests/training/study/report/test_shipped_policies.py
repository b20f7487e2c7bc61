"""Shipped policies: what is measured again, and what the cards say."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cdcsr.errors import CdcsrError
from cdcsr.simulation.engines import backend_names
from training.policy import shipped_policies
from training.study.execute import shipped as measured
from training.study.execute.shipped import Place, measure_shipped
from training.study.lines import read_lines
from training.study.parquet import SUMS, sums
from training.study.report.shipped_policies import shipped, write_card
from training.study.store import SHIPPED

ROOT = Path(__file__).parents[4]


def line(engine: str, success: str) -> dict[str, object]:
    """Return a stored cell."""
    cell = {"controller": "p", "space": "anchor", "start": "still", "backend": engine}
    return {"name": engine, **cell, "success": success, "length": [10, 20, 30, 40]}


def store(folder: Path, lines: list[dict[str, object]]) -> Path:
    """Write cells as a store."""
    data = "".join(json.dumps(one) + "\n" for one in lines).encode()
    (folder / SHIPPED).write_bytes(data)
    (folder / SUMS).write_bytes(sums({SHIPPED: data}))
    return folder


def test_card_has_the_numbers_of_its_own_policy(tmp_path: Path) -> None:
    cells = [line(engine, "1101") for engine in backend_names()]
    other = {**line("mujoco", "0000"), "name": "other", "controller": "q"}
    results = store(tmp_path, [*cells, other])
    card = tmp_path / "p" / "README.md"
    card.parent.mkdir()
    card.write_text("before\n\n| old |\n| --- |\n| 9.99 |\n\nafter\n")
    write_card(card.parent, results)
    text = card.read_text()
    # Wilson's interval for 3 of 4, by hand: (2 p n + z^2 -+ z sqrt(z^2 + 4 n p q)) / 2 (n + z^2).
    assert text.count("0.75 (0.30 to 0.95)") == len(backend_names())
    assert text.count("25.0 ± 11.2") == len(backend_names())  # sqrt(125) = 11.18
    assert text.startswith("before\n\n| space")
    assert text.endswith("|\n\nafter\n")
    assert "0.00" not in text
    assert "9.99" not in text


@pytest.mark.parametrize("name", shipped_policies())
def test_the_cards_have_the_stored_numbers(name: str, tmp_path: Path) -> None:
    card = tmp_path / name / "README.md"
    card.parent.mkdir()
    before = (shipped_policies()[name] / "README.md").read_text("utf-8")
    card.write_text(before, "utf-8")
    write_card(card.parent, ROOT / "results")
    assert card.read_text("utf-8") == before, "run `python -m training.experiments --shipped`"


def test_card_without_a_table_is_refused(tmp_path: Path) -> None:
    (tmp_path / "README.md").write_text("no table\n")
    with pytest.raises(CdcsrError, match="has 0 tables"):
        write_card(tmp_path, store(tmp_path, [line("mujoco", "1")]))


def test_only_other_policies_are_measured_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(measured, "places", lambda _: [Place("anchor", "still", "mujoco")])
    monkeypatch.setattr(measured, "SCRIPTED", ("nearest",))
    monkeypatch.setattr(measured, "shipped_policies", lambda: {})
    assert measure_shipped(tmp_path, 2) == 1
    assert measure_shipped(tmp_path, 2) == 0  # it is there
    assert measure_shipped(tmp_path, 1) == 1  # of other episodes
    changed = [{**one, "policy": "another"} for one in read_lines(tmp_path / SHIPPED)]
    assert measure_shipped(store(tmp_path, changed), 1) == 1
    assert [row[0] for row in shipped(tmp_path).rows] == ["nearest"]
