"""The plain engines load the files of `cdcsr build-model`, and then hold the described robot."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from backends.contract_suite.states import KINDS
from backends.export import summary
from cdcsr.errors import CdcsrError
from cdcsr.files import JsonObject
from cdcsr.robot.description import Robot, load_robot
from cdcsr.robot.meshes import visual_meshes
from cdcsr.robot.routing import routing
from cdcsr.simulation.cameras import CAMERAS
from cdcsr.simulation.engines import make_simulation
from tests.support.physics import described_bodies, finer
from training.commands.build_model import build_model

ALONE = "assert not {'cdcsr', 'backends'} & {name.partition('.')[0] for name in sys.modules}"
IN_MUJOCO = f"""
import json, sys
import mujoco
model = mujoco.MjModel.from_xml_path(sys.argv[1])
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
{ALONE}
print(json.dumps({{
    "masses": [float(m) for m in model.body_mass if m], "center": data.subtree_com[0].tolist(),
    "dof": model.nv, "meshes": model.nmesh, "lengths": data.ten_length.tolist(),
    "limits": model.tendon_range[:, 1].tolist(), "tip": data.site("tip").xpos.tolist(),
}}))
"""
IN_PYBULLET = f"""
import json, sys
import pybullet
client = pybullet.connect(pybullet.DIRECT)
flags = pybullet.URDF_USE_INERTIA_FROM_FILE
robot = pybullet.loadURDF(sys.argv[1], flags=flags, physicsClientId=client)
count = pybullet.getNumJoints(robot)
info = [pybullet.getDynamicsInfo(robot, i) for i in range(-1, count)]
places = [[0, 0, 0]] + [pybullet.getLinkState(robot, i)[0] for i in range(count)]
masses = [i[0] for i in info]
joints = [pybullet.getJointInfo(robot, i) for i in range(count)]
{ALONE}
print(json.dumps({{
    "masses": [m for m in masses if m],
    "dof": 6 + sum(j[2] != pybullet.JOINT_FIXED for j in joints),
    "center": [sum(m * p[k] for m, p in zip(masses, places)) / sum(masses) for k in range(3)],
    "meshes": sum(shape[2] == pybullet.GEOM_MESH for shape in pybullet.getVisualShapeData(robot)),
    "inertias": [i[2] for i in info if i[0]],
    "links": ["base"] + [j[12].decode() for j in joints],
    "joints": [j[1].decode() for j in joints],
}}))
"""


def plain(code: str, file: Path, folder: Path) -> JsonObject:
    """Return what an engine reads from a file, in a process without this package, in another
    folder."""
    command = [sys.executable, "-c", code, str(file)]
    done = subprocess.run(command, check=False, capture_output=True, text=True, cwd=folder)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.fixture(scope="module", params=KINDS)
def built(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[str, Path]:
    """Return the name of a robot and the folder of its files; summary.json lies beside that."""
    out = tmp_path_factory.mktemp("models") / "moved"
    with pytest.MonkeyPatch.context() as patch:
        if request.param != "planar-single":  # one robot's is enough here, and slow to find
            patch.setattr(summary, "accurate_step", lambda *_: None)
        build_model(request.param, out=out, json=out.parent / "summary.json")
    return request.param, out


def test_it_writes_the_promised_files(built: tuple[str, Path]) -> None:
    name, out = built
    expected = {
        "cables.json",
        "drive_pybullet.py",
        "meshes",
        f"{name}.glb",
        f"{name}.toml",
        f"{name}.urdf",
        f"{name}.xml",
    }
    assert {path.name for path in out.iterdir()} == {*expected, ".cdcsr"}
    assert load_robot(out / f"{name}.toml") == load_robot(name)
    assert (out / f"{name}.glb").read_bytes()[:4] == b"glTF"


def check_bodies(found: JsonObject, robot: Robot, about: JsonObject) -> None:
    """Compare masses, centre of mass and degrees of freedom."""
    expected = [mass for _, mass, _, _ in described_bodies(robot)]
    np.testing.assert_allclose(sorted(found["masses"]), sorted(expected), rtol=1e-12)
    np.testing.assert_allclose(found["center"], about["center_of_mass"], atol=1e-9)
    links = sum(segment.links * segment.link.length for segment in robot.segments)
    assert about["reach"] == pytest.approx(links)
    assert about["tip"] == pytest.approx([0, 0, 0.3 + links])  # bases are 0.6 m high
    assert found["dof"] == robot.num_coordinates == about["degrees_of_freedom"]


def test_plain_mujoco_holds_the_robot(built: tuple[str, Path], tmp_path: Path) -> None:
    name, out = built
    robot, route = load_robot(name), routing(load_robot(name))
    found = plain(IN_MUJOCO, out / f"{name}.xml", tmp_path)
    about = json.loads((out.parent / "summary.json").read_text())
    check_bodies(found, robot, about)
    assert found["meshes"] == 1 + 2 * robot.num_segments
    np.testing.assert_allclose(found["tip"], [0, 0, robot.top + robot.arm_length], atol=1e-12)
    np.testing.assert_allclose(found["lengths"], route.rest_length, rtol=1e-12)
    np.testing.assert_allclose(found["limits"], route.rest_length, atol=1e-8)
    # A limit below the length at rest, by however little, acts in the first step.
    assert np.all(np.less(found["limits"], found["lengths"]))


def test_plain_pybullet_holds_the_robot(built: tuple[str, Path], tmp_path: Path) -> None:
    name, out = built
    robot = load_robot(name)
    found = plain(IN_PYBULLET, out / f"{name}.urdf", tmp_path)
    about = json.loads((out.parent / "summary.json").read_text())
    check_bodies(found, robot, about)
    assert found["meshes"] == about["bodies"]
    np.testing.assert_allclose(found["inertias"][0], robot.base.inertia, rtol=1e-12)
    for link, _ in robot.links:
        assert any(np.allclose(inertia, link.inertia, rtol=1e-12) for inertia in found["inertias"])
    cables = json.loads((out / "cables.json").read_text())["cables"]
    assert len(cables) == robot.num_cables
    for cable in cables:
        assert cable["slider_joint"] in found["joints"]
        assert {guide["link"] for guide in cable["guides"]} <= set(found["links"])


def test_the_engines_agree_on_the_mass_matrix(built: tuple[str, Path]) -> None:
    _, out = built
    about = json.loads((out.parent / "summary.json").read_text())
    differences = about["mass_matrix_difference"]["pybullet"]
    assert differences["straight"] < 1e-9
    assert differences["bent"] < 1e-9


def test_one_backend_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    build_model("planar-single", out=tmp_path / "out", backend="mujoco")
    names = {path.name for path in (tmp_path / "out").iterdir()} - {".cdcsr"}
    assert names == {"meshes", "planar-single.glb", "planar-single.toml", "planar-single.xml"}
    shown = capsys.readouterr().out
    assert "degrees of freedom  22" in shown  # 6 of the base, 4 sliders, 12 hinges
    assert "segment 0         1.4, 1.4, 1.4, 1.4" in shown
    assert "mass matrix" not in shown


def test_meshes_of_ones_own_travel_with_the_files(tmp_path: Path) -> None:
    """Flat ones too, which enclose no volume; the written description names the written copies."""
    corners = [[0, 0, 0], [0.1, 0, 0], [0, 0, 0.2], [0.1, 0, 0.2]]
    plate = trimesh.Trimesh(corners, [[0, 1, 2], [1, 3, 2]])
    plate.export(tmp_path / "plate.stl")
    trimesh.creation.box((1.0, 1.0, 0.6)).export(tmp_path / "hull.glb")
    trimesh.creation.icosphere(2, 0.1).export(tmp_path / "debris.obj")
    text = load_robot("planar-single").to_toml()
    for section, mesh in (("[base]", "hull.glb"), ("[segments.link]", "plate.stl")):
        text = text.replace(f"{section}\n", f'{section}\nmesh = "{mesh}"\n')
    (tmp_path / "own.toml").write_text(text)
    out = tmp_path / "out"
    build_model(str(tmp_path / "own.toml"), out=out, debris=tmp_path / "debris.obj")
    model = mujoco.MjModel.from_xml_path(str(out / "planar-single.xml"))
    assert model.nmesh == 3
    written = load_robot(out / "planar-single.toml")
    assert (written.base.mesh, written.segments[0].link.mesh) == (
        "meshes/base.stl",
        "meshes/link_0.stl",
    )
    np.testing.assert_allclose(visual_meshes(written)["base"].extents, (1.0, 0.6, 1.0), rtol=1e-6)
    assert b'"debris"' in (out / "planar-single.glb").read_bytes()


def test_every_link_of_a_chain_keeps_its_own_mesh(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Read back, each part looks as before; what model files cannot hold is said."""
    data = load_robot("paper").model_dump(mode="json")
    for number, segment in enumerate(data["segments"]):
        segment["cables"]["guide_friction"] = 0.1 * number
        link = segment.pop("link")
        segment |= {"links": 3, "chain": [dict(link) for _ in range(3)]}
        for n, each in enumerate(segment["chain"]):
            trimesh.creation.box((0.1, 0.1, 0.1 + 0.01 * n + 0.05 * number)).export(
                tmp_path / f"{number}{n}.stl"
            )
            each["mesh"] = f"{number}{n}.stl" if n != number else None
    (tmp_path / "own.toml").write_text(Robot.model_validate(data).to_toml())
    build_model(str(tmp_path / "own.toml"), out=tmp_path / "out", backend="mujoco")
    assert capsys.readouterr().err.count("leave out the friction of cables in their guides") == 1
    before = visual_meshes(load_robot(tmp_path / "own.toml"))
    after = visual_meshes(load_robot(tmp_path / "out" / "paper.toml"))
    assert list(after) == list(before)
    for part, mesh in before.items():
        np.testing.assert_allclose(after[part].extents, mesh.extents, rtol=1e-6, err_msg=part)


def test_an_existing_folder_is_refused_unless_forced(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(
        CdcsrError, match="already exists; give another folder, or --force to replace it"
    ):
        build_model("planar-single", out=out, backend="mujoco")
    assert list(out.iterdir()) == []
    build_model("planar-single", out=out, backend="mujoco", force=True)
    assert (out / "planar-single.xml").exists()


@pytest.mark.parametrize(
    ("robot", "backend", "message"),
    [
        (
            "planar-single",
            "mojoco",
            r"^Unknown backend 'mojoco'\. Did you mean 'mujoco'\? Available: all, mujoco, ",
        ),
        ("planar", "mujoco", r"^Unknown robot 'planar'\."),
    ],
)
def test_a_wrong_name_writes_nothing(
    robot: str, backend: str, message: str, tmp_path: Path
) -> None:
    with pytest.raises(CdcsrError, match=message):
        build_model(robot, out=tmp_path / "out", backend=backend)
    assert list(tmp_path.iterdir()) == []


# -- driven by a stranger --------------------------------------------------------------------------

MUJOCO_DRIVER = f"""
import sys
import mujoco
model = mujoco.MjModel.from_xml_path(sys.argv[1])
assert [model.camera(i).name for i in range(model.ncam)] == ["side", "front", "top"]
assert model.body("target").mocapid[0] == 0 and model.key("start").id == 0
assert all(model.actuator_ctrllimited)
assert tuple(model.actuator_ctrlrange[0]) in ((-5, 0), (0, 250), (-0.5, 0))
data = mujoco.MjData(model)
mujoco.mj_resetDataKeyframe(model, data, 0)
data.ctrl[:] = [float(x) for x in sys.argv[3:]]
for _ in range(int(sys.argv[2])):
    mujoco.mj_step(model, data)
{ALONE}
print(*data.site("tip").xpos)
"""
STEPS, PULLS = 60, [-5.0, 0.0, 0.0, -2.0]


@pytest.mark.parametrize("place", ["in space", "turned", "on a mount", "by tensions", "by lengths"])
@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_a_stranger_drives_the_files(engine: str, place: str, tmp_path: Path) -> None:
    """In 60 steps the tip moves by more than 0.1 m.

    The script in PyBullet has cables as springs, in steps of a tenth, and so has our engine here;
    they differ by a part of 4e-4, and where servos are told lengths by one of 2e-3, as the springs
    stretch. Cables of the plain MJCF are soft limits, which the description
    makes stiff.
    """
    base = {"position": (0.3, -0.2, 0.1), "quaternion": (0.6, 0.8, 0.0, 0.0)}
    data = load_robot("planar-single").model_dump(mode="json")
    pulls = PULLS
    if place == "by tensions":
        servo = data["segments"][0]["servo"]
        gain, _ = servo.pop("gain"), servo.pop("eta")
        pulls = [-gain * pull for pull in PULLS]
        servo |= {"kind": "tension", "largest_tension": 250.0, "pretension": 1.0}
    elif place == "by lengths":
        pulls = [pull / 10 for pull in PULLS]
        data["segments"][0]["servo"] |= {"kind": "displacement", "gain": 500.0, "eta": 0.5}
    elif place != "in space":
        data["base"] |= base
    if place == "on a mount":
        data |= {"base": data["base"] | {"mount": "fixed"}, "gravity": (0.0, 0.0, -1.0)}
    robot, out, file = Robot.model_validate(data), tmp_path / "out", tmp_path / "mine.toml"
    file.write_text(robot.to_toml())
    build_model(str(file), out=out, backend=engine)
    words = [str(STEPS), *map(str, pulls)]
    if engine == "mujoco":
        command = [sys.executable, "-c", MUJOCO_DRIVER, str(out / "planar-single.xml"), *words]
    else:
        script = out / "drive_pybullet.py"
        assert len(script.read_text().splitlines()) < 60
        assert "cdcsr" not in script.read_text()
        command = [sys.executable, "-I", str(script), *words]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=tmp_path)
    tip = np.array(done.stdout.splitlines()[-1].split(), dtype=float)
    divide, most = (1, 0.05) if engine == "mujoco" else (10, 1e-3)
    most = max(most, 4e-3) if place == "by lengths" else most
    simulation = make_simulation(finer(robot, divide), engine)
    start = simulation.state().tip_position[0]
    simulation.step(np.array([pulls]), STEPS * divide)
    moved = simulation.state().tip_position[0] - start
    simulation.close()
    assert np.linalg.norm(moved) > 0.1
    assert np.linalg.norm(tip - start - moved) < most * np.linalg.norm(moved)


def test_the_cameras_of_a_file_look_at_the_robots_middle(tmp_path: Path) -> None:
    """From 1.6 times its extent away, upright, and by the angles of the named view: azimuth 0 and
    elevation 0 look along +y, and a negative elevation looks down."""
    build_model("paper", out=tmp_path / "out", backend="mujoco")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "paper.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert {model.camera(i).name for i in range(model.ncam)} == set(CAMERAS)
    assert model.site("target").size[0] == pytest.approx(0.018)  # of an arm of 2.4 m, in [m]
    for name, (azimuth, elevation) in CAMERAS.items():
        x, y, z = data.camera(name).xmat.reshape(3, 3).T  # the camera looks along -z
        apart = model.stat.center - data.camera(name).xpos
        distance = np.linalg.norm(apart)
        assert distance == pytest.approx(1.6 * model.stat.extent, rel=1e-5)
        np.testing.assert_allclose(-z, apart / distance, atol=1e-5)
        assert x[2] == pytest.approx(0, abs=1e-6)
        assert y[2] == pytest.approx(np.cos(np.deg2rad(elevation)), abs=1e-5)
        a, e = np.deg2rad(azimuth), np.deg2rad(elevation)
        expected = [-np.sin(a) * np.cos(e), np.cos(a) * np.cos(e), np.sin(e)]
        np.testing.assert_allclose(-z, expected, atol=1e-5)
