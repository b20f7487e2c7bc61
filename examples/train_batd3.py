"""Train BATD3 from ten demonstrations in MuJoCo, and compare it with its clone in PyBullet.

python examples/train_batd3.py runs/mine          the usual 9,000 updates, minutes on one core
python examples/train_batd3.py runs/quick 40      few, to see the parts work; it learns nothing
"""

import sys
from pathlib import Path

from controllers.jacobian import JacobianController
from training.measure.evaluation import evaluate
from training.policy import load_policy
from training.run.train_options import Train
from training.run.trainer import train

folder, updates = Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 9_000
quick = updates < 1_000
few = (("bc_updates", 100), ("bc_rollouts", 4), ("hidden", (32, 32)))
options = Train(
    out=folder,  # the same command resumes a run that was stopped
    algorithm="batd3",
    space="spatter",  # balls around the targets of the demonstrations
    updates=updates,
    changes=few if quick else (),  # any number of `training --algorithm batd3 --help-all`
    evaluate_episodes=10 if quick else 100,
)
policy = train(options)
clone = load_policy(folder / "clone")
for controller in (JacobianController(policy.robot), clone, policy):
    found = evaluate(controller, policy.robot, "pybullet", "spatter", options.evaluate_episodes)
    low, high = found.interval
    print(f"{controller.name}: {found.rate:.2f} [{low:.2f}, {high:.2f}] of held-out targets")
