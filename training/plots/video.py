"""Film a controller side by side in several engines, without a display or a graphics driver."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import imageio.v2 as imageio
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw, ImageFont
from tqdm import tqdm

from backends.viewers.software import Renderer
from cdcsr.envs.gym_env import TaskVectorEnv
from cdcsr.errors import CdcsrError
from cdcsr.files import write_bytes
from cdcsr.robot.colors import BACKGROUND
from cdcsr.robot.description import Robot
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.engines import engine_title
from controllers.controller import Controller
from controllers.rollout import rollout
from training.plots.targets import MISSED_COLOR, REACHED_COLOR

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

FRAMES_PER_SECOND = 12
FRAME_PERIOD = 0.01
"""Simulated time between two frames, in [s]; the video is eight times slower than reality."""
HOLD = 14
"""Frames for which the end of an episode is shown."""
WIDTH, HEIGHT, CAPTION = 400, 640, 80
"""Size of one engine's picture, and height of the caption above it, in pixels. Video codecs need
multiples of 16."""
CLOSE = 160
"""Edge of the near view beside the robot, in pixels."""
_INK, _SOFT, _LINE = "#333333", "#808080", "#d5d7db"
_MARGIN = 20


@dataclass(frozen=True)
class Recording:
    """Episodes of one controller in one engine. An episode's rows continue after its end."""

    backend: str
    position: Array
    """Generalized positions as in a Snapshot, shape (steps + 1, N, 7 + C + H)."""
    distance: Array
    """Distance from tip to target in [m], shape (steps + 1, N)."""
    end: NDArray[np.int64]
    """The step at which each episode ended, shape (N,)."""
    success: NDArray[np.bool_]
    """Whether each episode succeeded, shape (N,)."""


def record(
    controller: Controller,
    robot: Robot,
    backend: str,
    targets: Array,
    frame_skip: int | None = None,
) -> Recording:
    """Run a controller for one episode a target and record the positions of all bodies.

    Args:
        controller: the controller that acts.
        robot: the description.
        backend: the engine.
        targets: shape (N, 3), world frame, in [m].
        frame_skip: simulation steps for which each action is held; by default the robot's own.
    """
    num = len(targets)
    env = TaskVectorEnv(num, robot, backend, frame_skip=frame_skip, autoreset_mode="Disabled")
    try:
        observation, info = env.reset(options={"targets": targets})
        position, distance = [env.simulation.get_snapshot().position], [info["distance"]]

        def watch(_: int, info: Mapping[str, Array]) -> None:
            position.append(env.simulation.get_snapshot().position)
            distance.append(info["distance"])

        done = rollout(controller, env, observation, watch)
        return Recording(
            backend, np.array(position), np.array(distance), done.length, done.terminated
        )
    finally:
        env.close()


def policy_video(
    controller: Controller,
    robot: Robot,
    backends: Sequence[str],
    targets: Array,
    paths: Sequence[Path],
    frame_skip: int | None = None,
) -> None:
    """Write a video of a controller that reaches for targets, one column an engine, in slow motion.

    Args:
        controller: the controller to film.
        robot: the description.
        backends: the engines.
        targets: one for each episode, shape (N, 3), world frame, in [m].
        paths: the files to write; their endings give the formats, .mp4 or .gif.
        frame_skip: simulation steps for which each action is held; by default the robot's own.
    """
    recordings = [record(controller, robot, backend, targets, frame_skip) for backend in backends]
    skip = ruler(robot).frame_skip if frame_skip is None else frame_skip
    frames = list(draw_frames(recordings, robot, targets, robot.time_step * skip))
    for path in paths:
        write_video(frames, path)


def draw_frames(
    recordings: Sequence[Recording], robot: Robot, targets: Array, period: float
) -> Iterator[Picture]:
    """Yield the frames of a video, episode after episode.

    Args:
        recordings: the same episodes in each engine.
        robot: the description.
        targets: shape (N, 3), world frame, in [m].
        period: time between two rows of a recording, in [s].
    """
    stride = max(1, round(FRAME_PERIOD / period))
    rows = [
        [[*range(0, int(end), stride), int(end)] for end in recording.end]
        for recording in recordings
    ]
    total = sum(len(drawn) for episodes in rows for drawn in episodes)
    renderer = Renderer(robot)
    try:
        with tqdm(total=total, desc="video", unit="picture", disable=None) as bar:
            for n, target in enumerate(targets):
                columns: list[list[Picture]] = []
                for recording, episodes in zip(recordings, rows, strict=True):
                    columns.append([])
                    for row in episodes[n]:
                        caption = _caption(
                            recording, n, row, f"target {n + 1} of {len(targets)}", row * period
                        )
                        picture = _picture(renderer, robot, recording.position[row, n], target)
                        columns[-1].append(np.concatenate([caption, picture]))
                        bar.update()
                # Where an episode ends sooner than in another engine, its last picture stays.
                for i in range(max(map(len, columns)) + HOLD):
                    yield np.concatenate(
                        [column[min(i, len(column) - 1)] for column in columns], axis=1
                    )
    finally:
        renderer.close()


def write_video(frames: Sequence[Picture], path: Path) -> None:
    """Write frames as .mp4, or as .gif of half the size and rate.

    Raises:
        CdcsrError: the file, or a temporary one, cannot be written.
    """
    try:
        with tempfile.TemporaryDirectory() as folder:
            _encode(frames, file := Path(folder) / f"video{path.suffix}")
            data = file.read_bytes()
    except OSError as error:  # of the encoder too, whose own text has many lines
        line = str(error).partition("\n")[0]
        raise CdcsrError(f"Cannot write {path}: {error.strerror or line}.") from None
    write_bytes(path, data)


def _encode(frames: Sequence[Picture], file: Path) -> None:
    """Write frames as a video of the format that the file's ending gives."""
    if file.suffix == ".gif":
        height, width, _ = frames[0].shape
        small = [
            Image.fromarray(frame).resize((width // 2, height // 2)).quantize(64)
            for frame in frames[::2]
        ]
        small[0].save(
            file,
            save_all=True,
            append_images=small[1:],
            duration=2000 // FRAMES_PER_SECOND,
            loop=0,
        )
    else:
        imageio.mimwrite(
            file,
            list(frames),
            format="FFMPEG",
            fps=FRAMES_PER_SECOND,
            codec="libx264",
            quality=7,
        )  # type: ignore[arg-type]


def _picture(renderer: Renderer, robot: Robot, position: Array, target: Array) -> Picture:
    """Draw the whole robot, and beside it a near view of the target."""
    picture = renderer.draw(position, targets=target, size=(HEIGHT, WIDTH))
    near = renderer.draw(
        position, targets=target, size=(CLOSE, CLOSE), focus=(target, 0.15 * robot.arm_length)
    )
    top, left = HEIGHT // 2 - CLOSE, WIDTH - _MARGIN - CLOSE
    picture[top - 1 : top + CLOSE + 1, left - 1 : left + CLOSE + 1] = ImageColor.getrgb(_LINE)
    picture[top : top + CLOSE, left : left + CLOSE] = near
    return picture


def _caption(recording: Recording, episode: int, row: int, title: str, time: float) -> Picture:
    """Draw the text above a picture: engine, target, time and distance."""
    image = Image.new("RGB", (WIDTH, CAPTION), BACKGROUND)
    draw = ImageDraw.Draw(image)
    large, small = ImageFont.load_default(24), ImageFont.load_default(17)
    right = WIDTH - _MARGIN
    draw.text((_MARGIN, 12), engine_title(recording.backend), _INK, large)
    draw.text((right, 17), title, _SOFT, small, anchor="ra")
    draw.text((_MARGIN, 48), f"{1000 * time:.0f} ms", _INK, small)
    words, color = f"{1000 * recording.distance[row, episode]:.0f} mm to target", _INK
    if row == recording.end[episode]:
        outcome = ("missed", MISSED_COLOR), ("reached", REACHED_COLOR)
        word, color = outcome[int(recording.success[episode])]
        words = f"{words}: {word}"
    draw.text((right, 48), words, color, small, anchor="ra")
    draw.line([(_MARGIN, CAPTION - 1), (right, CAPTION - 1)], _LINE)
    return np.asarray(image)
