"""The site: Sphinx reads the pages beside this file, and more that are made from the code.

`make site` builds it into build/site without network; every warning is an error.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
from importlib import metadata
from pathlib import Path

from pydantic import BaseModel
from sphinx.application import Sphinx

from cdcsr.cli import main

sys.path.insert(0, str(Path(__file__).parent))
from fields import fields_page
from geometry import draw_geometry, wide_robot
from notebooks import write_notebook

project = "cdcsr"
author = "the authors of cdcsr"
version = release = metadata.version("cdcsr")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = f"cdcsr {release}"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
napoleon_use_rtype = False
exclude_patterns = ["*.in"]

SOURCE = "https://example.org/cdcsr/source/"
"""A placeholder, as in pyproject.toml: the project has no public address yet."""
MODULES = (
    "cdcsr.robot.description",
    "cdcsr.robot.segments",
    "cdcsr.robot.parts",
    "cdcsr.robot.routing",
    "cdcsr.robot.scale",
    "cdcsr.simulation.contract",
    "cdcsr.simulation.engines",
    "cdcsr.simulation.plant",
    "cdcsr.envs.gym_env",
    "cdcsr.envs.goal_env",
    "cdcsr.tasks.catalogue",
    "cdcsr.tasks.observation",
    "cdcsr.tasks.starts",
    "backends.sb3_env",
    "backends.dm_env",
    "controllers.controller",
    "controllers.jacobian",
    "controllers.rollout",
    "training.policy",
    "training.config.learner",
    "training.measure.evaluation",
    "training.measure.transfer_matrix",
)
"""The modules that users import."""
HERE = Path(__file__).parent
NOTEBOOKS = sorted((HERE / "notebooks").glob("*.ipynb"))


def commands_page() -> str:
    """Return the reference of all commands: what each prints for --help."""
    parts = ["# Commands\n\nEvery command prints this with `--help`.\n"]
    os.environ["COLUMNS"] = "90"
    for name in sorted(point.name for point in metadata.entry_points(group="cdcsr.commands")):
        asked = ["--algorithm", "clasp", "--help-all"] if name == "train" else ["--help"]
        shown = io.StringIO()
        with contextlib.redirect_stdout(shown), contextlib.suppress(SystemExit):
            main([name, *asked])
        parts.append(f"## {name}\n\n```text\n{shown.getvalue().strip()}\n```\n")
    return "\n".join(parts)


def api_page() -> str:
    """Return the reference of the modules that users import."""
    parts = ["# Modules\n"]
    for name in MODULES:
        parts.append(
            f"## `{name}`\n\n```{{eval-rst}}\n.. automodule:: {name}\n   :members:\n"
            "   :show-inheritance:\n```\n"
        )
    return "\n".join(parts)


def write_reference(_: Sphinx) -> None:
    """Write the pages that are made from the code: references, a figure, and notebooks."""
    folder = HERE / "reference"
    folder.mkdir(exist_ok=True)
    (folder / "description.md").write_text(fields_page(), "utf-8")
    draw_geometry(wide_robot(), folder / "geometry.png")
    for notebook in NOTEBOOKS:
        write_notebook(notebook, folder)
    (folder / "commands.md").write_text(commands_page(), "utf-8")
    (folder / "modules.md").write_text(api_page(), "utf-8")


def linked(_: Sphinx, name: str, source: list[str]) -> None:
    """Lead links to files outside of the site to the source, and give the index its menu."""
    source[0] = re.sub(r"\]\((?:\.\./)+([^)#]+)(#[^)]*)?\)", rf"]({SOURCE}\1)", source[0])
    if name == "index":
        pages = dict.fromkeys(re.findall(r"\]\((\S+)\.md\)", source[0]))
        made = [*(path.stem for path in NOTEBOOKS), "description", "commands", "modules"]
        listed = "\n".join([*pages, *(f"reference/{name}" for name in made)])
        source[0] += f"\n\n```{{toctree}}\n:hidden:\n\n{listed}\n```\n"


def short_signature(
    _app: Sphinx, _what: str, _name: str, obj: object, *_: object
) -> tuple[str, None] | None:
    """Leave out the signatures of descriptions: their fields are listed below them."""
    return ("", None) if isinstance(obj, type) and issubclass(obj, BaseModel) else None


def skipped(_app: Sphinx, _what: str, name: str, _obj: object, skip: bool, _: object) -> bool:
    """Leave out what only the package itself reads."""
    return skip or name in ("later", "model_config")


def setup(app: Sphinx) -> None:
    """Connect what is made from the code."""
    app.connect("builder-inited", write_reference)
    app.connect("source-read", linked)
    app.connect("autodoc-process-signature", short_signature)
    app.connect("autodoc-skip-member", skipped)
