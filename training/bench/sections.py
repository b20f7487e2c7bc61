"""What `cdcsr bench` measures and prints: ratios, each beside the machine's own floor."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.files import write_json
from cdcsr.robot.description import Robot, load_robot
from cdcsr.simulation.benchmarks import Section, engine_sections
from cdcsr.simulation.engines import backend_names, engine_title
from training.bench.arms import arms
from training.bench.growth_plot import growth_picture
from training.bench.scaling import growth, memory_per_copy
from training.bench.trainer_speed import OWN, side_by_side, update_speed
from training.measure.trajectories import demonstrator_commands
from training.plots.style import algorithm_title

_EPISODES, _SEED = 8, 500


class Benchmarks:
    """Measures section by section, prints as it goes, and keeps the numbers.

    Args:
        peers: an interpreter that has what is compared with and need not be here.
        plot: folder for figures; None for none.
    """

    def __init__(self, peers: str | None = None, plot: Path | None = None) -> None:
        self.results: dict[str, Any] = {}
        self._peers, self._plot = peers or sys.executable, plot
        self._robot: Robot = load_robot("paper")

    def run(self, sections: Sequence[str], json: Path | None = None) -> None:
        """Measure some sections, or all if none is named; write the numbers to `json` as well.

        Raises:
            CdcsrError: there is no section of that name.
        """
        measures = self.sections()
        for section in sections:
            if section not in measures:
                raise CdcsrError(unknown_choice("section", section, measures))
        for section in sections or measures:
            print(f"{section}:", flush=True)
            measures[section]()
        if json is not None:
            write_json(json, self.results)

    def sections(self) -> dict[str, Callable[[], None]]:
        """Return what measures each section: those that each engine brings, then the common ones."""
        own = {name: partial(self._engine, load) for name, load in engine_sections().items()}
        return own | {
            "memory": self._memory,
            "growth": self._growth,
            "arms": self._arms,
            "trainer": self._trainer,
        }

    def _row(self, name: str, value: float | None, what: str, floor: str = "") -> None:
        number = "     -" if value is None else f"{value:6.2f}"
        print(f"{number}  {what}" + (f" [{floor}]" if floor else ""), flush=True)
        self.results[name] = value

    def _engine(self, load: Callable[[], Section]) -> None:
        commands = demonstrator_commands(self._robot, "mujoco", _EPISODES, _SEED)
        for measured in load()(self._robot, commands.values):
            self._row(measured.name, measured.value, measured.what, measured.floor)
            for line in measured.lines:
                print(f"        {line}", flush=True)
            self.results |= measured.details

    def _memory(self) -> None:
        for backend in backend_names():
            what = f"{engine_title(backend)}: MB of peak memory for each further copy"
            self._row(f"memory_{backend}", memory_per_copy(self._robot, backend), what)

    def _growth(self) -> None:
        measured = {}
        for backend in backend_names():
            cost = measured[backend] = growth(self._robot, backend)
            for of, exponent, us in (
                ("links, 6 to 48", cost.links_exponent, cost.links),
                ("segments, 1 to 4, twelve links", cost.segments_exponent, cost.segments),
            ):
                floor = ", ".join(f"{size}: {value:.0f} us" for size, value in us.items())
                name = f"growth_{backend}_{of.partition(',')[0]}"
                self._row(name, exponent, f"{backend}: exponent of a step's cost in {of}", floor)
            self.results[f"growth_{backend}"] = asdict(cost)
        if self._plot is not None:
            growth_picture(measured, self._plot / "growth.png")
            print(f"        drawn to {self._plot / 'growth.png'}")

    def _arms(self) -> None:
        print("        physics steps/s   simulated s/s   (one processor, one copy)")
        rows = arms(self._robot, self._peers)
        for arm in rows:
            speed, simulated = arm.steps_per_second, arm.simulated_seconds_per_second
            numbers = (
                f"{'-':>15}   {'-':>13}" if speed is None else f"{speed:15,.0f}   {simulated:13.2f}"
            )
            print(f"        {numbers}   {arm.name}: {arm.what}", flush=True)
        self.results["arms"] = [asdict(arm) for arm in rows]

    def _trainer(self) -> None:
        try:
            speed = update_speed(self._peers)
        except ModuleNotFoundError as error:
            raise CdcsrError(
                f"{error.name} is needed to compare with; install the development dependencies."
            ) from None
        sbx = speed["sbx_updates_per_second"]
        jax = "pip install sbx-rl, here or for --peers" if sbx is None else f"{sbx:.1f} updates/s"
        product, others = (
            f"{speed[name]:.0f}"
            for name in ("product_gflops", "stable_baselines3_updates_per_second")
        )
        product, others = f"256 x 256 product: {product} GFLOP/s", f"{others} updates/s"
        for kind, ours in (("", speed), ("_bfloat16", speed["bfloat16"])):
            if ours is None:
                print("     -  with products in bfloat16: no faster on this processor")
                continue
            size, theirs = (
                "E = 5, 3 x 256, batch 256" + (", bfloat16" if kind else ""),
                " in float32" if kind else "",
            )
            what = f"BATD3 updates/s ({size}) over those at the rate of a product{theirs}"
            self._row(f"update_share{kind}", ours["share_of_product_rate"], what, product)
            for name in OWN:
                over = f"{algorithm_title(name)} updates/s ({size}) over"
                what = f"{over} stable-baselines3's TD3{theirs}, five critics"
                self._row(f"update_sb3_{name}{kind}", ours["ratio"][name], what, others)
                what = f"{over} SBX's TD3 (JAX){theirs}, five critics"
                self._row(f"update_sbx_{name}{kind}", ours["sbx_ratio"][name], what, jax)
        if (alike := speed["bfloat16"]) is not None:
            what = "BATD3 updates/s (the same, bfloat16) over those at the rate of a product in bfloat16"
            floor = f"256 x 256 product: {alike['product_gflops']:.0f} GFLOP/s"
            self._row(
                "update_share_bfloat16_alike", alike["share_of_own_product_rate"], what, floor
            )
            floor = f"{alike['stable_baselines3_updates_per_second']:.0f} updates/s"
            for name, ratio in alike["like_for_like"].items():
                what = f"{algorithm_title(name)} updates/s (the same, bfloat16) over stable-baselines3's in bfloat16"
                self._row(f"update_sb3_{name}_bfloat16_alike", ratio, what, floor)
        self.results["update"] = speed
        self._row(
            "side_by_side",
            side_by_side(),
            "speed of a run's updates with another run beside it over alone",
        )
