"""Robots by name and from xacro, the same for every verb; nothing is fetched."""

import subprocess
import sys
from importlib.util import find_spec

import pytest
from arms import MODELS

from hybrid.cli import main
from hybrid.errors import RobotError
from hybrid.robot import Robot
from hybrid.robot.library import robot_file


def test_a_name_of_example_robot_data_is_the_file_of_that_arm():
    assert robot_file("panda").name == "panda.urdf"
    assert robot_file("ur5").name == "ur5_robot.urdf"
    assert robot_file("alexander_v1.lowerBodyOnly").is_file()
    assert robot_file("anymal_b_simple") != robot_file("anymal_c_simple")
    assert Robot.load("ur5").joints == Robot.load(robot_file("ur5")).joints


def test_a_name_that_nobody_knows_lists_those_that_are_known():
    with pytest.raises(RobotError, match="ur5x: no such robot file; valid .* ur5, "):
        Robot.load("ur5x")


def test_a_file_of_the_same_name_comes_first(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ur5").write_text("no robot")
    assert not robot_file("ur5").is_absolute()


PACKAGE = {
    "__init__.py": "",
    "_descriptions.py": "class D:\n    repository = 'zoo'\n\n"
    "DESCRIPTIONS = {f'{x}_description': D for x in ('lizard_mj', 'toad', 'newt')}\n",
    "lizard_mj_description.py": "MJCF_PATH = {folder!r} + '/planar.xml'\n",
    "toad_description.py": "XACRO_PATH = {folder!r} + '/planar.xacro'\n"
    "XACRO_ARGS = {'kind': 'planar'}\n",
    "_xacro.py": "def get_urdf_path(module):\n"
    "    assert module.XACRO_ARGS == {'kind': 'planar'}\n"
    "    return module.XACRO_PATH.replace('xacro', 'xml')\n",
    "newt_description.py": "raise SystemExit('this fetches')\n",
}


@pytest.fixture
def descriptions(tmp_path, monkeypatch):
    """A package of descriptions, and its cache with one repository; its commit."""
    cache, folder = tmp_path / "cache", tmp_path / "robot_descriptions"
    zoo = cache / "zoo"
    zoo.mkdir(parents=True)
    folder.mkdir()
    (zoo / "planar.xml").write_bytes((MODELS / "scara.xml").read_bytes())
    git = ["git", "-C", str(zoo), "-c", "user.name=x", "-c", "user.email=x@x"]
    for words in ("init -q", "add .", "commit -qm x"):
        subprocess.run([*git, *words.split()], check=True)
    done = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True)
    for name, text in PACKAGE.items():
        (folder / name).write_text(text.replace("{folder!r}", repr(str(zoo))))
    for name in [x for x in sys.modules if x.startswith("robot_descriptions")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("ROBOT_DESCRIPTIONS_CACHE", str(cache))

    def at(commit):
        (folder / "_repositories.py").write_text(
            "class R:\n    cache_path = 'zoo'\n"
            f"    commit = {commit!r}\n\nREPOSITORIES = {{'zoo': R}}\n"
        )

    yield at, done.stdout.strip()
    for name in [x for x in sys.modules if x.startswith("robot_descriptions")]:
        del sys.modules[name]


@pytest.mark.skipif(find_spec("git") is None, reason="needs GitPython")
def test_a_name_of_robot_descriptions_is_the_file_in_its_cache(descriptions):
    at, commit = descriptions
    at(commit)
    for name in ("lizard", "lizard_mj", "lizard_mj_description", "toad"):
        assert Robot.load(name).joints == Robot.load(MODELS / "scara.xml").joints


@pytest.mark.skipif(find_spec("git") is None, reason="needs GitPython")
def test_what_the_cache_lacks_is_not_fetched_and_the_line_says_how_to(descriptions):
    at, _ = descriptions
    at("0" * 40)
    with pytest.raises(RobotError, match="robot_descriptions pull newt_description`"):
        Robot.load("newt")


XACRO = """<robot name="arm" xmlns:xacro="http://ros.org/wiki/xacro">
<xacro:property name="mass" value="${1 + 1}"/>
<link name="base"/><link name="upper"><inertial><mass value="${mass}"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="a" type="revolute"><parent link="base"/><child link="upper"/>
<axis xyz="0 1 0"/><limit effort="9" velocity="2" lower="-1" upper="1"/></joint></robot>
"""


def test_xacro_is_expanded(tmp_path):
    pytest.importorskip("xacro")
    path = tmp_path / "arm.urdf.xacro"
    path.write_text(XACRO)
    robot = Robot.load(path)
    assert (robot.joints, robot.chain.inertial[0, 0]) == (("a",), 2.0)
    assert robot.path == str(path)
    path.write_text(XACRO.replace("${1 + 1}", "${1 +}"))
    with pytest.raises(RobotError, match=r"xacro cannot expand it .*arm.urdf`"):
        Robot.load(path)
    path.write_text(XACRO.replace("${1 + 1}", "-2"))
    with pytest.raises(RobotError, match=r"xacro: link 'upper' has no physical"):
        Robot.load(path)


def test_without_xacro_the_line_says_what_to_run(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "xacro", None)
    path = tmp_path / "arm.urdf.xacro"
    path.write_text(XACRO)
    with pytest.raises(RobotError, match=r"run `xacro arm.urdf.xacro > arm.urdf`"):
        Robot.load(path)


def test_a_verb_takes_a_name_and_positions_of_held_joints(tmp_path, capsys):
    command = f"simulate --robot panda --out {tmp_path} --trajectories 1 --duration 2"
    assert main([*command.split(), "--hold", "panda_finger_joint1=0.02"]) == 0
    assert "panda_finger_joint1 at 0.02" in " ".join(capsys.readouterr().err.split())
    for wrong, says in (
        ("panda_joint1=0", "cannot hold panda_joint1; valid are joints off the arm"),
        ("panda_finger_joint1", "is not names with numbers, as torso=0.3"),
    ):
        assert main([*command.split(), "--hold", wrong]) == 2
        assert says in " ".join(capsys.readouterr().err.split())


def test_a_verb_refuses_a_name_that_nobody_knows(tmp_path, capsys):
    assert main(["simulate", "--robot", "ur5x", "--out", str(tmp_path / "o")]) == 2
    assert "no such robot file" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "o").exists()
