"""`cdcsr doctor`: look at this machine and this installation, and say what to do."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple

_PACKAGES = (
    *("numpy", "scipy", "torch", "numba", "gymnasium", "minari", "pydantic", "matplotlib"),
    *("mujoco", "pybullet", "trimesh", "safetensors", "imageio_ffmpeg"),
)
"""The modules that commands import; a module has the name of its package."""
_DRAW = "import mujoco; mujoco.Renderer(mujoco.MjModel.from_xml_string('<mujoco/>'), 8, 8).render()"
"""A picture in a process of its own: OpenGL that does not start can end the process."""
_LEAST_DISK = 1e9
"""Less free space than this, in bytes, is a problem: a training run takes up to 0.3 GB."""


class Finding(NamedTuple):
    """One thing that was looked at."""

    part: str
    """The part of the installation: python, packages, engines, rendering, ..."""
    name: str
    found: str
    remedy: str = ""
    """The thing to do; empty if nothing is wrong."""


def doctor(*, json: Path | None = None) -> None:
    """Look at engines, versions, rendering, threads, caches, GPU, memory; say what to do.

    The exit code is 0 if all is well, and 1 if there is a problem.

    Args:
        json: also write the findings to this file.
    """
    from cdcsr.errors import CheckFailed
    from cdcsr.files import write_json

    findings: list[Finding] = []
    for look in (_python, _packages, _engines, _rendering, _threads, _caches, _machine):
        for finding in _safely(look):
            findings.append(finding)
            print(f"{finding.part:<10} {finding.name:<16} {finding.found}", flush=True)
            if finding.remedy:
                print(f"{'':<10} {'':<16} ! {finding.remedy}", flush=True)
    problems = [finding for finding in findings if finding.remedy]
    if json is not None:
        write_json(json, {"findings": [f._asdict() for f in findings], "problems": len(problems)})
    if problems:
        first = problems[0]
        count = f"Problems found: {len(problems)}"
        raise CheckFailed(f"{count}. First {first.name}: {first.found}. {first.remedy}")
    print("no problems found")


def _safely(look: Callable[[], Iterator[Finding]]) -> Iterator[Finding]:
    """Yield what a look finds; an error of its own is a finding too, and the other looks go on."""
    try:
        yield from look()
    except Exception as error:  # what is broken may break anything
        name = look.__name__.strip("_")
        yield Finding(name, "this look", _reason(error), "Mend what the other lines say first.")


def _python() -> Iterator[Finding]:
    yield Finding("python", "version", f"{sys.version.split()[0]} in {sys.prefix}")


def _packages() -> Iterator[Finding]:
    """Look whether packages are installed and can be imported."""
    for name in _PACKAGES:
        package = name.replace("_", "-")
        try:
            import_module(name)
            yield Finding("packages", package, version(package))
        except PackageNotFoundError:
            yield Finding("packages", package, "of unknown version")
        except ModuleNotFoundError as error:
            yield Finding("packages", package, _reason(error), f"pip install {package}")
        except Exception as error:  # a broken package may raise anything
            remedy = f"Install it again: pip install --force-reinstall {package}"
            yield Finding("packages", package, f"cannot be imported: {_reason(error)}", remedy)


def _engines() -> Iterator[Finding]:
    """Let each engine make a step."""
    import numpy as np

    from cdcsr.robot.description import load_robot
    from cdcsr.simulation.engines import (
        backend_names,
        load_backend,
        make_simulation,
        optional_engines,
    )

    robot = load_robot("planar-single")
    if not backend_names():
        remedy = "Install the package itself (pip install -e .), which brings two."
        yield Finding("engines", "all", "none is installed", remedy)
    for name in backend_names():
        try:
            kind = load_backend(name)
            simulation = make_simulation(robot, name)
            simulation.step(np.zeros((1, robot.num_cables)))
            simulation.close()
            yield Finding("engines", name, f"{kind.title} {kind.version}: makes a step")
        except Exception as error:  # an engine from elsewhere may raise anything
            remedy = "Install again the package that brings this engine."
            yield Finding("engines", name, f"makes no step: {_reason(error)}", remedy)
    for name in optional_engines():  # whoever wants one installs it; its absence is no problem
        yield Finding("engines", name, "not installed; it is an extra: pip install 'cdcsr[gpu]'")


def _rendering() -> Iterator[Finding]:
    """Draw with OpenGL, as MuJoCo does, and look for the encoder of videos."""
    import imageio_ffmpeg

    name, chosen = "OpenGL (MuJoCo)", os.environ.get("MUJOCO_GL", "")
    shown = f"MUJOCO_GL={chosen}" if chosen else "MUJOCO_GL is not set"
    if not (why := _draws(chosen)):
        yield Finding("rendering", name, f"draws ({shown})")
    else:
        others = [one for one in ("egl", "osmesa", "glfw") if one != chosen and not _draws(one)]
        remedy = "Install a graphics driver with EGL, or libosmesa6 (Debian) for MUJOCO_GL=osmesa"
        if others:
            remedy = f"Set MUJOCO_GL={others[0]}, which draws here"
        remedy += "; or draw with the pybullet engine, which needs no OpenGL."
        yield Finding("rendering", name, f"does not draw ({shown}): {why}", remedy)
    try:
        yield Finding("rendering", "ffmpeg", imageio_ffmpeg.get_ffmpeg_exe())
    except RuntimeError as error:
        remedy = "Install it again: pip install --force-reinstall imageio-ffmpeg"
        yield Finding("rendering", "ffmpeg", _reason(error), remedy)


def _draws(platform: str) -> str:
    """Return why an OpenGL platform of MuJoCo does not draw; nothing if it does."""
    env = os.environ | ({"MUJOCO_GL": platform} if platform else {})
    try:
        done = subprocess.run(
            [sys.executable, "-c", _DRAW], env=env, capture_output=True, text=True, timeout=60
        )
    except subprocess.TimeoutExpired:
        return "it hangs"
    said = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    return "" if done.returncode == 0 else (said[-1][:300] if said else f"rc {done.returncode}")


def _threads() -> Iterator[Finding]:
    from cdcsr.simulation.engines import processors

    asked = os.environ.get("OMP_NUM_THREADS", "")
    wrong = asked and not (asked.isdecimal() and int(asked))
    yield Finding(
        "threads",
        "processors",
        f"{processors()} used of {os.cpu_count()}"
        + (f" (OMP_NUM_THREADS={asked[:20]})" if asked else ""),
        "Set OMP_NUM_THREADS to a whole number from 1, or unset it." if wrong else "",
    )


def _caches() -> Iterator[Finding]:
    """Look whether compiled functions are kept, and whether folders may be written to."""
    from cdcsr.compiled import cache_folder

    place = cache_folder()
    yield Finding(
        "caches",
        "compiled code",
        place or "kept nowhere: every process compiles anew, which takes half a minute",
        "" if place else "Set NUMBA_CACHE_DIR to a folder that may be written to.",
    )
    import matplotlib

    yield Finding("caches", "figures", matplotlib.get_cachedir())
    try:
        with tempfile.TemporaryFile() as file:
            file.write(b"x" * 4096)
        yield Finding("caches", "temporary files", tempfile.gettempdir())
    except OSError as error:
        remedy = "Set TMPDIR to a folder that may be written to."
        yield Finding("caches", "temporary files", f"none: {_reason(error)}", remedy)


def _machine() -> Iterator[Finding]:
    """Look at memory, at the disk under the current folder, and at the GPU."""
    import shutil

    import torch

    from cdcsr.memory import available_memory

    free = available_memory()
    remedy = "Close other programs; training takes 0.5 to 2 GB." if free < 2e9 else ""
    yield Finding("machine", "memory", f"{free / 1e9:.1f} GB free", remedy)
    disk = shutil.disk_usage(Path.cwd()).free
    remedy = "Make room, or work in a folder of another disk." if disk < _LEAST_DISK else ""
    yield Finding("machine", "disk", f"{disk / 1e9:.1f} GB free under {Path.cwd()}", remedy)
    gpu = "none; only `training --device cuda` needs one"
    if torch.cuda.is_available():
        gpu = f"{torch.cuda.get_device_name()}; the engine warp can use it"
    yield Finding("machine", "GPU", gpu)


def _reason(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
