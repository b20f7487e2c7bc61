"""Kill commands at any moment, and let any of their writing calls fail: what was finished stays,
the same command ends as if nothing had happened, and nothing hidden is left."""

from __future__ import annotations

import json
import re
import shutil
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from backends.cosserat import statics
from backends.parity import report as parity_report
from cdcsr.files import finish_together, read_json
from cdcsr.robot.description import load_robot
from cdcsr.tasks.workspace_map import Workspace
from controllers import workspace as mapping
from controllers.demonstrations import digest, load
from tests.support.forked import Fault, Outcome, forked
from tests.support.rods import write_shapes
from tests.support.small_study import small_study
from tests.support.tiny import Options, tiny_changes, tiny_job
from training.commands import doctor as doctoring
from training.commands import new_robot as making
from training.commands.build_model import build_model
from training.commands.demonstrate import demonstrate
from training.commands.evaluate import evaluate
from training.commands.new_robot import new_robot
from training.commands.parity import parity
from training.commands.sweep import sweep
from training.commands.transfer import transfer
from training.commands.validate import validate
from training.commands.workspace import workspace
from training.experiments import experiments
from training.measure import plant_sweep, trajectories
from training.report import report
from training.run.metrics import read_metrics
from training.run.train_options import Train
from training.run.trainer import train
from training.study.execute import evaluations, jobs
from training.study.store import read_results

ROBOT = load_robot("planar-single")
Command = Callable[[Path], object]
MEASURED: Options = {"robot": ROBOT.name, "backend": "mujoco", "space": "anchor", "episodes": 1}
_TIMED = ("minutes", "updates_per_second")


def _train(folder: Path) -> None:
    run = Train(
        out=folder / "out",
        demonstrations=folder.parent / "set",
        robot="planar-single",
        algorithm="batd3",
        changes=tiny_changes("batd3", bc_updates=20),
        frame_skip=10,
        updates=30,
        evaluate_every=10,
        evaluate_episodes=1,
    )
    train(run)


def _trained(folder: Path) -> object:
    rows = read_metrics(folder / "out" / "metrics.csv")
    kept = [{key: x for key, x in row.items() if key not in _TIMED} for row in rows]
    assert read_json(folder / "out" / "summary.json")["updates"] == 30
    assert not (folder / "out" / "state.safetensors").exists()
    return (folder / "out" / "policy.safetensors").read_bytes(), kept


def _demonstrate(folder: Path) -> None:
    demonstrate(out=folder / "out", episodes=1, frame_skip=10, robot="planar-single", force=True)


def _demonstrated(folder: Path) -> object:
    return digest(load(folder / "out", ROBOT.fingerprint, 10))


def _workspace(folder: Path) -> None:
    workspace("planar-single", out=folder / "out" / "map.npz", spacing=0.2, frame_skip=25)


def _mapped(folder: Path) -> object:
    return (folder / "out" / "map.npz").read_bytes()


def _report(folder: Path) -> None:
    report(results=folder.parent / "study", out=folder / "out")


def _reported(folder: Path) -> object:
    return {path.name: path.read_bytes() for path in (folder / "out").iterdir()}


def _job(folder: Path) -> None:
    job = tiny_job(updates=20)
    jobs.carry_out(job, folder / "runs", folder / "out")


def _measured(folder: Path) -> object:
    (run,) = read_results(folder / "out").values()
    record = {key: x for key, x in run.record.items() if key not in ("minutes", "commit")}
    curve = {key: x.tolist() for key, x in run.metrics.items() if key not in _TIMED}
    return record, json.dumps(curve), run.evaluations["nominal"]["distance"].tolist()


def _pack(folder: Path) -> None:
    experiments(results=folder.parent / "study", store=folder / "out", pack=True)


def _packed(folder: Path) -> object:
    finish_together(folder / "out")  # as whoever reads a store does
    return {path.name: path.read_bytes() for path in (folder / "out").iterdir()}


def _files(folder: Path) -> object:
    """Return the content of all files."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def _evaluate(folder: Path) -> None:
    evaluate("jacobian", **MEASURED, json=folder / "a.json", plot=folder / "a.png")


def _transfer(folder: Path) -> None:
    transfer(["jacobian"], **MEASURED, json=folder / "a.json", plot=folder / "a.png")


def _sweep(folder: Path) -> None:
    sweep("jacobian", **MEASURED, axis=("link_mass",), json=folder / "a.json", csv=folder / "a.csv")


def _parity(folder: Path) -> None:
    outputs: Options = {"json": folder / "a.json", "plot": folder / "a.png"}
    parity(ROBOT.name, backend="mujoco-stock", episodes=1, **outputs)


def _validate(folder: Path) -> None:
    outputs: Options = {"json": folder / "a.json", "plot": folder / "a.png"}
    validate("cosserat", folder.parent / "rods", material="tpu", links=(12, 25), **outputs)


def _build_model(folder: Path) -> None:
    build_model(ROBOT.name, out=folder / "out", force=True, json=folder / "a.json")


def _new_robot(folder: Path) -> None:
    if not (folder / "a.toml").exists():  # it replaces none
        new_robot("mine", out=folder / "a.toml")


def _doctor(folder: Path) -> None:
    doctoring.doctor(json=folder / "a.json")


COMMANDS: dict[str, tuple[Command, Command]] = {
    "training": (_train, _trained),
    "demonstrate": (_demonstrate, _demonstrated),
    "experiments": (_job, _measured),
    "workspace": (_workspace, _mapped),
    "report": (_report, _reported),
    "pack": (_pack, _packed),
}
WRITERS: dict[str, tuple[Command, Command]] = {
    "doctor": (_doctor, _files),
    "new-robot": (_new_robot, _files),
    "build-model": (_build_model, _files),
    "evaluate": (_evaluate, _files),
    "transfer": (_transfer, _files),
    "sweep": (_sweep, _files),
    "parity": (_parity, _files),
    "validate": (_validate, _files),
}
"""Commands that write at their very end; all are done anew if they are run again."""
ALL = COMMANDS | WRITERS


def once(function: Callable[..., object]) -> Callable[..., object]:
    """Return a function that remembers its results, also in processes that are forked later."""
    results: dict[str, object] = {}

    def remembered(*arguments: object, **options: object) -> object:
        key = re.sub(" at 0x[0-9a-f]+", "", repr((arguments, options)))
        if key not in results:
            results[key] = function(*arguments, **options)
        return results[key]

    return remembered


class Place:
    """A folder with all that the commands need, and what each makes if it is left alone."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        demonstrate(out=folder / "set", episodes=2, frame_skip=10, robot="planar-single")
        small_study(folder / "study")
        write_shapes(folder / "rods", [0.5])
        self.calls: dict[str, int] = {}
        self.seconds: dict[str, float] = {}
        self.expected: dict[str, object] = {}
        self.sizes: dict[str, list[int]] = {}

    def prepare(self, name: str) -> None:
        """Let a command run undisturbed, unless it has."""
        if name in self.calls:
            return
        command, read = ALL[name]
        whole = self.folder / f"whole-{name}"
        command(whole)  # here: what is loaded and compiled is then there in every child
        shutil.rmtree(whole)
        begun = time.monotonic()
        outcome = forked(lambda: command(whole), whole)
        assert (outcome.code, outcome.errors) == (0, [])
        self.seconds[name] = time.monotonic() - begun
        self.calls[name], self.expected[name] = outcome.calls, read(whole)
        print(f"{name}: {outcome.calls} calls, {self.seconds[name]:.1f} s")
        files = [path for path in whole.rglob("*") if path.is_file()]
        self.sizes[name] = sorted({path.stat().st_size for path in files})

    def disturbed(self, name: str, fault: Fault, old: bool) -> Outcome:
        """Let a fault happen to a command, then run it again, and check what is there.

        Args:
            name: the command.
            fault: the fault.
            old: the command has been finished there before.
        """
        command, read = ALL[name]
        folder = self.folder / "place"
        shutil.rmtree(folder, ignore_errors=True)
        if old:
            shutil.copytree(self.folder / f"whole-{name}", folder)
        outcome = forked(lambda: command(folder), folder, fault)
        # A folder that vanishes between two files takes the first of them along; one that vanishes
        # with the last writing call, of a command that found its work done, is missed by none.
        missed = name not in COMMANDS or fault.at >= outcome.calls
        done = outcome.code == 0 and not (fault.kind == "vanished" and missed)
        if done or (old and fault.kind in ("full", "read-only", "size")):
            assert read(folder) == self.expected[name], "finished work is not intact"
        again = forked(lambda: command(folder), folder)
        assert (again.code, again.errors) == (0, [])
        assert read(folder) == self.expected[name]
        hidden = [path for path in folder.rglob(".*") if path.name != ".cdcsr"]
        assert hidden == [], "something hidden is left"
        return outcome


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    torch.set_num_threads(1)
    whole = evaluations.EVALUATIONS["nominal"]

    def measure(subject: evaluations.Subject, _: int) -> list[evaluations.Row]:
        result = evaluations.evaluate(
            subject.controller, subject.robot, "mujoco", "anchor", 2, **subject.options
        )
        return list(evaluations.episode_rows("mujoco", "anchor", "nominal", 0, result))

    index = np.array([[0, 0, 0], [0, 0, 1]], dtype=np.int16)
    corner, edges = np.array(ROBOT.workspace.center), np.array([0.2, 0.0, 0.2])
    reached = Workspace(ROBOT.fingerprint, corner, edges, index, ROBOT.to_toml())
    with pytest.MonkeyPatch.context() as patch:  # what is simulated, but not what is written
        patch.setattr(mapping, "compute_workspace", lambda *_: reached)
        quick = evaluations.Evaluation(whole.columns, measure)  # type: ignore[arg-type]
        patch.setitem(evaluations.EVALUATIONS, "nominal", quick)
        patch.setattr(making, "_reached_corners", lambda _: 9)
        patch.setattr(making, "_reached_in_spatter", lambda _: 400)
        for name in ("_packages", "_engines", "_rendering", "_machine"):
            patch.setattr(doctoring, name, lambda: iter(()))
        for module, name in (
            *((plant_sweep, "sweep"), (parity_report, "measure")),
            *((trajectories, "demonstrator_commands"), (statics, "fit"), (statics, "order")),
        ):
            patch.setattr(module, name, once(getattr(module, name)))
        yield Place(tmp_path_factory.mktemp("place"))


@pytest.mark.parametrize(
    "times", [6, pytest.param(100, marks=pytest.mark.slow)], ids=["fast", "full"]
)
def test_a_killed_command_ends_as_if_it_had_not_been(place: Place, times: int) -> None:
    rng, found = np.random.default_rng(times), Counter[str]()
    for trial in range(times):
        name = [*COMMANDS][trial % len(COMMANDS)]
        place.prepare(name)
        if rng.random() < 0.5:  # at a writing call, where most can go wrong
            fault = Fault("kill", int(rng.integers(1, place.calls[name] + 1)))
        else:
            fault = Fault("late", float(rng.uniform(0.0, place.seconds[name])))
        outcome = place.disturbed(name, fault, old=False)
        assert outcome.code in (-9, 0), outcome
        found[f"{name}: {'killed' if outcome.code else 'ended before'}"] += 1
    print(*sorted(found.items()), sep="\n")


@pytest.mark.parametrize(
    ("name", "most"),
    [
        *((name, 1) for name in [*COMMANDS, "doctor", "new-robot"]),
        *(pytest.param(name, 60, marks=pytest.mark.slow) for name in ALL),
    ],
)
def test_a_disk_that_is_full_costs_one_line_and_nothing_that_was_finished(
    place: Place, name: str, most: int
) -> None:
    place.prepare(name)
    faults = [Fault("full", at) for at in range(1, place.calls[name] + 1)]
    faults += [Fault("size", size - 1) for size in place.sizes[name] if size]
    faults += [Fault("read-only", 1), Fault("vanished", 3), Fault("vanished", 6)]
    found, rng = Counter[str](), np.random.default_rng(most)
    for number in rng.permutation(len(faults))[:most]:
        fault = faults[number]
        outcome = place.disturbed(name, fault, old=bool(rng.random() < 0.5))
        text = "\n".join(outcome.errors)
        assert "Traceback" not in text, text
        if outcome.code:
            assert outcome.code == 2, (fault, outcome)
            assert len(outcome.errors) == 1, text
        found["refused" if outcome.code else "not needed"] += 1
    print(name, *sorted(found.items()))
