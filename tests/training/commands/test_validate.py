"""Rods of links beside continuous ones: on files that are written here, from exact solutions."""

from __future__ import annotations

import json
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image
from scipy.optimize import bisect

from backends.cosserat import plots
from backends.cosserat.reference import Release, read_release, read_shapes
from backends.cosserat.releases import Swing
from backends.cosserat.statics import Fit, fit
from cdcsr.errors import CdcsrError
from cdcsr.simulation.contract import Array
from tests.support.rods import (
    DENSITY,
    DIRECTION,
    LENGTH,
    STIFFNESS,
    elastica,
    file_vector,
    write_shapes,
    write_tables,
)
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


def test_weight_and_wrenches_at_the_middle_bend_as_textbooks_say(tmp_path: Path) -> None:
    """A force or a torque at the middle bends the lower half, as an elastica or to an arc, and the
    upper half goes on straight. A small weight w a metre bends a cantilever by w L^4 / (8 E I), and
    its middle by 17/48 of that. The middle is in a joint of an odd number of links."""
    force, torque, gravity, half = 2.0, 0.1, 0.004, LENGTH / 2
    across, along = elastica(force, half, STIFFNESS)
    radius, low = STIFFNESS / torque, DENSITY * gravity * LENGTH**4 / (8 * STIFFNESS)
    bend = half / radius
    middles = [(across, along), (radius * (1 - np.cos(bend)), radius * np.sin(bend))]
    leans = [np.arcsin(force * along**2 / (2 * STIFFNESS)), bend]
    tables = np.zeros((3, 6, 17))
    tables[0, 3:, 1] = file_vector(force, 0.0)
    tables[1, :3, 1] = torque * np.array([0, -DIRECTION[0], -DIRECTION[1]])
    tables[2, 3:, 0] = file_vector(gravity, 0.0)
    for table, middle, lean in zip(tables[:2], middles, leans, strict=True):
        table[3:, 9] = file_vector(*middle)
        table[3:, 16] = file_vector(*middle + half * np.array([np.sin(lean), np.cos(lean)]))
    tables[2, 3:, 9], tables[2, 3:, 16] = file_vector(17 / 48 * low, half), file_vector(low, LENGTH)
    write_tables(tmp_path, tables)
    shapes = read_shapes(tmp_path, "tpu")
    assert min(leans) > 0.5
    for links in (8, 9, 25):
        found, most = fit("tpu", links, shapes, "mujoco"), np.array([3 * half, half, low])
        assert (found.tip_error < most / links**2).all()
        assert (found.middle_error < most / links**2).all()


def data_of(line: Line2D) -> Array:
    """Return the points of a line, shape (n, 2)."""
    return np.stack([np.asarray(line.get_xdata()), np.asarray(line.get_ydata())], axis=1)


def test_the_figure_holds_errors_by_links_and_a_release(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Errors are in [mm], even and odd numbers of links apart; second order falls from the largest
    error; of the release the part across the rod is drawn in which the tip moves most."""
    figure = Figure()
    monkeypatch.setattr(plots, "drawn", lambda *_: nullcontext(figure))
    means = {12: 2e-3, 6: 8e-3, 5: 5e-3}
    tips, errors = np.zeros((2, 3)), np.array([0.5, 1.5])
    fits = [Fit(links, tips, errors * mean, tips[:, 0], 0.1) for links, mean in means.items()]
    tip = np.stack([0.001 * np.arange(9.0), 0.02 - 0.01 * np.arange(9.0), np.full(9, 0.4)], axis=1)
    release = Release(0.004, np.zeros(3), (np.zeros(6), np.zeros(6)), 0.5, tip)
    ours, stacked = (Swing(scale * tip, np.zeros(9)) for scale in (1.1, 1.3))
    plots.draw({"tpu": fits, "steel": fits[:1]}, (release, ours, stacked), tmp_path / "a.png")
    rests, moving = (
        {str(line.get_label()): data_of(line) for line in panel.lines} for panel in figure.axes
    )
    expected = {
        "tpu, even": [[6, 8], [12, 2]],
        "tpu, odd": [[5, 5]],
        "steel, even": [[12, 2]],
        "second order": [[5, 8], [6, 8 * 25 / 36], [12, 8 * 25 / 144]],
        "rounding of the data": [[0, 0.1], [1, 0.1]],
    }
    assert list(rests) == list(expected)
    for label, points in expected.items():
        np.testing.assert_allclose(rests[label], points)
    time = 0.5 * np.arange(7)  # of 4 s the first 3
    assert len(moving) == 3
    for scale, points in zip((1, 1.1, 1.3), moving.values(), strict=True):
        np.testing.assert_allclose(points, np.stack([time, scale * (20 - 20 * time)], axis=1))
    colors = [line.get_color() for line in figure.axes[0].lines[:3]]
    assert colors[0] == colors[1] != colors[2]
    figure.clear()
    plots.draw({"tpu": fits}, None, tmp_path / "a.png")
    assert len(figure.axes) == 1


def test_a_release_is_read_from_its_places_in_the_file(tmp_path: Path) -> None:
    """Torque and force at the middle, then at the tip, in the second row; in the files x is along
    the rod, and the half turn that makes it z turns y round."""
    table, turn = np.random.default_rng(0).normal(size=(6, 13)), np.array([1.0, -1.0, 1.0])
    path = tmp_path / "dynamics" / "TPURodMuJoCo_2.txt"
    path.parent.mkdir()
    np.savetxt(path, table, delimiter="\t")
    release = read_release(tmp_path, "tpu", 2)
    assert release.damping_time == table[0, 0]
    assert release.interval == pytest.approx(table[3, 0] - table[2, 0])
    np.testing.assert_allclose(release.gravity, table[0, 12:9:-1] * turn)
    vectors = table[1, 1:].reshape(4, 3)[:, ::-1] * turn
    np.testing.assert_allclose(np.ravel(release.wrenches), vectors.ravel())
    np.testing.assert_allclose(release.tip, table[2:, 12:9:-1] * turn)


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
