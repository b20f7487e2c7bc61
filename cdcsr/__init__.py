"""Cable-driven continuum space robots: one description, any engine, and tasks.

Importing this package registers the environments `cdcsr/Reach-v0`, `cdcsr/Capture-v0`,
`cdcsr/Follow-v0` and `cdcsr/ReachGoal-v0` with Gymnasium.
"""

import gymnasium

for _id, _task in (("Reach", "reach"), ("Capture", "capture"), ("Follow", "follow-line")):
    gymnasium.register(
        f"cdcsr/{_id}-v0",
        entry_point="cdcsr.envs.single_env:TaskEnv",
        vector_entry_point="cdcsr.envs.gym_env:TaskVectorEnv",
        kwargs={"task": _task},
    )

gymnasium.register(
    "cdcsr/ReachGoal-v0",
    entry_point="cdcsr.envs.goal_env:GoalEnv",
    vector_entry_point="cdcsr.envs.goal_env:GoalVectorEnv",
    kwargs={"task": "reach"},
)
