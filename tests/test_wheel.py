"""The source distribution and the wheel made of it hold every file of the packages, and work where
the source tree is not."""

import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the source distribution from a copy of the tree, where no old build folder can add to
    it, and the wheel from that."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    for name in packages():
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    build = "import sys, setuptools.build_meta as b; b.build_sdist(sys.argv[1])"
    subprocess.run([sys.executable, "-c", build, str(out)], cwd=source, check=True)
    (archive,) = out.glob("*.tar.gz")
    pip("wheel", "--no-build-isolation", "--wheel-dir", str(out), str(archive))
    (built,) = out.glob("*.whl")
    return built


@pytest.mark.slow
def test_wheel_holds_every_file_of_the_packages(wheel: Path) -> None:
    files = {
        path.relative_to(ROOT).as_posix()
        for name in packages()
        for path in (ROOT / name).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    held = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert held == files
    assert {f"{name}/py.typed" for name in packages()} <= held


@pytest.mark.slow
def test_it_is_used_from_an_environment_of_its_own(wheel: Path, tmp_path: Path) -> None:
    """The environment holds nothing but the wheel; other packages come from where the tests run."""
    home = tmp_path / "env"
    venv.create(home)
    place = Path(sysconfig.get_path("purelib", "venv", {"base": str(home)}))
    others = [path for path in sys.path if path.endswith("site-packages")]
    (place / "others.pth").write_text("\n".join(others))  # editable installs in there do not count
    pip("--python", str(home / "bin" / "python"), "install", str(wheel))
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

    def cdcsr(*words: str) -> str:
        done = subprocess.run(
            [home / "bin" / "cdcsr", *words], cwd=tmp_path, env=kept, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    program = "import models; print(models.__file__)"
    python = home / "bin" / "python"
    found = subprocess.check_output([python, "-c", program], cwd=tmp_path, env=kept, text=True)
    assert Path(found.strip()).is_relative_to(home)
    cdcsr("build-model", "paper", "--out", "model")
    assert {"paper.xml", "paper.urdf"} <= {path.name for path in (tmp_path / "model").iterdir()}
    measured = cdcsr("transfer", "batd3-spatter-mujoco", "--space", "spatter", "--episodes", "2")
    assert "mujoco" in measured
    shown = cdcsr("demo", "--out", "demo", "--minutes", "1")
    assert "BATD3 made" in shown
    assert (tmp_path / "demo" / "policy.gif").stat().st_size > 10_000


def packages() -> set[str]:
    """Return the top-level packages that pyproject.toml lists."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    return {name.partition(".")[0] for name in project["tool"]["setuptools"]["packages"]}


def pip(*arguments: str) -> None:
    """Run pip without looking at any package index."""
    options = ("--quiet", "--disable-pip-version-check")
    without = {**os.environ, "PIP_NO_INDEX": "1", "PIP_NO_DEPS": "1"}
    subprocess.run([sys.executable, "-m", "pip", *options, *arguments], check=True, env=without)
