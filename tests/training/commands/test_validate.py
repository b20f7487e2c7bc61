"""Rods of links beside continuous ones: on files that are written here, from exact solutions."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.optimize import bisect

from cdcsr.errors import CdcsrError
from cdcsr.simulation.contract import Array
from tests.support.rods import DENSITY, LENGTH, STIFFNESS, file_vector, write_shapes
from training.commands.validate import validate


def vibration(force: float, damping_time: float, times: Array) -> Array:
    """Return the deflection of the tip of a beam that a small tip force held until t = 0, in [m].

    Euler-Bernoulli with Kelvin-Voigt damping (L. Meirovitch, "Fundamentals of Vibrations"): mode i
    has cos b cosh b = -1, w = b^2 sqrt(E I / (m L^4)), the share 4 F / (m L w^2) of the deflection
    at the start, and the damping ratio w times half of the damping time.
    """
    total = np.zeros_like(times)
    for mode in range(8):
        around = (mode + 0.5) * np.pi
        root = bisect(lambda b: np.cos(b) + 1 / np.cosh(b), around - 0.4, around + 0.4)
        assert isinstance(root, float)
        speed = root**2 * np.sqrt(STIFFNESS / (DENSITY * LENGTH**4))
        decay = damping_time * speed**2 / 2
        turn = np.sqrt(complex(decay**2 - speed**2))
        slow, fast = (np.exp((sign * turn - decay) * times) for sign in (1, -1))
        shape = ((1 + decay / turn) * slow + (1 - decay / turn) * fast) / 2
        total += 4 * force / (DENSITY * LENGTH * speed**2) * shape.real
    return total


def write_release(folder: Path, force: float, damping_time: float) -> None:
    times = 0.005 * np.arange(101.0)
    table = np.zeros((103, 13))
    table[0, 0], table[1, 10:13] = damping_time, file_vector(force, 0.0)
    table[2:, 0] = times
    across = vibration(force, damping_time, times)
    table[2:, 10:13] = [file_vector(x, LENGTH - 0.6 * x**2 / LENGTH) for x in across]
    path = folder / "dynamics" / "TPURodMuJoCo_1.txt"
    path.parent.mkdir(exist_ok=True)
    np.savetxt(path, table, delimiter="\t", fmt="%.12g")


def test_rods_are_held_against_exact_solutions(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The elastica at rest, and the textbook's cantilever that vibrates by 9 mm; the plain stack of
    links is off by more."""
    write_shapes(tmp_path, [0.3, 1.0])
    write_release(tmp_path, 0.015, 0.005)
    out, picture = tmp_path / "out.json", tmp_path / "out.png"
    validate("cosserat", tmp_path, material="tpu", links=(10, 21), shapes=5, json=out, plot=picture)
    (row,) = json.loads(out.read_text())
    for rest in row["rests"]:
        assert max(rest["tip_error"]) < 0.5 * LENGTH / rest["links"] ** 2
    assert [abs(order - 2) < 0.2 for order in row["orders"].values()] == [True, True]
    (release,) = row["releases"]
    assert release["rms"] < 1e-4
    assert release["stacked_rms"] > 5 * release["rms"]
    with Image.open(picture) as image:
        assert image.width > 1000
    shown, mean = capsys.readouterr().out, 1e3 * np.mean(row["rests"][0]["tip_error"])
    assert f"tpu          10       2  {mean:13.3f} mm" in shown
    assert "1 releases, 25 links, root mean square tip distance: mean" in shown


def test_without_releases_the_rest_is_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_shapes(tmp_path, [0.5])
    validate("cosserat", tmp_path, material="tpu", links=(6,), backend="pybullet")
    assert "no releases in" in capsys.readouterr().out


def test_broken_data_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CdcsrError, match="Cannot read the shapes in"):
        validate("cosserat", tmp_path, material="tpu")
    write_shapes(tmp_path, [0.5])
    release = tmp_path / "dynamics" / "TPURodMuJoCo_1.txt"
    release.parent.mkdir()
    for text, message in (("0 1 2\n" * 5, "is no release: it needs 13 columns"), ("x", "Cannot")):
        release.write_text(text.replace(" ", "\t"))
        with pytest.raises(CdcsrError, match=message):
            validate("cosserat", tmp_path, material="tpu", links=(6,))
    with pytest.raises(CdcsrError, match="Give at least one number of links"):
        validate("cosserat", tmp_path, links=())
