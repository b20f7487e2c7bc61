"""Film a controller side by side in several engines, without a display or a graphics driver: as a
video, or as a page whose robots can be looked at from all sides."""

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
from cdcsr.files import write_bytes, write_text
from cdcsr.robot.colors import BACKGROUND
from cdcsr.robot.description import Robot
from cdcsr.robot.ruler import millimetres, ruler
from cdcsr.simulation.engines import engine_title
from cdcsr.tasks.debris import Surface
from controllers.controller import Controller
from controllers.rollout import rollout
from training.plots.targets import MISSED_COLOR, REACHED_COLOR

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

FRAMES_PER_SECOND = 12
FRAME_PERIOD = 0.01
"""Simulated time between two frames with the paper's robot, in [s]; the video is eight times slower
than reality. Episodes of other robots take as long to watch."""
HOLD = 14
"""Frames for which the end of an episode is shown."""
WIDTH, HEIGHT, CAPTION = 400, 640, 80
"""Size of one engine's picture, and height of the caption above it, in pixels. Pictures of another
width have the same proportions."""
CLOSE = 160
"""Edge of the near view beside the robot, in pixels."""
_INK, _SOFT, _LINE = "#333333", "#808080", "#d5d7db"
_MARGIN = 20


@dataclass(frozen=True)
class Style:
    """How a film looks."""

    period: float
    """Simulated time between two frames, in [s]."""
    rate: int = FRAMES_PER_SECOND
    """Frames in a second."""
    width: int = WIDTH
    """Width of one engine's picture in pixels, even."""
    camera: str = "side"
    """A name in :data:`cdcsr.simulation.cameras.CAMERAS`."""
    seconds: float = np.inf
    """The simulated time after which an episode is no longer shown, in [s]."""
    debris: Surface | None = None
    """A piece of debris that is drawn too."""

    def pixels(self, length: int) -> int:
        """Return a length of the picture that is :data:`WIDTH` wide in pixels of this one, even."""
        return 2 * round(length * self.width / WIDTH / 2)


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
    tension: Array
    """The tension of the cables in [N], shape (steps + 1, N, C)."""

    def rows(self, episode: int, period: float, style: Style) -> list[int]:
        """Return the rows of an episode that are shown, whose distance in time is `period` [s]."""
        end = min(int(self.end[episode]), round(min(style.seconds / period, 1e9)))
        return [*range(0, end, max(1, round(style.period / period))), end]


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
        position, distance, tension = [], [], []

        def watch(_: int, info: Mapping[str, Array]) -> None:
            position.append(env.simulation.get_snapshot().position)
            distance.append(info["distance"])
            tension.append(env.simulation.state().cable_tension)

        watch(0, info)
        done = rollout(controller, env, observation, watch)
        rows = np.array(position), np.array(distance)
        return Recording(backend, *rows, done.length, done.terminated, np.array(tension))
    finally:
        env.close()


def policy_video(
    controller: Controller,
    robot: Robot,
    backends: Sequence[str],
    targets: Array,
    path: Path,
    frame_skip: int | None = None,
    style: Style | None = None,
) -> None:
    """Film a controller that reaches for targets, one column an engine, in slow motion.

    Args:
        controller: the controller to film.
        robot: the description.
        backends: the engines.
        targets: one for each episode, shape (N, 3), world frame, in [m].
        path: the file to write; its ending gives the format, .mp4, .gif or .html, which is a page
            that needs nothing else.
        frame_skip: simulation steps for which each action is held; by default the robot's own.
        style: how the film looks.
    """
    style = style or Style(FRAME_PERIOD * ruler(robot).pace)
    recordings = [record(controller, robot, backend, targets, frame_skip) for backend in backends]
    skip = ruler(robot).frame_skip if frame_skip is None else frame_skip
    period = robot.time_step * skip
    if path.suffix == ".html":
        write_text(path, draw_page(recordings, robot, targets, period, style))
    else:
        write_video(list(draw_frames(recordings, robot, targets, period, style)), path, style.rate)


def draw_page(
    recordings: Sequence[Recording], robot: Robot, targets: Array, period: float, style: Style
) -> str:
    """Return a page that shows the episodes one after another; arguments as for `draw_frames`."""
    from backends.viewers.page import Moment, page  # needs an extra

    moments: list[list[Moment]] = []
    for n, target in enumerate(targets):
        shown = [recording.rows(n, period, style) for recording in recordings]
        for i in range(max(map(len, shown)) + HOLD):
            moments.append([])
            for recording, rows in zip(recordings, shown, strict=True):
                row = rows[min(i, len(rows) - 1)]
                state = recording.position[row, n], recording.tension[row, n]
                moments[-1].append(Moment(*state, target))
    titles = [engine_title(recording.backend) for recording in recordings]
    return page(robot, titles, moments, 1 / style.rate, style.debris)


def draw_frames(
    recordings: Sequence[Recording],
    robot: Robot,
    targets: Array,
    period: float,
    style: Style | None = None,
) -> Iterator[Picture]:
    """Yield the frames of a video, episode after episode.

    Args:
        recordings: the same episodes in each engine.
        robot: the description.
        targets: shape (N, 3), world frame, in [m].
        period: time between two rows of a recording, in [s].
        style: how the film looks.
    """
    style = style or Style(FRAME_PERIOD * ruler(robot).pace)
    rows = [
        [recording.rows(n, period, style) for n in range(len(targets))] for recording in recordings
    ]
    total = sum(len(drawn) for episodes in rows for drawn in episodes)
    renderer = Renderer(robot, style.debris)
    try:
        with tqdm(total=total, desc="video", unit="picture", disable=None) as bar:
            for n, target in enumerate(targets):
                title = f"target {n + 1} of {len(targets)}"
                columns: list[list[Picture]] = []
                for recording, episodes in zip(recordings, rows, strict=True):
                    columns.append([])
                    for row in episodes[n]:
                        caption = _caption(
                            recording, n, row, title, row * period, ruler(robot).threshold, style
                        )
                        position = recording.position[row, n]
                        picture = _picture(renderer, robot, position, target, style)
                        columns[-1].append(np.concatenate([caption, picture]))
                        bar.update()
                # Where an episode ends sooner than in another engine, its last picture stays.
                for i in range(max(map(len, columns)) + HOLD):
                    yield np.concatenate(
                        [column[min(i, len(column) - 1)] for column in columns], axis=1
                    )
    finally:
        renderer.close()


def write_video(frames: Sequence[Picture], path: Path, rate: int = FRAMES_PER_SECOND) -> None:
    """Write frames, so many a second, as .mp4, or as .gif in 64 colours.

    Raises:
        CdcsrError: the file, or a temporary one, cannot be written.
    """
    try:
        with tempfile.TemporaryDirectory() as folder:
            _encode(frames, file := Path(folder) / f"video{path.suffix}", rate)
            data = file.read_bytes()
    except OSError as error:  # of the encoder too, whose own text has many lines
        line = str(error).partition("\n")[0]
        raise CdcsrError(f"Cannot write {path}: {error.strerror or line}.") from None
    write_bytes(path, data)


def _encode(frames: Sequence[Picture], file: Path, rate: int) -> None:
    """Write frames as a video of the format that the file's ending gives."""
    if file.suffix == ".gif":
        first, *rest = _with_one_palette(frames)
        duration = round(1000 / rate)
        first.save(file, save_all=True, append_images=rest, duration=duration, loop=0)
    else:
        imageio.mimwrite(
            file,
            list(frames),
            format="FFMPEG",
            fps=rate,
            codec="libx264",
            quality=7,
            macro_block_size=2,
        )  # type: ignore[arg-type]


def halved(frames: Sequence[Picture]) -> list[Picture]:
    """Return every other frame, at half the size."""
    return [np.asarray(Image.fromarray(frame).reduce(2)) for frame in frames[::2]]


def _with_one_palette(frames: Sequence[Picture]) -> list[Image.Image]:
    """Return frames in the 64 colours of the last one, so that only what moves changes."""
    palette = Image.fromarray(frames[-1]).quantize(64)
    none = Image.Dither.NONE
    return [Image.fromarray(frame).quantize(palette=palette, dither=none) for frame in frames]


def _picture(
    renderer: Renderer, robot: Robot, position: Array, target: Array, style: Style
) -> Picture:
    """Draw the whole robot, and beside it a near view of the target."""
    height, close, margin = map(style.pixels, (HEIGHT, CLOSE, _MARGIN))
    size, camera = (height, style.pixels(WIDTH)), style.camera
    picture = renderer.draw(position, camera, target, size)
    focus = target, 0.15 * robot.arm_length
    near = renderer.draw(position, camera, target, (close, close), focus)
    top, left = height // 2 - close, size[1] - margin - close
    picture[top - 1 : top + close + 1, left - 1 : left + close + 1] = ImageColor.getrgb(_LINE)
    picture[top : top + close, left : left + close] = near
    return picture


def _caption(
    recording: Recording,
    episode: int,
    row: int,
    title: str,
    time: float,
    threshold: float,
    style: Style,
) -> Picture:
    """Draw the text above a picture: engine, target, time and distance."""
    pixels = style.pixels
    image = Image.new("RGB", (pixels(WIDTH), pixels(CAPTION)), BACKGROUND)
    draw = ImageDraw.Draw(image)
    large, small = ImageFont.load_default(pixels(24)), ImageFont.load_default(pixels(18))
    left, right, second = pixels(_MARGIN), pixels(WIDTH - _MARGIN), pixels(48)
    draw.text((left, pixels(12)), engine_title(recording.backend), _INK, large)
    draw.text((right, pixels(16)), title, _SOFT, small, anchor="ra")
    draw.text((left, second), f"{1000 * time:.0f} ms", _INK, small)
    away = millimetres(recording.distance[row, episode], threshold)
    words, color = f"{away} mm to target", _INK
    if row == recording.end[episode]:
        outcome = ("missed", MISSED_COLOR), ("reached", REACHED_COLOR)
        word, color = outcome[int(recording.success[episode])]
        words = f"{words}: {word}"
    draw.text((right, second), words, color, small, anchor="ra")
    draw.line([(left, image.height - 1), (right, image.height - 1)], _LINE)
    return np.asarray(image)
