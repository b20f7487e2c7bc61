"""The pages: every link leads somewhere, and every command exists and has its options."""

from __future__ import annotations

import importlib
import json
import re
import shlex
import sys
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from cdcsr.cli import main
from cdcsr.robot.description import Robot

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    [
        *ROOT.glob("*.md"),
        *(ROOT / "docs").glob("*.md"),
        *(ROOT / "models").rglob("README.md"),
        ROOT / "results" / "README.md",
    ]
)
PROGRAMS = {"cdcsr ": "", "training ": "train ", "python -m training.experiments ": "experiments "}
"""How a command is called, and what it is then called as a sub-command of `cdcsr`."""


sys.path.insert(0, str(ROOT / "docs"))
fields = importlib.import_module("fields")
geometry = importlib.import_module("geometry")
notebooks = importlib.import_module("notebooks")


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"`[^`]*`", "", page.read_text())
    broken = []
    for place, anchor in re.findall(r"\]\(([^)#\s]*)#?([^)\s]*)\)", text):
        target = (page.parent / place).resolve() if place else page
        if place.startswith("https://"):
            continue
        if not target.exists() or (anchor and anchor not in anchors(target)):
            broken.append(f"{place}#{anchor}")
    assert broken == []


def commands() -> Iterator[list[str]]:
    """Yield the words of every command in the pages, as they would follow `cdcsr`."""
    for page in PAGES:
        text = page.read_text()
        blocks = re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
        lines = "\n".join([*blocks, *re.findall(r"`([^`]+)`", text)]).replace("\\\n", " ")
        for line in lines.splitlines():
            for program, name in PROGRAMS.items():
                if line.startswith(program):
                    yield shlex.split(name + line.removeprefix(program), comments=True)


def test_commands_exist_and_have_their_options(capsys: pytest.CaptureFixture[str]) -> None:
    options: dict[str, set[str]] = {}
    for name, *rest in commands():
        if name.islower() and name[0] != "-":  # COMMAND and `cdcsr --help` name no command
            used = {word.partition("=")[0] for word in rest if word.startswith("--")}
            options.setdefault(name, set()).update(used)
    assert options.keys() <= {point.name for point in entry_points(group="cdcsr.commands")}
    for name, used in options.items():
        argv = [name, "--algorithm", "clasp", "--help-all"] if name == "train" else [name, "--help"]
        with pytest.raises(SystemExit):
            main(argv)
        known = set(re.findall(r"--[\w.-]+", capsys.readouterr().out)) | {"--help"}
        assert used <= known, name


def test_every_field_of_a_description_has_a_row_with_its_meaning() -> None:
    """The JSON schema that pydantic makes names the same keys; what refers to another model is a
    section of its own."""
    schema = Robot.model_json_schema()
    models = {"Robot": schema, **schema["$defs"]}
    expected = {
        key
        for model in models.values()
        for key, field in model["properties"].items()
        if "$ref" not in json.dumps(field)
    }
    rows = re.findall(r"^\| `(\w+)` \|.*\| (.*) \|$", fields.fields_page(), re.MULTILINE)
    assert {key for key, _ in rows} == expected
    assert [key for key, meaning in rows if not meaning] == []
    assert "| `limit` | number above 0, at most 3.14159 |" in fields.fields_page()


def test_the_figure_of_lengths_is_drawn(tmp_path: Path) -> None:
    geometry.draw_geometry(geometry.wide_robot(), tmp_path / "geometry.png")
    assert (tmp_path / "geometry.png").stat().st_size > 10_000


def test_a_notebook_shows_what_its_cells_print_and_draw(tmp_path: Path) -> None:
    def write(*cells: str) -> Path:
        rows = [{"cell_type": "code", "source": [cell]} for cell in cells]
        (tmp_path / "a.ipynb").write_text(json.dumps({"cells": rows}))
        return tmp_path / "a.ipynb"

    draw = "import matplotlib.pyplot as plt\nplt.plot([1, 2]);"
    notebooks.write_notebook(write("x = 20", "print('a')\nx + 1", draw), tmp_path)
    page = (tmp_path / "a.md").read_text()
    assert "```text\na\n21\n```" in page
    assert page.endswith("![What the cell draws](a-1.png)\n")
    assert (tmp_path / "a-1.png").stat().st_size > 1_000
    with pytest.raises(RuntimeError, match=r"a\.ipynb, cell 2 failed: ZeroDivisionError"):
        notebooks.write_notebook(write("x = 0", "1 / x"), tmp_path)


def test_notebooks_hold_no_outputs() -> None:
    for path in (ROOT / "docs" / "notebooks").glob("*.ipynb"):
        cells = json.loads(path.read_text())["cells"]
        assert not any(cell.get("outputs") for cell in cells), path
