"""Drive the robot beside this file in plain PyBullet: python drive_pybullet.py STEPS COMMAND ...

Stiff springs with dampers stand in for the cables that URDF lacks. The tip's place is printed.
"""

import json
import sys
from pathlib import Path

import numpy as np
import pybullet as p

NO_TURN = (0, 0, 0, 1)


def drive(folder: Path, steps: int, commands: list[float]) -> np.ndarray:
    """Hold commands in [m] or [N] for some steps; return the tip's place in [m], shape (3,)."""
    data = json.loads((folder / "cables.json").read_text(encoding="utf-8"))
    cables, hinges, step = data["cables"], data["hinges"], data["time_step"] / 10
    p.setTimeStep(step, physicsClientId=p.connect(p.DIRECT))
    p.setGravity(*data["gravity"])
    # With other flags Bullet takes inertias of boxes. Its motors would hold every joint.
    robot = p.loadURDF(str(folder / f"{data['robot']}.urdf"), flags=p.URDF_USE_INERTIA_FROM_FILE)
    if (base := data["base"])["mount"] == "free":  # the file knows where a fixed base is
        p.resetBasePositionAndOrientation(robot, base["position"], np.roll(base["quaternion"], -1))
    infos = [p.getJointInfo(robot, i) for i in range(p.getNumJoints(robot))]
    numbers, names = range(len(infos)), [info[1].decode() for info in infos]
    link = {"base": -1} | {info[12].decode(): info[0] for info in infos}
    p.changeDynamics(robot, -1, linearDamping=0, angularDamping=0, maxJointVelocity=1e9)
    p.setJointMotorControlArray(robot, numbers, p.VELOCITY_CONTROL, forces=[0] * len(infos))
    slider = [names.index(cable["slider_joint"]) for cable in cables]
    for follower, leader in data["linkages"].items():
        a, b = names.index(leader), names.index(follower)
        gear = p.createConstraint(robot, a, robot, b, p.JOINT_GEAR, [0, 1, 0], [0] * 3, [0] * 3)
        p.changeConstraint(gear, gearRatio=-1, maxForce=1e6)
    hinge = [hinges.get(name, {"stiffness": 0.0, "rest": 0.0}) for name in names]
    spring, rest = (np.array([each[key] for each in hinge]) for key in ("stiffness", "rest"))
    p.resetJointStatesMultiDof(robot, numbers, [[angle] for angle in rest])
    if any(c["servo"]["kind"] == "displacement" for c in cables):
        sys.exit("This script drives no displacement servos; Bullet's dampers are explicit.")
    keys = "force_by_command", "stiffness", "pretension", "force_limit"
    gain, spring[slider], pretension, most = np.array(
        [[c["servo"][key] for c in cables] for key in keys]
    )
    guides = [[(link[g["link"]], g["xyz"]) for g in cable["guides"]] for cable in cables]
    guides = [[(slider[c], [0, 0, 0]), *each] for c, each in enumerate(guides)]
    before = [cable["rest_length"] for cable in cables]
    for _ in range(10 * steps):
        states = p.getLinkStates(robot, numbers, computeForwardKinematics=1)
        frames = [s[4:6] for s in states] + [p.getBasePositionAndOrientation(robot)]
        force = spring * (rest - [state[0] for state in p.getJointStates(robot, numbers)])
        force[slider] = np.clip(force[slider] + gain * commands - pretension, -most, most)
        p.setJointMotorControlArray(robot, numbers, p.TORQUE_CONTROL, forces=force)
        for c, cable in enumerate(cables):
            path = [p.multiplyTransforms(*frames[b], x, NO_TURN)[0] for b, x in guides[c]]
            along = np.diff(path, axis=0)
            along[1] *= not cable["sheath"]  # which keeps its length
            length = np.linalg.norm(along, axis=1)
            excess, rate = length.sum() - cable["rest_length"], (length.sum() - before[c]) / step
            before[c], stiff = length.sum(), cable["servo"]["mass"] / step**2
            soft = cable["strain_by_tension"] * cable["rest_length"]  # of an elastic cable, [m/N]
            elastic, damper = min(stiff / 4, 1 / soft if soft else np.inf), 0 if soft else stiff / 2
            tension = max(0, elastic * excess + damper * step * rate) * (excess > 0)
            along /= np.maximum(length, 1e-12)[:, None]
            pulls = tension * np.diff(along, axis=0, prepend=0, append=0)
            for (body, _), pull, point in zip(guides[c], pulls, path, strict=True):
                p.applyExternalForce(robot, body, pull, point, p.WORLD_FRAME)
        p.stepSimulation()
    last = p.getLinkState(robot, link[data["tip"]["link"]], computeForwardKinematics=1)
    return np.array(p.multiplyTransforms(*last[4:6], data["tip"]["xyz"], NO_TURN)[0])


if __name__ == "__main__":
    print(*drive(Path(__file__).parent, int(sys.argv[1]), [float(x) for x in sys.argv[2:]]))
