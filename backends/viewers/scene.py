"""The three-dimensional scene of the live view: robots, cables, targets, trails and spaces."""

from __future__ import annotations

import numpy as np
import viser  # pyright: ignore[reportMissingImports] - it is an extra
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backends.viewers.cable_paths import CablePaths
from backends.viewers.session import Session, View
from backends.viewers.software import CABLE_RADIUS, TARGET_COLOR, TARGET_RADIUS, TIP_COLOR
from cdcsr.robot.meshes import link_parts, visual_meshes
from cdcsr.robot.poses import link_poses
from cdcsr.simulation.engines import engine_title
from cdcsr.tasks.spaces import Anchor, Balls, Space

Array = NDArray[np.float64]

LOOSE, TAUT, PULLED = (90, 160, 255), (70, 70, 78), (230, 60, 20)
"""The colours of a cable: slack, taut without tension, and under its largest tension."""
_SPACE_COLOR = (120, 90, 200)
_SLACK = 5e-5
"""A cable that is longer than its path by more than this is drawn as slack, in [m]."""


class EngineScene:
    """The robot of one engine, in a frame of its own.

    Args:
        server: the page.
        session: what is shown.
        number: which of its engines; they stand side by side along y.

    Attributes:
        origin: where the frame is on the page, shape (3,), in [m].
    """

    def __init__(self, server: viser.ViserServer, session: Session, number: int) -> None:
        self._server, self._number, robot = server, number, session.robot
        self._robot, self._paths = robot, CablePaths(robot)
        self._most = np.array([servo.gain * servo.eta for servo in robot.servos])
        meshes, parts = visual_meshes(robot), link_parts(robot)
        self.origin = np.array([0.0, 1.1 * number * np.ptp(meshes["base"].bounds[:, 1]), 0.0])
        self.name = f"/engine{number}"
        server.scene.add_frame(self.name, show_axes=False, position=self.origin)
        title = engine_title(session.engines[number])
        height = -robot.top - 0.15 * robot.arm_length
        server.scene.add_label(f"{self.name}/title", title, position=(0.0, 0.0, height))
        self._add_space(session.space)
        self._base = server.scene.add_mesh_trimesh(f"{self.name}/base", meshes["base"])
        self._links = []
        for part in dict.fromkeys(parts):
            chosen = np.flatnonzero(np.array(parts) == part)
            still = np.tile([1.0, 0.0, 0.0, 0.0], (len(chosen), 1))
            batch = server.scene.add_batched_meshes_trimesh(
                f"{self.name}/{part}", meshes[part], still, np.zeros((len(chosen), 3)), lod="off"
            )
            self._links.append((chosen, batch))
        scene, none = server.scene, np.zeros((0, 2, 3))
        self._cables = scene.add_line_segments(
            f"{self.name}/cables", none, none, thickness=2 * CABLE_RADIUS
        )
        self._trail = scene.add_line_segments(
            f"{self.name}/trail", none, TIP_COLOR[:3], thickness=3 * CABLE_RADIUS
        )
        self._target = scene.add_icosphere(
            f"{self.name}/target", TARGET_RADIUS, TARGET_COLOR[:3], position=session.target
        )

    def draw(self, view: View, session: Session) -> None:
        """Show the robot, the trail of its tip and the target as they are now."""
        poses = link_poses(self._robot, view.position)
        self._base.position, self._base.wxyz = view.position[:3], view.position[3:7]
        turns = Rotation.from_matrix(poses.axes[1:]).as_quat(scalar_first=True)
        for chosen, batch in self._links:
            batch.batched_positions = poses.joint[chosen].astype(np.float32)
            batch.batched_wxyzs = turns[chosen].astype(np.float32)
        travel = view.state.cable_travel[0]
        pieces = self._paths.bowed(self._paths.pieces(poses), poses, view.slack)
        lines = np.concatenate([pieces, self._paths.sliders(poses, travel)])
        colors = self.cable_colors(view.state.cable_tension[0], view.slack)
        shown = np.concatenate([self._paths.of_lines(colors), colors])
        self._cables.points = lines.astype(np.float32)
        self._cables.colors = np.repeat(shown[:, None], 2, axis=1).astype(np.uint8)
        tips = np.array([moment.tip[self._number] for moment in session.history])
        self._trail.points = np.stack([tips[:-1], tips[1:]], axis=1).astype(np.float32)
        self._target.position = session.target

    def cable_colors(self, tension: Array, slack: Array) -> Array:
        """Return the colour of each cable, shape (C, 3), from 0 to 255.

        Args:
            tension: shape (C,), in [N].
            slack: by how much each cable is longer than its path, shape (C,), in [m].
        """
        # The root shows small tensions, which most are.
        share = np.sqrt(np.clip(tension / self._most, 0.0, 1.0))[:, None]
        mixed = (1 - share) * TAUT + share * np.array(PULLED, dtype=float)
        return np.where((slack > _SLACK)[:, None], LOOSE, mixed)

    def _add_space(self, space: Space) -> None:
        """Show where targets are drawn, as translucent bodies."""
        scene, name = self._server.scene, f"{self.name}/space"
        look = {"opacity": 0.12, "cast_shadow": False, "receive_shadow": False}
        if isinstance(space, Anchor):
            size = np.maximum(space.size, 1e-3)
            scene.add_box(name, _SPACE_COLOR, size, position=space.center, **look)
        elif isinstance(space, Balls):
            for n, center in enumerate(space.centers):
                scene.add_icosphere(
                    f"{name}{n}", space.radius, _SPACE_COLOR, position=center, **look
                )
        else:
            points = space.sample(np.random.default_rng(0), 4000).astype(np.float32)
            scene.add_point_cloud(name, points, _SPACE_COLOR, point_size=0.006)
