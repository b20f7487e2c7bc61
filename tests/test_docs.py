"""The pages: every link leads somewhere, and every command exists and has its options."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from cdcsr.cli import main

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
