"""The three-dimensional scene of the live view: robots, cables, targets, trails and spaces."""

from __future__ import annotations

import numpy as np
import viser  # pyright: ignore[reportMissingImports] - it is an extra
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backends.viewers.cable_paths import CablePaths
from cdcsr.robot.colors import CABLE_RADIUS, DEBRIS, TARGET, TARGET_RADIUS, TIP, link_parts
from cdcsr.robot.description import Robot
from cdcsr.robot.meshes import visual_meshes
from cdcsr.robot.poses import link_poses
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.rotations import at_start
from cdcsr.tasks.debris import Surface
from cdcsr.tasks.spaces import Anchor, Balls, Space
from cdcsr.tasks.workspace_map import Workspace

Array = NDArray[np.float64]

LOOSE, TAUT, PULLED = (90, 160, 255), (70, 70, 78), (230, 60, 20)
"""The colours of a cable: slack, taut without tension, and under its largest tension."""
_SPACE_COLOR = (120, 90, 200)
_SLACK, _GRAIN, _THINNEST = 5e-5, 0.006, 1e-3
"""A cable that is longer than its path by more than this is drawn as slack; size of a drawn target;
thickness of a flat space. All are those of the paper's robot, in [m]."""


class EngineScene:
    """The robot of one engine, in a frame of its own.

    Args:
        server: the page.
        robot: the description.
        title: what stands below it.
        number: its place in the row of robots, which stand side by side along y.
        space: where targets are drawn, if that is to be shown.

    Attributes:
        origin: where the frame is on the page, shape (3,), in [m].
    """

    def __init__(
        self,
        server: viser.ViserServer,
        robot: Robot,
        title: str,
        number: int,
        space: Space | None = None,
    ) -> None:
        self._robot, self._paths, scene = robot, CablePaths(robot), server.scene
        self._slack = _SLACK * ruler(robot).travel
        self._most = np.array([servo.pull for servo in robot.servos])
        meshes, parts = visual_meshes(robot), link_parts(robot)
        self.origin = np.array([0.0, 1.1 * number * np.ptp(meshes["base"].bounds[:, 1]), 0.0])
        name = f"/engine{number}"
        scene.add_frame(name, show_axes=False, position=self.origin)
        scene.add_label(
            f"{name}/title", title, position=(0.0, 0.0, -robot.top - 0.15 * robot.arm_length)
        )
        if space is not None:
            _add_space(scene, f"{name}/space", space, ruler(robot).size)
        self._base = scene.add_mesh_trimesh(f"{name}/base", meshes["base"])
        self._links = []
        for part in dict.fromkeys(parts):
            chosen = np.flatnonzero(np.array(parts) == part)
            still = np.tile([1.0, 0.0, 0.0, 0.0], (len(chosen), 1))
            batch = scene.add_batched_meshes_trimesh(
                f"{name}/{part}", meshes[part], still, np.zeros((len(chosen), 3)), lod="off"
            )
            self._links.append((chosen, batch))
        none, size = np.zeros((0, 2, 3)), ruler(robot).size
        self._cables = scene.add_line_segments(
            f"{name}/cables", none, none, thickness=2 * size * CABLE_RADIUS
        )
        self._trail = scene.add_line_segments(
            f"{name}/trail", none, TIP[:3], thickness=3 * size * CABLE_RADIUS
        )
        self._target = scene.add_icosphere(f"{name}/target", size * TARGET_RADIUS, TARGET[:3])

    def draw(
        self, position: Array, tension: Array, slack: Array, trail: Array, target: Array
    ) -> None:
        """Show the robot, its cables, the trail of its tip and the target at one moment.

        Args:
            position: as in a Snapshot, shape (7 + C + H,).
            tension: of the cables, shape (C,), in [N].
            slack: by how much each cable is longer than its path, shape (C,), in [m].
            trail: where the tip was, shape (n, 3), in [m].
            target: shape (3,), in [m].
        """
        poses, num_cables = link_poses(self._robot, position), self._robot.num_cables
        self._base.position, self._base.wxyz = position[:3], position[3:7]
        turns = Rotation.from_matrix(poses.axes[1:]).as_quat(scalar_first=True)
        for chosen, batch in self._links:
            batch.batched_positions = poses.joint[chosen].astype(np.float32)
            batch.batched_wxyzs = turns[chosen].astype(np.float32)
        pieces = self._paths.bowed(self._paths.pieces(poses), poses, slack)
        sliders = self._paths.sliders(poses, position[7 : 7 + num_cables])
        self._cables.points = np.concatenate([pieces, sliders]).astype(np.float32)
        colors = self.cable_colors(tension, slack)
        shown = np.concatenate([self._paths.of_lines(colors), colors])
        self._cables.colors = np.repeat(shown[:, None], 2, axis=1).astype(np.uint8)
        self._trail.points = np.stack([trail[:-1], trail[1:]], axis=1).astype(np.float32)
        self._target.position = target

    def cable_colors(self, tension: Array, slack: Array) -> Array:
        """Return the colour of each cable, shape (C, 3), from 0 to 255.

        Args:
            tension: shape (C,), in [N].
            slack: by how much each cable is longer than its path, shape (C,), in [m].
        """
        # The root shows small tensions, which most are.
        share = np.sqrt(np.clip(tension / self._most, 0.0, 1.0))[:, None]
        mixed = (1 - share) * TAUT + share * np.array(PULLED, dtype=float)
        return np.where((slack > self._slack)[:, None], LOOSE, mixed)


def look_at(server: viser.ViserServer, robot: Robot, last: EngineScene) -> None:
    """Let pages begin with a look at all robots, from the first one to the last."""
    height, far = robot.top + robot.arm_length, last.origin[1]
    away, (_, _, end) = 0.8 * height + 0.5 * far, at_start(robot, [0, 0, height])
    server.initial_camera.position = (away, far / 2 - 0.25 * away, 0.5 * end + 0.3 * height)
    server.initial_camera.look_at = (0.0, far / 2 + 0.2 * height, 0.5 * end)


def _add_space(scene: viser.SceneApi, name: str, space: Space, scale: float) -> None:
    """Show where targets are drawn, as translucent bodies, for a robot of this size."""
    look = {"opacity": 0.12, "cast_shadow": False, "receive_shadow": False}
    if isinstance(space, Anchor):
        size = np.maximum(space.size, scale * _THINNEST)
        scene.add_box(name, _SPACE_COLOR, size, position=space.center, **look)
    elif isinstance(space, Balls):
        for n, center in enumerate(space.centers):
            scene.add_icosphere(f"{name}{n}", space.radius, _SPACE_COLOR, position=center, **look)
    elif isinstance(space, Surface):
        scene.add_mesh_simple(
            name,
            space.vertices.astype(np.float32),
            space.faces.astype(np.uint32),
            color=DEBRIS[:3],
            opacity=0.5,  # the target and the arm are seen through it
            side="double",
        )
    elif isinstance(space, Workspace):
        corners, count = space.hull.reshape(-1, 3), len(space.hull)
        halves = np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(count)[:, None, None]
        faces = halves.reshape(-1, 3).astype(np.uint32)
        corners = corners.astype(np.float32)
        scene.add_mesh_simple(name, corners, faces, color=_SPACE_COLOR, side="double", **look)
    else:
        points = space.sample(np.random.default_rng(0), 4000).astype(np.float32)
        scene.add_point_cloud(name, points, _SPACE_COLOR, point_size=scale * _GRAIN)
