"""What a training run is: its task, its algorithm, and the numbers of the learner."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal

from training.config.ranges import refuse_out_of_range

AlgorithmName = Literal[
    "bc",
    "td3",
    "her",
    "td3wd",
    "rbl",
    "rlpd",
    "drldr",
    "batd3",
    "batd3-no-bc",
    "batd3-no-prefill",
    "batd3-no-ensemble",
    "clasp",
]
PresetName = Literal["paper", "tuned"]


@dataclass(frozen=True)
class Learner:
    """The numbers of the learner. Defaults are the paper's (section V-A.3), or TD3's own where it is silent."""

    features: Literal["state", "state+error"] = "state"
    """Network input: the scaled eq. (1), or that and the scaled vector from tip to target."""
    symmetry: bool = False
    """See every situation as that of its mirror images, under which the robot is itself, whose target lies in a part of
    the space: one quarter of it, for arms like the paper's. What is learned there then holds everywhere."""
    practice: float = 0.0
    """Half of the targets that are practised on are up to this far, in [m], from where the space has them, so that what
    is learned does not end where the space does. Demonstrations and measurements stay in the space; some of the targets
    are out of reach, so success while training says less."""
    hidden: tuple[int, ...] = (256, 256, 256)
    """Width of the hidden layers of every network."""
    layer_norm: bool = False
    """LayerNorm before each hidden activation of the critics."""
    learning_rate: float = 1e-4
    """Of actor and critics (Adam)."""
    final_learning_rate: float = 1.0
    """Part of it that is left at the end of the run, to which it falls linearly."""
    batch_size: int = 256
    discount: float = 0.99
    """gamma, per action."""
    step_cost: float = 0.0
    """Taken from the reward of each action. With gamma = 1 the value of a state from which T actions are needed is
    1 - T step_cost: no less sparse, but as steep far from the target as near it."""
    return_steps: int = 1
    """n of the n-step return; it bootstraps through time limits."""
    soft_update: float = 0.01
    """beta: how fast target networks follow."""
    critics: int = 5
    """E, the size of the ensemble."""
    target_critics: int = 2
    """Z, how many critics drawn at random give a target; it takes their minimum."""
    target_noise: float = 0.2
    """Standard deviation of the noise on the target policy's action, which spans [-1, 1]."""
    noise_clip: float = 0.3
    """c: that noise is clipped to [-c, c]."""
    softmax_temperature: float = 10.0
    """rho of eq. (6)."""
    target_choice: Literal["softmax", "scaled", "hard"] = "softmax"
    """Between the clone's action and the policy's in BATD3's target. softmax: eq. (6). scaled: eq. (6) with the two
    values' difference in units of its own standard deviation over the batch. hard: the action of the higher value."""
    clip_targets: bool = False
    """Clip targets to [0, 1], where a sparse reward's values lie."""
    saturation_penalty: float = 0.0
    """Weight in the actor's loss of (|z| - 3)^2 where its output tanh(z) is saturated, |z| > 3. Good commands here
    are nearly on and off; without it, a cable that is off early on may never get a gradient again."""
    clone_start: bool = False
    """The actor starts from behaviour cloning instead of from random weights."""
    clone_anchor: float = 0.0
    """w: weight in the actor's loss of its squared distance from the clone's action, falling linearly."""
    anchor_updates: int = 4_000
    """Updates in which that weight falls."""
    anchor_floor: float = 0.0
    """What it falls to."""
    self_imitation: float = 0.0
    """Weight in the actor's loss of its squared distance from actions after which an episode went better than a
    critic expects of the actor, times by how much."""
    scaled_values: bool = False
    """Divide the values in the actor's loss by their mean magnitude in the batch (Fujimoto and Gu 2021, eq. 5)."""
    hindsight: int = 0
    """Copies of each collected episode that are stored with a target it did reach, up to where it did (Andrychowicz et
    al. 2017): every transition's target is from its own future, but those late in an episode are in fewer copies."""
    kept_share: float = 0.0
    """Share of each batch that is drawn from kept episodes: those the replay buffer begins with."""
    keep_successes: bool = False
    """Successful episodes are kept too, as they are collected."""
    policy_delay: int = 2
    """Updates of the critics to one of the actor."""
    averaged_policy: bool = False
    """The policy that is measured and kept is the target actor, a running average of the actor, which wanders less."""
    num_envs: int = 1
    """Environments that are stepped side by side."""
    updates_per_step: int = 1
    """Updates after each step of the environments."""
    exploration_noise: float = 0.1
    """Standard deviation of exploration noise on the action, which spans [-1, 1]."""
    noise_ladder: bool = False
    """Environments differ in that deviation: it goes evenly from zero to twice what it says."""
    noise_hold: int = 1
    """Actions for which one draw of exploration noise is held."""
    bfloat16: bool = False
    """The matrix products of an update take their factors in bfloat16, and sum in float32, for which the processor must
    have instructions (AMX): an update then takes about two thirds of the time."""
    updates: int = 100_000
    """Length of the run in updates."""
    capacity: int = 1_000_000
    """Rows of the replay buffer."""
    bc_updates: int = 10_000
    """Updates of the behaviour clone."""
    bc_learning_rate: float = 1e-4
    """Of the behaviour clone (Adam)."""
    bc_rollouts: int = 100
    """Episodes of the behaviour clone whose successes pre-fill the replay buffer."""

    def differences(self, other: Learner) -> dict[str, Any]:
        """The numbers that are not the same in another learner, in the order of their names."""
        now = {
            name: getattr(self, name) for name in sorted(number.name for number in fields(Learner))
        }
        return {name: value for name, value in now.items() if value != getattr(other, name)}


PRESETS: dict[PresetName, Learner] = {
    "paper": Learner(),
    "tuned": Learner(
        features="state+error",
        layer_norm=True,
        learning_rate=6e-4,
        return_steps=20,
        critics=2,
        clip_targets=True,
        saturation_penalty=0.01,
        averaged_policy=True,
        num_envs=64,
        exploration_noise=0.2,
        noise_hold=10,
        updates=12_000,
        bc_updates=3_000,
        bc_learning_rate=1e-3,
    ),
}


OWN: dict[str, dict[PresetName, dict[str, Any]]] = {
    "her": {"paper": {"hindsight": 4}, "tuned": {"hindsight": 4}},
    # Ball et al. 2023: half of every batch from prior data, LayerNorm, many updates for each step. As a run's length is
    # in updates, many for each step are little experience: in `tuned` it has as much of it as everybody.
    "rlpd": {
        "paper": {
            "kept_share": 0.5,
            "layer_norm": True,
            "updates_per_step": 20,
            "policy_delay": 20,
        },
        "tuned": {"kept_share": 0.5},
    },
    # Of five critics TD3's two are left, and of the tuned preset's two one.
    "batd3-no-ensemble": {"paper": {"critics": 2}, "tuned": {"critics": 1, "target_critics": 1}},
    "clasp": {
        preset: {
            "clone_start": True,
            "clone_anchor": 0.7,
            "anchor_updates": 2_000,
            "self_imitation": 10.0,
        }
        for preset in ("paper", "tuned")
    },
}
"""What an algorithm's learner has of its own in each preset."""


TASK_OWN: dict[tuple[str, str], dict[str, Any]] = {
    # Twice as long as reaching, and an arm that is shaken as exploration shakes it hardly ever comes to rest.
    ("clasp", "capture"): {"discount": 0.997, "noise_ladder": True},
    # Let go of, it loses the target and never learns to stay on it.
    ("clasp", "follow"): {"noise_ladder": True, "anchor_floor": 0.7},
}
"""What an algorithm has of its own in the preset `tuned` for a kind of task that is not reaching.

The other methods keep the preset's numbers; what they do with these is measured in the experiment `harder`."""


def learner_for(algorithm: str, preset: PresetName, task: str = "reach") -> Learner:
    """The numbers of a preset, with what the algorithm has of its own, and of its own for the task if it is tuned."""
    own = OWN.get(algorithm, {}).get(preset, {})
    tuned = TASK_OWN.get((algorithm, task.partition("-")[0]), {}) if preset == "tuned" else {}
    return replace(PRESETS[preset], **own, **tuned)


def in_a_name(value: Any) -> str:
    """A number of the learner, in a name."""
    if isinstance(value, tuple):
        return "x".join(in_a_name(item) for item in value)
    return f"{value:g}" if isinstance(value, float) else str(value).lower()


CLONES = ("batch_size", "bc_learning_rate", "bc_updates", "features", "hidden", "symmetry")
"""Numbers of the learner that a behaviour clone depends on."""
_UNSET = Learner()
"""Stands for a learner that is not given: this object, not one equal to it."""


@dataclass(frozen=True)
class Train:
    """Train a policy: BATD3, what it is compared with, or CLASP."""

    out: Path
    """Folder of the run. Give the folder of an interrupted run, with the same options, to resume it."""
    algorithm: AlgorithmName = "batd3"
    """What learns."""
    preset: PresetName = "tuned"
    """Where the learner's numbers come from; any of them can be set with --learner.NAME."""
    backend: str = "mujoco"
    """The engine to train in."""
    robot: str = "paper"
    """A shipped robot's name, or a path ending in .toml."""
    space: str = "anchor"
    """Where targets are drawn: anchor, floating, spatter, workspace, or a map made by `cdcsr workspace`."""
    task: str = "reach"
    """What is to be done: reach, precise, quiet, capture, capture-drift, capture-tumble, follow-line, ..."""
    frame_skip: int = 1
    """Simulation steps each action is held for."""
    randomize: float = 0.0
    """Domain randomization: every episode of learning is on a plant of its own. 1 draws from the ranges of
    `cdcsr.simulation.randomization`, 0 is off. Demonstrations, the clone and its episodes are on the description's plant."""
    demonstrations: Path | None = None
    """A dataset made by `cdcsr demonstrate`; by default they are recorded in the engine, seed 0."""
    num_demonstrations: int = 10
    """How many are recorded if no dataset is given."""
    seed: int = 0
    """Of everything random in the run but the demonstrations."""
    evaluate_every: int = 1_000
    """Updates between evaluations on validation targets and checkpoints; 0 for none before the end."""
    evaluate_episodes: int = 100
    """Episodes of each evaluation."""
    stop_after: float | None = None
    """Stop, resumable, after this many minutes."""
    force: bool = False
    """Start anew in a folder that holds a run already."""
    json: Path | None = None
    """Also write the summary to this file."""
    learner: Learner = field(default_factory=lambda: _UNSET)
    """By default that of the algorithm, the preset and the task, :func:`learner_for`."""

    def __post_init__(self) -> None:
        if self.learner is _UNSET:
            object.__setattr__(self, "learner", learner_for(self.algorithm, self.preset, self.task))
        refuse_out_of_range(self)

    @classmethod
    def defaults(cls, argv: Sequence[str]) -> Train:
        """The values of options not given in `argv`: they depend on the preset, the algorithm and the task that are."""
        import tyro

        preset: PresetName = "paper" if _option(argv, "--preset") == "paper" else "tuned"
        learner = learner_for(
            _option(argv, "--algorithm") or "batd3", preset, _option(argv, "--task") or "reach"
        )
        return cls(out=tyro.MISSING, preset=preset, learner=learner)

    def run(self) -> None:
        """Carry it out."""
        from training.run.trainer import train

        train(self)

    def policy_name(self, algorithm: str) -> str:
        """Of the policy, or of the run's clone: method, preset, where it learned, what is changed in the learner.

        Args:
            algorithm: what learned the policy: the run's, or "bc".
        """
        where = self.space if self.task == "reach" else f"{self.task}-{self.space}"
        parts = [algorithm, self.preset, where, self.backend, f"s{self.seed}"]
        changes = [f"{name}={in_a_name(value)}" for name, value in self.changes(algorithm).items()]
        return "-".join((*parts, *changes))

    def changes(self, algorithm: str) -> dict[str, Any]:
        """Numbers of the learner that are not what the algorithm has of its own, in the order of their names.

        Without the number of updates, which is part of every policy's card.

        Args:
            algorithm: the run's, or "bc" for its clone, which most numbers do not touch.
        """
        own = learner_for(self.algorithm, self.preset, self.task)
        found = self.learner.differences(own)
        names = CLONES if algorithm == "bc" else found.keys() - {"updates"}
        return {name: value for name, value in found.items() if name in names}

    def identity(self) -> dict[str, Any]:
        """What must be the same for a run to be resumed."""
        data = asdict(self)
        for name in ("out", "stop_after", "force", "json", "evaluate_every", "evaluate_episodes"):
            del data[name]
        data["demonstrations"] = None if self.demonstrations is None else str(self.demonstrations)
        if not self.randomize:
            del data["randomize"]  # runs from before it existed go on
        data["learner"]["hidden"] = list(self.learner.hidden)
        return data


def _option(argv: Sequence[str], name: str) -> str | None:
    for i in range(len(argv) - 1, -1, -1):  # of a repeated option the last counts
        if argv[i] == name and i + 1 < len(argv):
            return argv[i + 1]
        if argv[i].startswith(name + "="):
            return argv[i].split("=", 1)[1]
    return None
