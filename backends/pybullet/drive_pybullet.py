"""Drive the robot beside this file in plain PyBullet: python drive_pybullet.py STEPS COMMAND ..."""

import json
import sys
from pathlib import Path

import numpy as np
import pybullet as p

HERE, NO_TURN, folder = (0, 0, 0), (0, 0, 0, 1), Path(__file__).parent
data = json.loads((folder / "cables.json").read_text(encoding="utf-8"))
cables, hinges, step = data["cables"], data["hinges"], data["time_step"] / 10
p.setTimeStep(step, physicsClientId=p.connect(p.DIRECT))
p.setGravity(*data["gravity"])
# With other flags Bullet takes inertias of boxes. Its motors would hold every joint.
robot = p.loadURDF(str(folder / f"{data['robot']}.urdf"), flags=p.URDF_USE_INERTIA_FROM_FILE)
if (base := data["base"])["mount"] == "free":  # the file knows where a fixed base is
    p.resetBasePositionAndOrientation(robot, base["position"], np.roll(base["quaternion"], -1))
infos = [p.getJointInfo(robot, i) for i in range(p.getNumJoints(robot))]
numbers, joint = range(len(infos)), {info[1].decode(): info[0] for info in infos}
link = {"base": -1} | {info[12].decode(): info[0] for info in infos}
p.changeDynamics(robot, -1, linearDamping=0, angularDamping=0, maxJointVelocity=1e9)
p.setJointMotorControlArray(robot, numbers, p.VELOCITY_CONTROL, forces=[0] * len(infos))
for a, b in data["linkages"].items():
    gear = p.createConstraint(robot, joint[b], robot, joint[a], p.JOINT_GEAR, [0, 1, 0], HERE, HERE)
    p.changeConstraint(gear, gearRatio=-1, maxForce=1e6)
hinge = [hinges.get(name, {"stiffness": 0.0, "rest": 0.0}) for name in joint]
spring, rest = (np.array([each[key] for each in hinge]) for key in ("stiffness", "rest"))
p.resetJointStatesMultiDof(robot, numbers, [[angle] for angle in rest])
slider = [joint[cable["slider_joint"]] for cable in cables]
keys = "force_by_command", "stiffness", "pretension", "force_limit", "mass"
servo = np.array([[cable["servo"][key] for key in keys] for cable in cables])
gain, spring[slider], pretension, most, mass = servo.T
pull = gain * np.array(sys.argv[2:], dtype=float) - pretension
# Stiff springs with dampers stand in for the cables that URDF lacks.
stretch = np.array([cable["strain_by_tension"] * cable["rest_length"] for cable in cables])
stiff, damper = 1 / (stretch + 4 * step**2 / mass), (stretch == 0) * mass / step / 2
excess = np.zeros(len(cables))
for _ in range(10 * int(sys.argv[1])):
    states = p.getLinkStates(robot, numbers, computeForwardKinematics=1)
    frames = [state[4:6] for state in states] + [p.getBasePositionAndOrientation(robot)]
    force = spring * (rest - [state[0] for state in p.getJointStates(robot, numbers)])
    force[slider] = np.clip(force[slider] + pull, -most, most)
    p.setJointMotorControlArray(robot, numbers, p.TORQUE_CONTROL, forces=force)
    for c, cable in enumerate(cables):
        guides = [(slider[c], HERE)] + [(link[g["link"]], g["xyz"]) for g in cable["guides"]]
        path = [p.multiplyTransforms(*frames[body], x, NO_TURN)[0] for body, x in guides]
        along = np.diff(path, axis=0)
        along[1] *= not cable["sheath"]  # which keeps its length
        length = np.linalg.norm(along, axis=1)
        before, excess[c] = excess[c], length.sum() - cable["rest_length"]
        tension = stiff[c] * excess[c] + damper[c] * (excess[c] - before) / step
        along *= max(0, tension) * (excess[c] > 0) / np.maximum(length, 1e-12)[:, None]
        for i, part in enumerate(np.diff(along, axis=0, prepend=0, append=0)):
            p.applyExternalForce(robot, guides[i][0], part, path[i], p.WORLD_FRAME)
    p.stepSimulation()
last = p.getLinkState(robot, link[data["tip"]["link"]], computeForwardKinematics=1)
print(*p.multiplyTransforms(*last[4:6], data["tip"]["xyz"], NO_TURN)[0])
