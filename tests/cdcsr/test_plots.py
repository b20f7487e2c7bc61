"""A figure becomes a file, in the one style."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import pytest
from PIL import Image

from cdcsr.errors import CdcsrError
from cdcsr.plots import drawn, short_count


def test_a_figure_is_a_file_when_the_block_ends(tmp_path: Path) -> None:
    path, before = tmp_path / "new" / "a.png", dict(matplotlib.rcParams)
    with drawn(path, (4, 3)) as figure:
        axes = figure.subplots()
        assert not axes.spines["right"].get_visible()
        assert not path.exists()
    with Image.open(path) as picture:
        assert picture.format == "PNG"
        assert 300 < picture.width < 700
    assert dict(matplotlib.rcParams) == before


def test_a_figure_that_fails_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), drawn(tmp_path / "a.png", (4, 3)):
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").touch()
    with pytest.raises(CdcsrError, match="Cannot write"), drawn(tmp_path / "file" / "a", (1, 1)):
        pass


def test_large_numbers_are_short_on_an_axis() -> None:
    assert [short_count(value) for value in (0, 250, 2_000, 1_500_000)] == [
        "0",
        "250",
        "2k",
        "1.5M",
    ]
