"""Cable-driven continuum space robots: one description, any engine, and the tasks they are given.

Importing this package makes the environment `cdcsr/Reach-v0` known to Gymnasium.
"""

import gymnasium

gymnasium.register("cdcsr/Reach-v0", entry_point="cdcsr.envs:ReachEnv", vector_entry_point="cdcsr.envs:ReachVectorEnv")
