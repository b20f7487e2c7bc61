"""An engine of one's own: MuJoCo gives the equation of motion, NumPy and SciPy make the steps.

It passes the contract of every engine (docs/your-own-engine.md) and is there to be read. It is
slow, has no camera and no elastic cables. Put your own equation in the place of MuJoCo's.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

from cdcsr.errors import CdcsrError
from cdcsr.robot.routing import routing
from cdcsr.robot.stability import highest_speeds, too_fast
from cdcsr.simulation.contract import Physics, Simulation
from cdcsr.simulation.engines import make_simulation


class NumpySimulation(Simulation):
    engine, title, capabilities = "numpy", "NumPy", frozenset()
    physics = Physics("MuJoCo's equation of motion", *5 * ["ours: one solve in NumPy and SciPy"])

    def __init__(self, robot, num=1, options=None):
        super().__init__(robot, num, options)
        if robot.leaders != tuple(range(robot.num_hinges)):
            raise CdcsrError("The engine numpy has no coupled hinges; choose another engine.")
        self.inner = make_simulation(robot, "mujoco", num)
        self.tension, self.rest = np.zeros((num, robot.num_cables)), routing(robot).rest_length

    def _step(self, command, substeps):
        highest, lost = highest_speeds(self.robot), {}
        for _ in range(substeps):
            self._advance(command)
            now = self.inner.get_snapshot()
            for copy in np.flatnonzero(~(abs(now.velocity) < highest).all(axis=1)).tolist():
                lost.setdefault(copy, (now.time[copy], too_fast(now.velocity[copy], highest)))
                self._reset([copy])  # so that its numbers stay finite
        if lost:
            raise self._diverged(list(lost), *next(iter(lost.values())))

    def _advance(self, command):
        """Solve (M + h C) a = f - G^T t, where 0 <= t complementary to the room that is left."""
        robot, h, c = self.robot, self.robot.time_step, self.robot.num_cables
        equation, now = self.inner.dynamics(), self.inner.get_snapshot()
        q, v = now.position.copy(), now.velocity.copy()
        mass, force = equation.mass_matrix.copy(), equation.passive_force - equation.bias_force
        mass[:, 6:, 6:] += h * self.plant.damping[:, None] * np.eye(v.shape[1] - 6)
        force[:, 6 : 6 + c] += self.plant.servo_gain * (command - q[:, 7 : 7 + c])
        # Unilateral: cables; sliders and hinges upward; hinges downward.
        upper = [servo.stop for servo in robot.servos] + [hinge.upper for hinge in robot.hinges]
        lower = [hinge.lower for hinge in robot.hinges]
        slack = self.rest + self.plant.rest_length_offset - equation.cable_length
        room = np.concatenate([slack, upper - q[:, 7:], q[:, 7 + c :] - lower], axis=1)
        limits = np.vstack([np.eye(v.shape[1])[6:], -np.eye(v.shape[1])[6 + c :]])
        rows = np.concatenate([equation.cable_jacobian, [limits] * self.num], axis=1)
        room = np.where(room < -5e-5, room * h / robot.constraint.recovery_time, room)
        free = np.linalg.solve(mass, force[..., None])
        most = (room / h - (rows @ v[..., None])[..., 0]) / h - (rows @ free)[..., 0]
        pull = np.array([multipliers(*each) for each in zip(mass, rows, most, strict=True)])
        v += h * (free - np.linalg.solve(mass, rows.swapaxes(1, 2) @ pull[..., None]))[..., 0]
        turn = Rotation.from_rotvec(h * v[:, 3:6]) * Rotation.from_quat(
            q[:, 3:7], scalar_first=True
        )
        q[:, :3], q[:, 3:7] = q[:, :3] + h * v[:, :3], turn.as_quat(scalar_first=True)
        q[:, 7:] += h * v[:, 6:]
        self.inner.set_snapshot(replace(now, engine="", time=now.time + h, position=q, velocity=v))
        self.tension = pull[:, :c]

    def _reset(self, ids):
        self.inner.reset(ids)
        self.tension[ids] = 0

    def _place(self, ids, position, velocity):
        self.inner.place(ids, position, velocity)
        self.tension[ids] = 0

    def _get_snapshot(self):
        return replace(self.inner.get_snapshot(), engine=self.engine, private=self.tension.copy())

    def _set_snapshot(self, snapshot):
        self.inner.set_snapshot(replace(snapshot, commands=None))
        own = snapshot.engine == self.engine
        self.tension = snapshot.private.copy() if own else np.zeros_like(self.tension)

    def _state(self):
        return replace(self.inner.state(), cable_tension=self.tension.copy())

    def _dynamics(self, ids):
        return self.inner.dynamics(ids)

    def _set_plant(self, ids, plant):
        self.inner.plant = self.plant
        self.inner._set_plant(ids, plant)

    def _set_loads(self):
        self.inner.loads = self.loads
        self.inner._set_loads()

    def _render(self, index, camera, targets):
        raise CdcsrError("The engine numpy has no camera; choose another engine.")

    def _close(self):
        self.inner.close()


def multipliers(mass, rows, most):
    """Return t >= 0 such that a = -M^-1 G^T t is the least motion with G a <= most (Lawson and
    Hanson, Solving Least Squares Problems, 1974, chapter 23), "least" in the norm of M."""
    scale = max(-most.min(), 1e-300)
    system = np.vstack([np.linalg.solve(np.linalg.cholesky(mass), rows.T), most / scale])
    found, _ = nnls(-system, np.eye(len(system))[-1], maxiter=1000)
    return scale * found / (1 + system[-1] @ found)
