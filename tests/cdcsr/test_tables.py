"""Markdown tables."""

from __future__ import annotations

from cdcsr.tables import markdown


def test_columns_line_up_under_their_names() -> None:
    table = markdown(["robot", "m"], [["paper", "4.5"], ["a", "10"]])
    assert table == ("| robot | m   |\n| ----- | --- |\n| paper | 4.5 |\n| a     | 10  |")


def test_a_table_without_rows_is_its_head() -> None:
    assert markdown(["a", "bc"], []) == "| a | bc |\n| - | -- |"
