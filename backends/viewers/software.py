"""Draw a robot with PyBullet's software renderer, which needs no display and no graphics driver.

The robot is posed and never simulated, so positions from any engine can be drawn.
"""

from __future__ import annotations

import weakref

import numpy as np
import pybullet
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation
from trimesh.visual import ColorVisuals

from backends.pybullet.client import connect
from backends.viewers.cable_paths import CablePaths
from cdcsr.robot.colors import (
    BACKGROUND,
    CABLE,
    CABLE_RADIUS,
    DEBRIS,
    TARGET,
    TARGET_RADIUS,
    TIP,
    TIP_RADIUS,
    link_parts,
)
from cdcsr.robot.description import Robot
from cdcsr.robot.meshes import visual_meshes
from cdcsr.robot.poses import link_poses
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.cameras import HEIGHT, WIDTH, camera_angles
from cdcsr.simulation.rotations import at_start
from cdcsr.tasks.debris import Surface

Array = NDArray[np.float64]

_OVERSAMPLING = 2
_MARGIN = 0.12
"""The free space around the robot, as a share of its height."""
_FIELD_OF_VIEW = 25.0
"""The vertical field of view in degrees; it is narrow, so that the far end of the arm looks hardly
smaller."""
_NEAREST = 0.1
"""Nothing is drawn that is nearer to the eye than this, with the paper's robot, in [m]."""
_FAR_AWAY = (0.0, 0.0, -1e3)


class Renderer:
    """Draws one robot with its meshes, its cables, its tip, and targets.

    Args:
        robot: the description.
        debris: a piece of debris to draw too; arm and target are seen through it.
    """

    def __init__(self, robot: Robot, debris: Surface | None = None) -> None:
        self._client = connect(robot)
        self._disconnect = weakref.finalize(self, pybullet.disconnect, self._client)
        self._robot, self._paths, self._size = robot, CablePaths(robot), ruler(robot).size
        meshes = visual_meshes(robot)
        self._parts = [self._mesh(meshes[part]) for part in ("base", *link_parts(robot))]
        self._tip = self._ball(self._size * TIP_RADIUS, TIP)
        self._targets: list[int] = []
        self._debris: list[int] = []
        if debris is not None:
            mesh = trimesh.Trimesh(debris.vertices, debris.faces, process=False)
            self._debris = self._mesh(_coloured(mesh, DEBRIS))
        straight = np.zeros(7 + robot.num_cables + robot.num_hinges)
        straight[3] = 1.0
        pieces = self._paths.pieces(link_poses(robot, straight))
        self._cables = [self._line(end - start) for start, end in pieces]
        self._length = 2 * robot.top + robot.arm_length
        self._ends = [
            at_start(robot, [0, 0, z]) for z in (-robot.top, robot.top + robot.arm_length)
        ]
        self._base_edges = np.ptp(meshes["base"].bounds, axis=0)
        corners = [at_start(robot, corner) for corner in meshes["base"].vertices]
        self._corners = np.array([*corners, *self._ends])

    def draw(
        self,
        position: Array,
        camera: str = "side",
        targets: ArrayLike = (),
        size: tuple[int, int] = (HEIGHT, WIDTH),
        focus: tuple[ArrayLike, float] | None = None,
    ) -> NDArray[np.uint8]:
        """Return a picture of the robot.

        Args:
            position: one row of a Snapshot's position, shape (7 + C + H,).
            camera: a name in :data:`cdcsr.simulation.cameras.CAMERAS`.
            targets: points to mark, shape (n, 3), world frame, in [m].
            size: the height and the width of the picture in pixels.
            focus: a point in the world to look at, and the height of the part of the world to show
                around it, both in [m]; by default the whole robot.

        Returns:
            Shape (height, width, 3).

        Raises:
            CdcsrError: there is no such camera.
        """
        self._pose(np.asarray(position, dtype=float))
        self._mark(np.asarray(targets, dtype=float).reshape(-1, 3))
        height, width = (_OVERSAMPLING * side for side in size)
        center, span = focus or self._whole(camera, width / height)
        view, light, distance = _look(camera, np.asarray(center, dtype=float), span)
        lens = pybullet.computeProjectionMatrixFOV(
            _FIELD_OF_VIEW, width / height, _NEAREST * self._size, distance + 5 * self._length
        )
        image = self._shoot(width, height, view, light, lens)
        if self._debris:
            for body in self._debris:
                self._put(body, np.array(_FAR_AWAY))
            image = (image + self._shoot(width, height, view, light, lens)) // 2
            for body in self._debris:
                self._put(body, np.zeros(3))
        steps = range(_OVERSAMPLING)
        total = np.sum(
            [image[i::_OVERSAMPLING, j::_OVERSAMPLING] for i in steps for j in steps], axis=0
        )
        return (total // _OVERSAMPLING**2).astype(np.uint8)

    def _whole(self, camera: str, shape: float) -> tuple[Array, float]:
        """Return the middle of the robot at the start, and the height of the part of the world that
        holds all of it, in [m], for a picture of this width by height."""
        azimuth, (low, high) = np.deg2rad(camera_angles(camera)[0]), self._ends
        right, toward_eye = np.array([np.cos(azimuth), np.sin(azimuth), 0.0]), _toward_eye(camera)
        wide = max(abs(right @ (high - low)), np.abs(right) @ self._base_edges) / shape
        tall = (1 + 2 * _MARGIN) * abs(high[2] - low[2])
        middle = (low + high) / 2
        corners, upward = self._corners - middle, np.cross(toward_eye, right)
        beside = np.maximum(np.abs(corners @ right) / shape, np.abs(corners @ upward))
        # What is nearer to the eye than the middle looks larger.
        seen = 2 * np.max(beside + np.tan(np.deg2rad(_FIELD_OF_VIEW) / 2) * corners @ toward_eye)
        return middle, max(tall, (1 + _MARGIN / 2) * wide, (1 + _MARGIN / 8) * seen)

    def _shoot(
        self, width: int, height: int, view: list[float], light: list[float], lens: list[float]
    ) -> NDArray[np.uint16]:
        """Return a picture of all bodies where they are, shape (height, width, 3)."""
        _, _, pixels, _, mask = pybullet.getCameraImage(
            width,
            height,
            viewMatrix=view,
            projectionMatrix=lens,
            lightDirection=light,
            lightColor=(1.0, 1.0, 1.0),
            lightAmbientCoeff=0.55,
            lightDiffuseCoeff=0.45,
            lightSpecularCoeff=0.08,
            shadow=0,
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        image = np.array(pixels, dtype=np.uint16).reshape(height, width, 4)[..., :3]
        image[np.array(mask).reshape(height, width) < 0] = BACKGROUND
        return image

    def close(self) -> None:
        """Release the client; to close twice does nothing."""
        self._disconnect()

    def _pose(self, position: Array) -> None:
        poses = link_poses(self._robot, position)
        places = np.concatenate([position[None, :3], poses.joint[:-1]])
        turns = Rotation.from_matrix(poses.axes).as_quat()
        for bodies, place, turn in zip(self._parts, places, turns, strict=True):
            for body in bodies:
                self._put(body, place, turn)
        self._put(self._tip, poses.joint[-1])
        for line, (start, end) in zip(self._cables, self._paths.pieces(poses), strict=True):
            self._put(line, (start + end) / 2, _turn_to(end - start))

    def _mark(self, targets: Array) -> None:
        while len(self._targets) < len(targets):
            self._targets.append(self._ball(self._size * TARGET_RADIUS, TARGET))
        for ball in self._targets:
            self._put(ball, np.array(_FAR_AWAY))
        for ball, target in zip(self._targets, targets, strict=False):
            self._put(ball, target)

    def _mesh(self, mesh: trimesh.Trimesh) -> list[int]:
        """Make bodies that look like a mesh, one for each of its colours."""
        bodies = []
        assert isinstance(mesh.visual, ColorVisuals)
        colors = np.asarray(mesh.visual.face_colors)
        for color in np.unique(colors, axis=0):
            faces = (colors == color).all(axis=1)
            corners = mesh.triangles[faces].reshape(-1, 3)  # not shared: edges stay sharp
            shape = pybullet.createVisualShape(
                pybullet.GEOM_MESH,
                vertices=corners.tolist(),
                indices=list(range(len(corners))),
                normals=np.repeat(mesh.face_normals[faces], 3, axis=0).tolist(),
                rgbaColor=(color / 255).tolist(),
                physicsClientId=self._client,
            )
            bodies.append(
                pybullet.createMultiBody(baseVisualShapeIndex=shape, physicsClientId=self._client)
            )
        return bodies

    def _ball(self, radius: float, color: tuple[int, ...]) -> int:
        (body,) = self._mesh(_coloured(trimesh.creation.icosphere(2, radius), color))
        return body

    def _line(self, along: Array) -> int:
        radius = self._size * CABLE_RADIUS
        line = trimesh.creation.cylinder(radius, np.linalg.norm(along), sections=8)
        (body,) = self._mesh(_coloured(line, CABLE))
        return body

    def _put(self, body: int, place: Array, quaternion: ArrayLike = (0.0, 0.0, 0.0, 1.0)) -> None:
        """Pose a body; PyBullet's quaternions are x-y-z-w."""
        turn = np.asarray(quaternion).tolist()
        pybullet.resetBasePositionAndOrientation(
            body, place.tolist(), turn, physicsClientId=self._client
        )


def _coloured(mesh: trimesh.Trimesh, color: tuple[int, ...]) -> trimesh.Trimesh:
    mesh.visual = ColorVisuals(mesh, face_colors=color)
    return mesh


def _look(camera: str, center: Array, span: float) -> tuple[list[float], list[float], float]:
    """Return the view matrix, the direction of the light, which is above and beside the camera, and
    the distance of the eye in [m]."""
    toward_eye = _toward_eye(camera)
    distance = span / 2 / np.tan(np.deg2rad(_FIELD_OF_VIEW) / 2)
    view = pybullet.computeViewMatrix(center + distance * toward_eye, center, (0, 0, 1))
    shoulder = np.cross((0.0, 0.0, 1.0), toward_eye)
    return view, list(toward_eye + 0.6 * shoulder + np.array([0.0, 0.0, 0.8])), distance


def _toward_eye(camera: str) -> Array:
    """Return the direction from what a camera looks at to the eye."""
    azimuth, elevation = np.deg2rad(camera_angles(camera))
    flat = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    return np.cos(elevation) * flat - np.sin(elevation) * np.array([0.0, 0.0, 1.0])


def _turn_to(direction: Array) -> Array:
    """Return a quaternion, x-y-z-w, that turns the z axis into a direction."""
    x, y, z = direction / np.linalg.norm(direction)
    turn = np.array([-y, x, 0.0, 1.0 + z])
    length = np.linalg.norm(turn)
    return turn / length if length > 1e-9 else np.array([1.0, 0.0, 0.0, 0.0])
