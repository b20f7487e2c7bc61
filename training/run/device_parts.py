"""Make the parts of runs that learn side by side on one device."""

from __future__ import annotations

import gc
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import nn
from torch.nn import functional
from tqdm import tqdm

from cdcsr.errors import CdcsrError
from cdcsr.memory import check_memory
from cdcsr.simulation.arguments import MOST_COPIES
from cdcsr.simulation.contract import Simulation
from cdcsr.simulation.engines import load_backend, make_simulation
from cdcsr.simulation.randomization import Drawn, Randomization
from cdcsr.tasks.catalogue import actions_per_episode, make_task
from cdcsr.tasks.observation import observation_size
from cdcsr.tasks.spaces import Space, make_space, wider_targets
from cdcsr.tasks.starts import Starts
from training.algorithms.bc import pairs
from training.algorithms.registry import find_algorithm
from training.algorithms.td3 import BackboneNumbers
from training.config.learner import CloneStart, Cloning
from training.config.seeds import VALIDATION_SEED
from training.device.beginnings import PLANTS, draw_states
from training.device.collector import POOL, DeviceCollector, Work
from training.device.doors import open_door
from training.device.hindsight import HindsightReplay
from training.device.imitation import imitate
from training.device.learner import DeviceLearner, make_networks
from training.device.networks import copied, side_by_side, stacked_actor, write_actor
from training.device.replay import DeviceReplay
from training.device.trial import DeviceTrial
from training.networks.actor import Actor
from training.policy import load_policy
from training.run.device_first import first_rows
from training.run.setup import Setup
from training.run.train_options import FIRST, STATE

_CLONE, _START = 3, 4
"""Purposes of random numbers."""


class DeviceParts(NamedTuple):
    """The parts that learning changes, and networks on the processor to measure and keep."""

    learner: DeviceLearner
    simulation: Simulation
    trial: DeviceTrial
    """Measures on the validation targets, in an engine's copies of its own."""
    actors: list[Actor]
    """One for each run; the learner does not know them."""

    def close(self) -> None:
        """Release the engines."""
        self.simulation.close()
        self.trial.close()


class NotOnDevice(CdcsrError):
    """Report that a run asks for what only a processor can do."""


def check_device(setup: Setup, runs: int, device: torch.device) -> None:
    """Check that so many runs ask for nothing that only `--device cpu` can do, and that they fit.

    Raises:
        NotOnDevice: they do.
        CdcsrError: they do not fit into the device's memory.
    """
    config, learner = setup.config, setup.learner
    kind = find_algorithm(config.algorithm).learner
    if kind is None:
        return
    assert isinstance(learner, BackboneNumbers)
    task = make_task(config.task, setup.robot)
    actions = actions_per_episode(task.max_steps, setup.frame_skip)
    if learner.capacity < (least := learner.num_envs * (actions + 2)):
        raise CdcsrError(
            f"capacity must be at least {least} with device cuda, where every one of "
            f"{learner.num_envs} environments stores its last episode; found {learner.capacity}."
        )
    odd = kind.uses_clone or learner.symmetry or not task.ends or kind.reward != "sparse"
    if learner.hindsight and (odd or config.start != "still"):
        raise NotOnDevice(
            f"hindsight must be 0 with device cuda for algorithms with a clone or a dense reward, "
            f"with symmetry, for tasks that do not end and for starts that vary; found "
            f"{learner.hindsight}. Choose device cpu."
        )
    if learner.bfloat16:
        raise NotOnDevice("bfloat16 must be off with device cuda, which knows nothing else.")
    engine = load_backend(config.backend)
    for name, copies in (
        ("num_envs", learner.num_envs),
        ("evaluate_episodes", config.evaluate_episodes),
    ):
        if copies % (kinds := len(getattr(engine, "parts", [engine]))):
            raise CdcsrError(
                f"{name} must be a multiple of {kinds} with device cuda and {config.backend}, so "
                f"that each run has as many copies in each engine; found {copies}."
            )
        if runs * copies > MOST_COPIES:
            raise CdcsrError(
                f"{runs} seeds side by side have {runs * copies:,} copies with {name} {copies:,}, "
                f"and at most {MOST_COPIES:,} are possible; name fewer seeds, or lower {name}."
            )
    needed = DeviceReplay.memory(*_extent(setup, learner, runs))
    if hasattr(engine, "device_state"):  # its copies are there, too
        copies = learner.num_envs + config.evaluate_episodes + PLANTS * config.randomized
        needed += runs * copies * engine.copy_memory
    check_memory(
        f"{runs} replays of {learner.capacity:,} rows with their copies",
        needed,
        "lower --learner.capacity, or name fewer seeds",
        _free_memory(device),
    )


def _free_memory(device: torch.device) -> float | None:
    """Return how many bytes a GPU has free; None for a processor."""
    if device.type == "cpu":
        return None
    gc.collect()
    torch.cuda.empty_cache()  # what earlier runs of this process took and no longer need
    return float(torch.cuda.mem_get_info(device)[0])


def _extent(
    setup: Setup, learner: BackboneNumbers, runs: int
) -> tuple[tuple[int, int, int], tuple[int, int]]:
    """Return the shape of the replay, and the numbers of an observation and of an action."""
    shape = runs, learner.num_envs, learner.capacity // learner.num_envs
    return shape, (observation_size(setup.robot), setup.robot.num_cables)


def make_parts(setups: Sequence[Setup], device: torch.device) -> DeviceParts:
    """Make the parts of runs that differ in seeds, and in spaces with the same demonstrations; all
    have begun."""
    kind, learner = find_algorithm(setups[0].config.algorithm).learner, setups[0].learner
    assert kind is not None
    assert isinstance(learner, BackboneNumbers)
    robot, seeds = setups[0].robot, [setup.config.seed for setup in setups]
    shape, sizes = _extent(setups[0], learner, len(seeds))
    algorithms = []
    for setup in setups:  # each has the weights that it would have alone
        torch.manual_seed(setup.config.seed)
        algorithms.append(kind(setup.robot, learner, torch.Generator()))
    actors = [one.actor for one in algorithms]
    clones = make_clones(setups, device) if kind.uses_clone else None
    resumed = all((setup.config.out / STATE).exists() for setup in setups)
    if isinstance(learner, CloneStart) and learner.clone_start and not resumed:
        _imitate("actor", setups, actors, _START, device)
    # The environment says what the task is with its period.
    env = setups[0].environment(1, setups[0].config.space)
    work = Work(env.task, [_space(setup, learner) for setup in setups], env.frame_skip)
    env.close()
    kept = [
        first_rows(setup, actor, clone, work.task, learner)
        for setup, actor, clone in zip(setups, actors, clones or [None] * len(actors), strict=True)
    ]
    networks, module = make_networks(algorithms, learner, device), deepcopy(actors[0]).to(device)
    episodes = setups[0].config.evaluate_episodes
    simulation = make_simulation(robot, setups[0].config.backend, len(seeds) * learner.num_envs)
    rows = shape, sizes, env.max_actions, learner.discount, learner.return_steps, kept, device
    if learner.hindsight:
        replay = HindsightReplay(env.task, learner.hindsight, *rows)
    else:
        replay = DeviceReplay(*rows)
    door = open_door(simulation, device)
    states = draw_states(Starts(setups[0].config.start, robot), seeds, POOL)
    plants = [_plants(setup) for setup in setups if setup.config.randomized]
    pools = replay, device, states, plants
    collector = DeviceCollector(door, work, learner, seeds, module, *pools)
    cloned = None if clones is None else side_by_side([stacked_actor(x) for x in clones], device)
    collector.start(networks.actor, None if cloned is None else copied(cloned))
    shown = None
    if kind.uses_demonstrations:
        seen, wanted = pairs(actors[0], *setups[0].pairs())
        shown = seen.to(device), wanted.to(device)
    parts = DeviceLearner(
        learner, networks, collector, replay, module.encoder, shown, seeds, device
    )
    exam = make_simulation(robot, setups[0].config.backend, len(seeds) * episodes)
    spaces = [make_space(setup.config.space, robot, setup.centers) for setup in setups]
    starts = Starts(setups[0].config.start, robot, VALIDATION_SEED)
    judged = replace(work, spaces=spaces), VALIDATION_SEED, module, device, starts
    trial = DeviceTrial(open_door(exam, device), *judged)
    return DeviceParts(parts, simulation, trial, actors)


def make_clones(setups: Sequence[Setup], device: torch.device) -> list[Actor]:
    """Train the behaviour clones or, if that is done, read them back."""
    learner = setups[0].learner
    folders = [setup.config.out / "clone" for setup in setups]
    missing = [
        setup
        for setup, folder in zip(setups, folders, strict=True)
        if not (folder / "policy.json").is_file()
    ]
    clones, error = [], learner.features == "state+error"
    for setup in missing:
        torch.manual_seed(setup.config.seed)
        clones.append(Actor(setup.robot, error, learner.hidden, "tanh", learner.symmetry))
    if missing:
        _imitate("clone", missing, clones, _CLONE, device)
    for setup, clone in zip(missing, clones, strict=True):
        (setup.config.out / FIRST).unlink(missing_ok=True)  # it was of a clone that is gone
        setup.policy(clone, "bc").save(setup.config.out / "clone")
    return [load_policy(folder).actor for folder in folders]


def _imitate(
    what: str,
    setups: Sequence[Setup],
    actors: Sequence[Actor],
    purpose: int,
    device: torch.device,
) -> None:
    """Train actors to do as the demonstrator does, and show the progress."""
    learner = setups[0].learner
    assert isinstance(learner, Cloning)
    layers = side_by_side([stacked_actor(actor) for actor in actors], device)
    hidden = torch.tanh if isinstance(actors[0].net[1], nn.Tanh) else functional.relu
    seen, wanted = pairs(actors[0], *setups[0].pairs())
    shown, seeds = (seen.to(device), wanted.to(device)), [setup.config.seed for setup in setups]
    with tqdm(total=learner.bc_updates, desc=what, unit="update", disable=None) as bar:

        def progress(update: int, loss: float) -> None:
            bar.update(update - bar.n)
            bar.set_postfix(loss=f"{loss:.2g}")

        imitate(layers, hidden, learner, shown, seeds, purpose, progress)
    for run, actor in enumerate(actors):
        write_actor(layers, run, actor)


def _plants(setup: Setup) -> Drawn:
    """Draw the pool of a run's plants, with the generator that they have on a processor too."""
    config, rng = setup.config, np.random.default_rng(setup.config.seed).spawn(4)[3]
    return Randomization(setup.robot, 1, config.randomize, rng, config.soften).draw(PLANTS)


def _space(setup: Setup, learner: BackboneNumbers) -> Space:
    """Return where the targets of training lie."""
    space = make_space(setup.config.space, setup.robot, setup.centers)
    return wider_targets(space, learner.practice, setup.robot) if learner.practice else space
