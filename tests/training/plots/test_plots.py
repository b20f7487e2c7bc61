"""Learning curves, pictures of targets, and videos: what was measured is found in them again."""

from __future__ import annotations

import gc
import warnings
from pathlib import Path

import imageio.v2 as imageio
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageSequence

from backends.viewers.software import Renderer
from cdcsr.errors import CdcsrError
from cdcsr.plots import COLORS
from cdcsr.robot.colors import BACKGROUND, TARGET_RADIUS
from cdcsr.robot.description import load_robot
from controllers.jacobian import JacobianController
from tests.support.pixels import count_pixels
from training.measure.evaluation import Result, wilson
from training.plots import video
from training.plots.learning_curve import draw_learning_curve
from training.plots.targets import MISSED_COLOR, REACHED_COLOR, draw_targets
from training.run.metrics import Metrics


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run with metrics of three evaluations."""
    folder = tmp_path / "run"
    folder.mkdir()
    metrics = Metrics(folder, 0)
    for update, successes in ((1000, 5), (2000, 50), (3000, 90)):
        low, high = wilson(successes, 100)
        metrics.add(
            {
                "update": update,
                "environment_steps": 64 * update,
                "minutes": update / 1000,
                "success_rate": successes / 100,
                "success_low": low,
                "success_high": high,
            }
        )
    return folder


def test_learning_curve_shows_every_run(run: Path, tmp_path: Path) -> None:
    draw_learning_curve([run], tmp_path / "one.png")
    draw_learning_curve([run, run.parent / "empty"], tmp_path / "same.png", {"BC": 0.7})
    assert count_pixels(tmp_path / "one.png", COLORS[0]) > 500
    assert (tmp_path / "one.png").read_bytes() != (tmp_path / "same.png").read_bytes()
    height, width, _ = imageio.imread(tmp_path / "one.png").shape
    assert 400 < height < width < 1400


def test_learning_curve_is_the_same_each_time(run: Path, tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        draw_learning_curve([run], tmp_path / name, {"BC": 0.7, "demonstrator": 0.93})
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_learning_curve_without_metrics(tmp_path: Path) -> None:
    with pytest.raises(CdcsrError, match=r"No run has metrics to draw yet: .*nothing"):
        draw_learning_curve([tmp_path / "nothing"], tmp_path / "curve.png")
    assert not (tmp_path / "curve.png").exists()


def results(reached: int, total: int = 20) -> Result:
    rng = np.random.default_rng(0)
    success = np.arange(total) < reached
    targets = rng.normal((0.2, 0.1, 2.4), 0.1, (total, 3))
    return Result(success, np.full(total, 100), np.zeros(total), targets)


def test_reached_and_missed_targets_differ(tmp_path: Path) -> None:
    robot = load_robot("paper")
    reds, greens = [], []
    for reached in (20, 10, 0):
        path = tmp_path / f"{reached}.png"
        panels = {"BC in MuJoCo": results(reached), "BC in PyBullet": results(reached)}
        draw_targets(panels, robot, path)
        reds.append(count_pixels(path, MISSED_COLOR))
        greens.append(count_pixels(path, REACHED_COLOR))
    assert reds[0] < reds[1] < reds[2]
    assert greens[0] > greens[1] > greens[2]


def test_one_target_and_another_robot(tmp_path: Path) -> None:
    draw_targets({"one": results(1, total=1)}, load_robot("planar-single"), tmp_path / "one.png")
    assert count_pixels(tmp_path / "one.png", REACHED_COLOR) > 0


def test_no_results_are_refused(tmp_path: Path) -> None:
    with pytest.raises(CdcsrError, match="no results"):
        draw_targets({}, load_robot("paper"), tmp_path / "none.png")


ROBOT = load_robot("paper")
TARGETS = np.array([(0.25, 0.1, 2.5), (0.15, 0.05, 2.4)])
BACKENDS = ("mujoco", "pybullet")


def read_video(path: Path) -> NDArray[np.int16]:
    """Return all frames, shape (n, height, width, 3)."""
    with warnings.catch_warnings():
        # The reader leaves a pipe open until it is collected.
        warnings.simplefilter("ignore", ResourceWarning)
        frames = np.array(list(imageio.get_reader(path).iter_data()), dtype=np.int16)
        gc.collect()
    return frames


@pytest.fixture(scope="module")
def recordings() -> list[video.Recording]:
    return [
        video.record(JacobianController(ROBOT), ROBOT, backend, TARGETS) for backend in BACKENDS
    ]


def test_recording_ends_where_the_episodes_do(recordings: list[video.Recording]) -> None:
    for recording in recordings:
        assert recording.success.all()
        assert len(recording.position) == recording.end.max() + 1
        for n, end in enumerate(recording.end):
            assert recording.distance[end, n] <= 0.03 < recording.distance[end - 1, n]
        straight = np.zeros(ROBOT.num_cables + ROBOT.num_hinges)
        np.testing.assert_allclose(recording.position[0, :, 7:], [straight, straight], atol=1e-12)
        start = np.linalg.norm(TARGETS - (0, 0, ROBOT.top + ROBOT.arm_length), axis=1)
        np.testing.assert_allclose(recording.distance[0], start, atol=1e-9)


def test_video_shows_a_moving_robot_in_each_half(
    recordings: list[video.Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(video, "FRAME_PERIOD", 0.4)  # every 160th step
    frames = list(video.draw_frames(recordings, ROBOT, TARGETS, ROBOT.time_step))
    ends = np.array([recording.end for recording in recordings])
    # Steps 0, 160, ... before the end, and the end itself; then the end stays.
    expected = int((-(-ends // 160) + 1).max(axis=0).sum()) + len(TARGETS) * video.HOLD
    assert len(frames) == expected

    video.write_video(frames, tmp_path / "policy.mp4")
    video.write_video(video.halved(frames), tmp_path / "policy.gif", 6)
    read = read_video(tmp_path / "policy.mp4")
    assert read.shape == (expected, video.CAPTION + video.HEIGHT, 2 * video.WIDTH, 3)
    for half in np.split(read, 2, axis=2):
        drawn = half[:, video.CAPTION :]
        share = (abs(drawn - np.array(BACKGROUND, np.int16)).max(axis=3) > 40).mean(axis=(1, 2))
        assert (share > 0.05).all()
        assert (share < 0.5).all()
        assert abs(drawn[0] - drawn[video.HOLD]).max() > 100
    with Image.open(tmp_path / "policy.gif") as animation:
        assert animation.size == (video.WIDTH, (video.CAPTION + video.HEIGHT) // 2)
        duration = sum(frame.info["duration"] for frame in ImageSequence.Iterator(animation))
    assert duration == pytest.approx(1000 * expected / video.FRAMES_PER_SECOND, rel=0.1)


def test_focus_puts_a_point_in_the_middle_at_the_scale_asked_for(
    recordings: list[video.Recording],
) -> None:
    renderer = Renderer(ROBOT)
    target, span, pixels = np.array((0.5, -0.4, 1.0)), 0.36, 120
    picture = renderer.draw(
        recordings[0].position[0, 0], targets=target, size=(pixels, pixels), focus=(target, span)
    )
    renderer.close()
    ball = picture[..., 0] > 2 * picture[..., 1:].max(axis=2).astype(int)  # the only red thing
    rows, columns = np.nonzero(ball)
    assert abs(rows.mean() - pixels / 2) < 2
    assert abs(columns.mean() - pixels / 2) < 2
    assert ball.sum() == pytest.approx(np.pi * (TARGET_RADIUS * pixels / span) ** 2, rel=0.2)
