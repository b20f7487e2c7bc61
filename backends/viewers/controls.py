"""The controls of the live view: buttons, sliders, the handle of the target, numbers and plots."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np
import viser  # pyright: ignore[reportMissingImports] - it is an extra
from numpy.typing import NDArray

from backends.viewers.disturbing import DIRECTIONS
from backends.viewers.driving import HAND
from backends.viewers.session import FASTEST, SLOWEST, Session
from cdcsr.errors import CdcsrError
from cdcsr.simulation.engines import engine_title

Array = NDArray[np.float64]
Value = TypeVar("Value", float, str)
Ask = Callable[[Callable[[], None]], None]
"""Hands a request to the loop that owns the session."""

_NUMBERS, _PLOTS = 0.1, 0.3
"""The least time between two updates of the numbers, and of the plots, in [s]."""
_PULLS = 200
"""The number of steps of a cable's slider."""
_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#999999", "#333333")
"""Colours that colour-blind readers tell apart (Okabe and Ito)."""


class Controls:
    """The controls of one session, the same on every page.

    Every number is a float: viser would turn a huge number from a page into a huge integer, which
    it cannot send to the other pages.

    Args:
        server: the pages.
        session: it is read here, and changed by requests only.
        ask: hands a request to the loop.
    """

    def __init__(self, server: viser.ViserServer, session: Session, ask: Ask) -> None:
        self._gui, self._session, self._ask = server.gui, session, ask
        self._shown_at = self._plotted_at = self._since = time.perf_counter()
        self._updates, self._rate, self._fresh, self._stale = 0, 0.0, True, True
        self._text = self._gui.add_markdown("")
        with self._gui.add_folder("Run"):
            self._add_run()
        with self._gui.add_folder("Drive"):
            self._add_drive()
        if session.driving.episodes:
            with self._gui.add_folder("Episodes"):
                self._add_episodes()
        with self._gui.add_folder("Plots"):
            self._add_plots()
        with self._gui.add_folder("Plant", expand_by_default=False):
            self._add_plant()
        with self._gui.add_folder("Disturbances", expand_by_default=False):
            self._add_disturbances()
        self._target, size = session.target, 0.08 * session.robot.arm_length
        self._handle = server.scene.add_transform_controls(
            "/engine0/handle", size, disable_rotations=True, position=session.target
        )

        @self._handle.on_update
        async def _(event: viser.TransformControlsEvent) -> None:
            place = np.array(event.target.position, dtype=float)
            ask(lambda: self._drag(place))

    def show(self, changed: bool) -> None:
        """Show the numbers of the session, and now and then the plots.

        Args:
            changed: whether anything has changed since the last call.
        """
        now = time.perf_counter()
        self._updates, self._stale = self._updates + changed, self._stale or changed
        if now - self._since >= 1:
            self._rate = self._updates / (now - self._since)
            self._updates, self._since = 0, now
        if now - self._shown_at >= _NUMBERS:
            self._shown_at = now
            self._show_numbers()
        if self._stale and now - self._plotted_at >= _PLOTS:
            self._plotted_at, self._stale = now, False
            for plot, values in zip(self._plots, self._plot_values(), strict=True):
                plot.data = tuple(values)

    def _add_run(self) -> None:
        gui, session = self._gui, self._session
        self._play = gui.add_button("Play")
        self._on_click(self._play, self._turn)
        self._on_click(gui.add_button("Step"), session.step)
        self._on_click(gui.add_button("Reset"), self._reset)
        speed = gui.add_slider("speed", SLOWEST, FASTEST, 0.01, session.speed)
        self._on_change(speed, self._set_speed)
        self._seed = gui.add_number("seed of target", float(session.seed), min=0.0, step=1.0)
        self._on_change(self._seed, lambda seed: session.new_target(_whole(seed)))
        self._on_click(gui.add_button("Next target"), self._next_target)

    def _add_drive(self) -> None:
        gui, driving = self._gui, self._session.driving
        self._driver = gui.add_dropdown("driver", driving.names, initial_value=driving.name)
        self._on_change(self._driver, self._drive)
        self._pulls = []
        for n, full in enumerate(driving.full.tolist()):
            sign = 1.0 if full > 0 else -1.0
            name = f"cable {n + 1} [{driving.units[n]}]"
            pull = gui.add_slider(name, 0.0, abs(full), abs(full) / _PULLS, 0.0)
            self._on_change(pull, lambda value, n=n, sign=sign: driving.pull(n, sign * value))
            self._pulls.append(pull)

    def _add_episodes(self) -> None:
        gui, session, last = self._gui, self._session, len(self._session.driving.episodes)
        self._episode = gui.add_number("episode", 1.0, min=1.0, max=float(last), step=1.0)
        self._on_change(self._episode, lambda number: self._show_episode(_whole(number) - 1))
        failure = gui.add_button("Next failure")
        self._on_click(failure, lambda: self._show_episode(session.driving.next_failure()))

    def _add_plant(self) -> None:
        self._plant = {}
        for name, number in self._session.numbers.items():
            slider = self._gui.add_slider(
                number.title, number.low, number.high, number.step, number.start
            )
            self._on_change(slider, lambda value, name=name: self._set_plant(name, value))
            self._plant[name] = slider
        self._on_click(self._gui.add_button("As described"), self._restore_plant)

    def _add_disturbances(self) -> None:
        gui, disturbing, self._noise = self._gui, self._session.disturbing, {}
        for name, number in disturbing.numbers.items():
            slider = gui.add_slider(
                number.title, number.low, number.high, number.step, number.start
            )
            self._on_change(slider, lambda value, name=name: disturbing.set_noise(name, value))
            self._noise[name] = slider
        self._on_click(gui.add_button("Undisturbed"), self._clear_noise)
        most = disturbing.strongest
        force = gui.add_slider("force of a push [N]", 0.0, most, most / 100, disturbing.force)
        self._on_change(force, disturbing.set_force)
        for direction in DIRECTIONS:
            button = gui.add_button(f"Push tip, {direction}")
            self._on_click(button, lambda direction=direction: disturbing.push(direction))

    def _add_plots(self) -> None:
        session = self._session
        engines = [engine_title(engine) for engine in session.engines]
        cables = [f"cable {n + 1}" for n in range(session.robot.num_cables)]
        labels = {
            "tip to target [mm]": engines,
            "tension [N]": cables,
            "base: shift [mm], angle [mrad]": ["x", "y", "z", "angle"],
        }
        if not cables:
            del labels["tension [N]"]
        self._plots = [
            self._gui.add_uplot(
                tuple(np.zeros(1) for _ in range(len(names) + 1)),
                (
                    {"label": "t [s]"},
                    *(
                        {"label": name, "stroke": _COLORS[n % len(_COLORS)], "width": 1.5}
                        for n, name in enumerate(names)
                    ),
                ),
                scales={"x": {"time": False}},
                title=title,
                legend={"show": len(names) <= 4},
                height=150,
            )
            for title, names in labels.items()
        ]

    def _plot_values(self) -> list[list[Array]]:
        """Return the times and the series of each plot."""
        history = list(self._session.history)
        time = np.array([moment.time for moment in history])
        tension = np.array([moment.tension for moment in history]).T
        distance = 1e3 * np.array([moment.distance for moment in history]).T
        base = 1e3 * np.array([[*moment.base, moment.tilt] for moment in history]).T
        return [[time, *rows] for rows in (distance, tension, base) if len(rows)]

    def _show_numbers(self) -> None:
        session, driving = self._session, self._session.driving
        distances = [
            f"{engine_title(engine)}: **{1e3 * distance:.1f} mm** to the target"
            for engine, distance in zip(session.engines, session.history[-1].distance, strict=True)
        ]
        lines = [f"{session.time:.4f} s, {self._rate:.0f} updates/s", *distances]
        if len(session.engines) > 1:
            lines.append(f"tips: {1e3 * session.apart:.2f} mm apart")
        if driving.episodes:
            episode = driving.episodes[driving.chosen]
            outcome = "reached" if episode.success else "missed"
            lines.append(f"episode {driving.chosen + 1}: was {outcome}")
        if session.note:
            lines.append(f"**{session.note}**")
        text = "  \n".join(lines)
        if self._text.content != text:
            self._text.content = text
        self._play.label = "Pause" if session.playing else "Play"
        self._driver.value = driving.name
        if driving.name != HAND or self._fresh:
            self._fresh = False
            for pull, set_point in zip(self._pulls, driving.command, strict=True):
                pull.value = float(abs(set_point))
        if self._target is not session.target:
            self._target = session.target
            self._handle.position = session.target

    # What pages ask for. These run in the loop.

    def _turn(self) -> None:
        self._session.playing, self._session.note = not self._session.playing, ""

    def _reset(self) -> None:
        self._session.reset()
        self._fresh = True

    def _set_speed(self, speed: float) -> None:
        self._session.speed = speed

    def _next_target(self) -> None:
        self._session.new_target(self._session.seed + 1)
        self._seed.value = float(self._session.seed)

    def _drive(self, name: str) -> None:
        self._session.drive(name)

    def _show_episode(self, number: int) -> None:
        self._session.show(number)
        self._episode.value, self._fresh = number + 1.0, True

    def _set_plant(self, name: str, value: float) -> None:
        self._session.set_plant(name, value)

    def _restore_plant(self) -> None:
        for name, number in self._session.numbers.items():
            self._session.set_plant(name, number.start)
            self._plant[name].value = number.start

    def _clear_noise(self) -> None:
        for name, number in self._session.disturbing.numbers.items():
            self._session.disturbing.set_noise(name, number.start)
            self._noise[name].value = number.start

    def _drag(self, place: Array) -> None:
        """Move the target to where its handle was dragged."""
        try:
            self._session.move_target(place)
        except CdcsrError:
            self._handle.position = self._session.target
            raise
        self._target = self._session.target

    def _on_click(self, button: viser.GuiButtonHandle, action: Callable[[], None]) -> None:
        # Coroutines run in the order of the clicks; plain functions would run in many threads.
        async def click(_: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            self._ask(action)

        button.on_click(click)

    def _on_change(
        self, element: viser.GuiInputHandle[Value], action: Callable[[Value], None]
    ) -> None:
        """Let a page's change of a value ask for an action; a refused value goes back."""
        accepted = element.value

        def change(value: Value) -> None:
            nonlocal accepted
            try:
                action(value)
            except CdcsrError:
                element.value = accepted
                raise
            accepted = value

        async def ask(event: viser.GuiEvent[viser.GuiInputHandle[Value]]) -> None:
            if event.client is not None:  # else this program has set it
                value = event.target.value
                self._ask(lambda: change(value))

        element.on_update(ask)


def _whole(number: float) -> int:
    """Return a number from a page as a whole one.

    Raises:
        CdcsrError: it is none.
    """
    if not abs(number) < 2**53 or number % 1:
        raise CdcsrError(f"A whole number is needed here; found {number:g}.")
    return int(number)
