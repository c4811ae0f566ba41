"""Robot files that ask for more than a robot is are refused at once, in one line."""

import os
import time

import pytest
from arms import MODELS

from hybrid.cli import main
from hybrid.errors import HybridError, RobotError
from hybrid.robot import Robot
from hybrid.robot.chain import MOST_JOINTS
from hybrid.robot.demand import _MOST, _demand, _product, check_demand

JOINT = "<joint axis='0 0 1'/><geom size='1'/>"
BODY = f"<body>{JOINT}</body>"
GEOM = "<geom size='.1'/>"


def mjcf(inside="", *, before="") -> str:
    return f"<mujoco>{before}<worldbody>{BODY}{inside}</worldbody></mujoco>"


def replicate(count, inside) -> str:
    return f"<replicate count='{count}' offset='1 0 0'>{inside}</replicate>"


HUGE_MJCF = {
    "memory": (mjcf(before="<size memory='100000G'/>"), "memory is 100000G"),
    "user of bodies": (mjcf(before="<size nuser_body='999999999'/>"), "numbers"),
    "copies of copies": (mjcf(replicate(99, replicate(99, GEOM))), "elements"),
    "copies in floats": (mjcf(replicate("1e6", GEOM)), "1,000,005 elements"),
    "a landscape": (
        mjcf(before="<asset><hfield name='h' nrow='90000' ncol='90000'/></asset>"),
        "numbers",
    ),
    "a chain": (
        mjcf(f"<body>{JOINT}" * (MOST_JOINTS + 1) + "</body>" * (MOST_JOINTS + 1)),
        "joints; valid are up to",
    ),
    "activations": (
        "<mujoco><worldbody><body><joint name='j'/><geom size='1'/></body></worldbody>"
        "<actuator><general joint='j' dyntype='user' actdim='100000000'/></actuator>"
        "</mujoco>",
        "numbers",
    ),
    "no number": (mjcf("<body pos='nan 0 0'/>"), "NaN"),
    "a device": (
        mjcf(before="<asset><mesh name='m' file='/dev/zero'/></asset>"),
        "not a regular file",
    ),
    "a tag without end": ("<mujoco <" * 100_000, "a tag is not closed"),
    "quotes without end": ("<a\"<a'" * 100_000, "a tag is not closed"),
    "comments without end": ("<!--" * 100_000, "a tag is not closed"),
}


def link(name, mass="1") -> str:
    return (
        f"<link name='{name}'><inertial><mass value='{mass}'/>"
        "<inertia ixx='1' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/></inertial></link>"
    )


def joint(name, parent, child, axis="0 0 1", upper="1") -> str:
    return (
        f"<joint name='{name}' type='revolute'><parent link='{parent}'/>"
        f"<child link='{child}'/><axis xyz='{axis}'/>"
        f"<limit effort='1' velocity='1' lower='-1' upper='{upper}'/></joint>"
    )


def urdf(*parts) -> str:
    return f"<robot name='r'>{''.join(parts)}</robot>"


def chain(count) -> str:
    links = [link(f"l{k}") for k in range(count + 1)]
    return urdf(*links, *(joint(f"j{k}", f"l{k}", f"l{k + 1}") for k in range(count)))


HUGE_URDF = {
    "a chain": (chain(500), "500 joints; valid are up to"),
    "a long chain": (chain(3000), "elements"),
    "no mass": (
        urdf(link("a"), link("b", "nan"), joint("j", "a", "b")),
        "value of mass in 'inertial' is 'nan'; valid are finite numbers",
    ),
    "a mass without end": (
        urdf(link("a"), link("b", "inf"), joint("j", "a", "b")),
        "is 'inf'",
    ),
    "an expression": (
        urdf(link("a"), link("b", "${m}"), joint("j", "a", "b")),
        "is '${m}'",
    ),
    "an axis": (
        urdf(link("a"), link("b"), joint("j", "a", "b", axis="0 nan 1")),
        "xyz of axis in 'joint j' is 'nan'",
    ),
    "a limit": (
        urdf(link("a"), link("b"), joint("j", "a", "b", upper="nan")),
        "upper of limit in 'joint j' is 'nan'",
    ),
    "a name": (
        urdf(link("a"), link("b"), joint("j\u202e", "a", "b")),
        "printable characters",
    ),
}
CASES = [
    *((name, ".xml", *case) for name, case in HUGE_MJCF.items()),
    *((name, ".urdf", *case) for name, case in HUGE_URDF.items()),
]


def refused(path, capfd) -> str:
    """The one line of an error of the robot, found in no time and leaving nothing."""
    before, start = set(os.listdir(".")), time.process_time()
    with pytest.raises(RobotError) as caught:
        Robot.load(path)
    assert time.process_time() - start < 5.0
    text = str(caught.value)
    assert text.startswith(str(path.parent)) and "\n" not in text
    assert (
        main(["simulate", "--robot", str(path), "--out", str(path.parent / "o")]) == 2
    )
    assert not (path.parent / "o").exists()
    assert set(os.listdir(".")) == before  # MuJoCo likes to leave a log
    capfd.readouterr()
    return text


@pytest.mark.parametrize(("name", "suffix", "text", "words"), CASES)
def test_more_than_a_robot_is_refused(tmp_path, name, suffix, text, words, capfd):
    path = tmp_path / f"arm{suffix}"
    path.write_text(text, encoding="utf-8")
    assert words in refused(path, capfd)


def test_a_file_beyond_all_measure_is_not_read(tmp_path, capfd):
    path = tmp_path / "arm.xml"
    with path.open("wb") as file:
        file.truncate(2**40)
    assert "bytes; valid are up to" in refused(path, capfd)


def test_files_within_files_count_as_often_as_they_are_there(tmp_path, capfd):
    (tmp_path / "part.xml").write_text(f"<mujocoinclude>{GEOM * 3000}</mujocoinclude>")
    path = tmp_path / "arm.xml"
    path.write_text(mjcf("<include file='part.xml'/>" * 2))
    check_demand(path)
    path.write_text(mjcf("<include file='part.xml'/>" * 3))
    assert "elements" in refused(path, capfd)
    path.write_text(mjcf("<include file='arm.xml'/>"))
    assert "files; valid are up to" in refused(path, capfd)


def test_models_within_models_count_as_often_as_they_are_there(tmp_path, capfd):
    for k in range(20):  # each has the next one three times
        attached = "".join(
            f"<attach model='m' body='b' prefix='p{i}_'/>" for i in range(3)
        )
        asset = f"<asset><model name='m' file='m{k + 1}.xml'/></asset>"
        text = f"<mujoco>{asset}<worldbody><body name='b'>{attached}</body></worldbody>"
        (tmp_path / f"m{k}.xml").write_text(f"{text}</mujoco>")
    (tmp_path / "m20.xml").write_text(mjcf("<body name='b'/>"))
    assert "elements" in refused(tmp_path / "m0.xml", capfd)


def test_a_name_that_is_no_text_and_a_gear_beyond_all_measure(tmp_path, capfd):
    path = tmp_path / "arm.urdf"
    plain = urdf(link("a"), link("b"), joint("j", "a", "b"))
    path.write_bytes(plain.encode().replace(b"name='r'", b"name='\xd3'"))
    assert "not UTF-8" in refused(path, capfd)
    path.write_text(plain[:-3])
    assert "not UTF-8" not in refused(path, capfd)
    drive = (
        "<transmission name='t'><joint name='j'/><actuator name='m'>"
        "<drake:rotor_inertia value='1'/><drake:gear_ratio value='1e300'/>"
        "</actuator></transmission></robot>"
    )
    path.write_text(plain.replace("</robot>", drive))
    assert "armature has shape" in refused(path, capfd)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs POSIX")
def test_a_pipe_is_not_waited_for(tmp_path, capfd):
    os.mkfifo(tmp_path / "meshes.stl")
    path = tmp_path / "arm.xml"
    asset = "<asset><mesh name='m' file='meshes.stl'/></asset>"
    path.write_text(mjcf(before=f"<compiler meshdir='.'/>{asset}"))
    assert "'meshes.stl' is not a regular file" in refused(path, capfd)
    os.mkfifo(tmp_path / "pipe.urdf")
    with pytest.raises(HybridError, match="no such robot file"):
        Robot.load(tmp_path / "pipe.urdf")


def test_robots_are_far_below_the_limits():
    paths = sorted(MODELS.glob("*.xml"))
    assert paths
    for path in paths:
        found = _demand(path)
        check_demand(path)
        assert 0 < 50 * found.elements < _MOST["elements"]
        assert 50 * found.numbers < _MOST["numbers"]


def test_sizes_are_read_as_their_parsers_do():
    for text, value in (
        ("3 4", 12),
        ("0.003", 1),
        ("2K", 2048),
        ("x", 1),
        ("1e3", 1000),
    ):
        assert _product(text) == value
