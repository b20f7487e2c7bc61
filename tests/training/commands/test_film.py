"""A film shows what it was asked to: engines side by side, in time, and nothing but itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image, ImageSequence

from cdcsr.cli import main
from cdcsr.robot.description import load_robot
from controllers.demonstrations import load
from training.plots import video

ROBOT = "planar-single"
SMALL = ["--robot", ROBOT, "--space", "anchor", "--width", "48", "--camera", "front"]
STYLE = ["--fps", "10", "--speed", "0.5"]


def test_a_film_has_the_size_and_the_time_asked_for(tmp_path: Path) -> None:
    out = tmp_path / "film.gif"
    options = ["--backend", "mujoco", "pybullet", "--targets", "2", "--seconds", "0.2"]
    assert main(["film", "jacobian", "--out", str(out), *SMALL, *STYLE, *options]) == 0
    with Image.open(out) as animation:
        assert animation.size == (96, 86)  # 1.8 times as high, of even parts
        # A frame each 0.05 s from 0 to 0.2 s, and the end held, for both targets. Frames that are
        # alike may be one that lasts longer.
        expected = 2 * (5 + video.HOLD) * 100
        durations = [frame.info["duration"] for frame in ImageSequence.Iterator(animation)]
        assert sum(durations) == expected
    written = out.read_bytes()
    assert main(["film", "jacobian", "--out", str(out), *SMALL]) == 2
    assert out.read_bytes() == written


def test_a_dataset_is_filmed_as_it_was_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data, recorded = tmp_path / "demos", []
    assert main(["demonstrate", "--out", str(data), "--robot", ROBOT, "--episodes", "2"]) == 0
    original = video.record
    monkeypatch.setattr(
        video, "record", lambda *given: recorded.append(original(*given)) or recorded[-1]
    )
    options = ["--backend", "mujoco", "--width", "32", "--seconds", "0"]
    assert main(["film", str(data), "--out", str(tmp_path / "film.mp4"), *options]) == 0
    episodes = load(data, load_robot(ROBOT).fingerprint)
    for n, episode in enumerate(episodes):
        assert recorded[0].end[n] == episode.length
        travel = episode.observations[-1, 23:]
        end = recorded[0].position[episode.length, n]
        np.testing.assert_allclose(end[7 : 7 + len(travel)], travel, atol=1e-9)


@pytest.mark.parametrize("ending", ["gif", "html"])
def test_debris_is_in_the_film(
    ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    room = pytest.importorskip("backends.viewers.page") if ending == "html" else video
    maker, place = "EngineScene" if ending == "html" else "Renderer", tmp_path / "debris.stl"
    center = load_robot("paper").workspace.center
    trimesh.creation.box((0.1, 0.1, 0.1)).apply_translation(center).export(place)
    original, drawn = getattr(room, maker), []
    monkeypatch.setattr(room, maker, lambda *given: drawn.append(given[-1]) or original(*given))
    options = ["--backend", "mujoco", "--targets", "1", "--seconds", "0", "--width", "32"]
    out = tmp_path / f"film.{ending}"
    assert main(["film", "jacobian", "--space", str(place), "--out", str(out), *options]) == 0
    (debris,) = drawn
    np.testing.assert_allclose(np.ptp(debris.vertices, axis=0), 0.1, rtol=1e-6)


def test_a_page_needs_nothing_else(tmp_path: Path) -> None:
    pytest.importorskip("viser")
    out = tmp_path / "film.html"
    options = ["--backend", "mujoco", "--targets", "1", "--seconds", "0.1"]
    assert main(["film", "jacobian", "--out", str(out), *SMALL, *STYLE, *options]) == 0
    page = out.read_text()
    assert page.lstrip().lower().startswith("<!doctype html>")
    assert 'src="http' not in page
    assert len(page) < 5e6


@pytest.mark.parametrize(
    ("what", "options", "message"),
    [
        ("jacobian", ["--out", "film.avi"], "A film ends in .mp4, .gif, .html"),
        ("jacobian", ["--out", "film.gif", "--camera", "sdie"], "Did you mean 'side'?"),
        ("jacobian", ["--out", "film.gif", "--backend", "mujocu"], "Did you mean 'mujoco'?"),
        ("jacobain", ["--out", "film.gif"], "Did you mean 'jacobian'?"),
    ],
)
def test_what_cannot_be_filmed_is_one_line(
    what: str, options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["film", what, *options]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
