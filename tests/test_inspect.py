"""A wrong log is refused or warned of, by cause and column; a right one is not."""

import re
import warnings
from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest
from arms import MODELS
from blind.robots import load_arm, off_by
from coarse import simulate
from hypothesis import given, settings
from hypothesis import strategies as st
from marks import studied
from wrong_logs import WRONG, about, healthy

from hybrid.cli import main
from hybrid.diagnosis.diagnose import examine
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.deadzone import Deadzone
from hybrid.effects.delay import Delay
from hybrid.effects.encoder_offset import EncoderOffset
from hybrid.effects.payload import Payload
from hybrid.effects.spring import Spring
from hybrid.effects.torque_gain import TorqueGain
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.errors import HybridWarning, RecordingError
from hybrid.identification import DynamicModel, identify, predict, validate
from hybrid.inspect import check_recordings, inspect_recording
from hybrid.inspect.doubt import Doubt
from hybrid.plant.scale import joint_scales
from hybrid.recording import write
from hybrid.robot import Robot

ARMS = ("scara", "coman_like", "ur5")
# What these motions do not tell: a planar arm and its mirror image move alike.
UNTOLD = {("scara", "sign of a joint")}


@cache
def robot(name: str) -> Robot:
    return load_arm(name if name == "ur5" else str(MODELS / f"{name}.xml"))


@cache
def real(name: str) -> Robot:
    """The arm as it is: each number of the file is off by up to a third."""
    return off_by(robot(name), 0.3, np.random.default_rng(1))


@cache
def right(name: str, small: bool = False):
    reach = 0.08 if small else None
    return healthy(real(name), nominal=robot(name), seed=3, reach=reach, duration=6.0)


def wrong(name: str, kind: str):
    arm = robot(name)
    source = right(name, WRONG[kind].small)
    return WRONG[kind].make(source, arm.size - 2, arm.size - 1)


@cache
def found(name: str, kind: str) -> tuple[Doubt, ...]:
    return inspect_recording(wrong(name, kind), robot(name)).doubts


def cases():
    """Each kind on the first arm that can tell it; the others are studied."""
    told = set()
    for name in ARMS:
        for kind, way in WRONG.items():
            if robot(name).size >= way.joints:
                untold = (name, kind) in UNTOLD
                marks = [pytest.mark.xfail(strict=True)] if untold else []
                marks += [pytest.mark.study] if kind in told else []
                told |= set() if untold else {kind}
                yield pytest.param(name, kind, marks=marks)


@pytest.mark.parametrize(("name", "kind"), list(cases()))
def test_a_wrong_log_is_told(name, kind):
    arm, way = robot(name), WRONG[kind]
    doubts = found(name, kind)
    columns = about(way, arm.size - 2, arm.size - 1)
    assert doubts, "taken at its word"
    right = [
        d
        for d in doubts
        if d.channel in way.channels and any(word in d.line for word in way.words)
    ]
    if any(d.severity == "error" for d in doubts):
        assert right, [d.line for d in doubts]
        assert columns <= {j for d in right for j in d.joints}


def late(x, seconds):
    """A log whose torques are written so long after the positions they belong to."""
    steps = round(seconds * x.rate)
    fields = {name: v[steps:] for name, v in x.channels.items()}
    return replace(x, t=x.t[steps:], **fields | {"tau": x.tau[:-steps]})


def turned(x, joint, angle):
    shift = np.where(np.arange(x.size) == joint, angle, 0.0)
    return replace(x, q=x.q + shift, command=x.command + shift)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda x, arm: replace(x, tau=100 * x.tau / arm.tau_max), "percent of the"),
        (lambda x, arm: turned(x, 1, np.pi / 2), "zero a quarter turn off"),
        (lambda x, arm: late(x, 0.096), "some 0.1 s late"),
        *(
            pytest.param(*case, marks=pytest.mark.study)
            for case in (
                (lambda x, arm: turned(x, 1, np.pi), "zero half a turn off"),
                (lambda x, arm: turned(x, 3, -np.pi / 2), "zero a quarter turn off"),
                (lambda x, arm: late(x, 0.25), "some 0.2 s late"),
            )
        ),
    ],
)
def test_percent_another_zero_and_late_torques_are_told(spoil, words):
    doubts = inspect_recording(spoil(right("ur5"), robot("ur5")), robot("ur5")).doubts
    assert [d.severity for d in doubts if words in d.text] == ["error"]


def test_torques_as_late_as_those_of_a_slow_bus_are_no_fault():
    assert not inspect_recording(late(right("ur5"), 0.04), robot("ur5")).doubts


@pytest.mark.parametrize("name", [ARMS[0], *studied(*ARMS[1:])])
def test_most_wrong_logs_are_refused_for_the_right_reason(name):
    refused = 0
    kinds = [k for k, way in WRONG.items() if robot(name).size >= way.joints]
    for kind in kinds:
        doubts = found(name, kind)
        refused += any(d.severity == "error" for d in doubts)
    assert refused >= 0.75 * len(kinds)


def gapless(x, keep):
    return replace(x, t=x.t[keep], **{n: v[keep] for n, v in x.channels.items()})


def bare(arm: Robot) -> Robot:
    """A file without rotors and friction."""
    none = np.zeros(arm.size)
    chain = replace(arm.chain, armature=none)
    return replace(arm, chain=chain, damping=none, frictionloss=none)


def payload(arm: Robot) -> Payload:
    return Payload.typical(tuple(range(arm.size)), joint_scales(arm))


HEALTHY = {
    "wrong inertias": lambda arm, x: (arm, x),
    "a bare file": lambda arm, x: (bare(arm), x),
    "50 Hz": lambda arm, x: (arm, gapless(x, slice(None, None, 10))),
    "3 s": lambda arm, x: (arm, gapless(x, slice(0, 1500))),
    "without speed": lambda arm, x: (arm, replace(x, v=None, command=None)),
}


def pair(axis: str, centre: float) -> Robot:
    """Two joints, and the mass of the last link far beyond its joint."""
    last = f'<joint name="b" axis="{axis}" range="-2 2"/>'
    ball = '<geom size=".05" mass="{}" pos="{} 0 0"/>'
    return Robot.load(
        mujoco.MjModel.from_xml_string(
            '<mujoco><compiler angle="radian"/><worldbody><body>'
            f'<joint name="a" axis="0 0 1" range="-2 2"/>{ball.format(2, 0.2)}'
            f'<body pos=".3 0 0">{last}{ball.format(1, centre)}</body>'
            "</body></worldbody></mujoco>"
        )
    )


@pytest.mark.parametrize("centre", [0.2, 0.5])
@pytest.mark.parametrize("axis", ["0 1 0", "0 0 1"])
def test_a_last_link_may_be_long(axis, centre):
    """Nothing beyond the last joint tells a link's length but its own mass."""
    arm = pair(axis, centre)
    (log,) = simulate(arm, trajectories=1, duration=4.0, seed=1)
    assert not inspect_recording(log, arm).doubts


@pytest.mark.parametrize("part", [0.15, *studied(0.08)])
def test_a_spring_that_the_file_lacks_is_no_other_unit(part):
    """No masses pull like a cable; that is no reason to read torque otherwise."""
    arm, joint = robot("coman_like"), 3
    stiffness = part * joint_scales(arm)[joint].torque
    cable = Spring((joint,), {"stiffness": stiffness, "preload": -0.2 * stiffness})
    x = healthy(real("coman_like"), effects=[cable], nominal=arm, seed=3, duration=5.0)
    assert check_recordings([x], arm) == [x]


@pytest.mark.parametrize(("constant", "severity"), [(12.0, "error"), (6.0, "warning")])
def test_a_current_in_place_of_torque_is_told_with_the_constants_it_asks_for(
    constant, severity
):
    """As UR's ROS driver logs it: amperes under the name of effort."""
    log, arm = right("ur5"), robot("ur5")
    constants = constant * np.linspace(0.9, 1.1, arm.size)
    doubts = inspect_recording(replace(log, tau=log.tau / constants), arm).doubts
    (doubt,) = (d for d in doubts if "a motor current in A" in d.text)
    assert doubt.severity == severity and "tau: {unit: A, torque_constant" in doubt.line
    asked = re.search(r"ask for (.*) N·m/A", doubt.remedy).group(1).split(", ")
    # the wrist carries next to nothing: friction alone tells no constant
    told = np.array([np.nan if x == "?" else float(x) for x in asked])[:3]
    assert np.nanmax(np.abs(np.log(told / constants[:3]))) < np.log(2)


@pytest.mark.parametrize("kind", HEALTHY)
@pytest.mark.parametrize("name", [*ARMS[:2], *studied(ARMS[2])])
def test_a_log_that_is_right_passes_without_a_word(name, kind):
    arm, x = HEALTHY[kind](robot(name), right(name))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (checked,) = check_recordings([x], arm)
    assert checked == x


FAULTS = {
    "gain": lambda arm: TorqueGain((1,), {"gain": -0.42}),
    "offset": lambda arm: TorqueOffset((1,), {"level": 0.05 * arm.tau_max[1]}),
    "delay": lambda arm: Delay((1,), {"time": 0.02}),
    "encoder": lambda arm: EncoderOffset((1,), {"offset": 0.05}),
    "deadzone": lambda arm: Deadzone((1,), {"width": 0.03 * arm.tau_max[1]}),
    "payload": payload,
}
FAULTY = [("scara", x) for x in FAULTS]
FAULTY += [
    pytest.param("coman_like", x, marks=pytest.mark.study) for x in ("gain", "payload")
]


@pytest.mark.parametrize(("name", "fault"), FAULTY)
def test_a_fault_of_the_arm_is_no_fault_of_the_log(name, fault):
    effect = FAULTS[fault](robot(name))
    x = healthy(robot(name), effects=[effect], seed=5, duration=4.0)
    assert [d.line for d in inspect_recording(x, robot(name)).doubts] == []


@pytest.mark.parametrize("name", ["scara", "ur5"])
def test_torque_asked_of_a_drive_that_cannot_give_it_has_its_sign(name):
    """The arm falls, and its controller asks for a hundred times what the drive has.

    With the other sign that would be a spring, but a stronger one than any drive.
    """
    x = right(name)
    tau, away = x.tau.copy(), x.q[:, 1] - x.q[:, 1].mean()
    tau[:, 1] -= 100.0 * robot(name).tau_max[1] * away / np.abs(away).max()
    doubts = inspect_recording(replace(x, tau=tau), robot(name)).doubts
    assert not any("other way round" in d.line for d in doubts)


@pytest.mark.parametrize("name", [ARMS[1], *studied(ARMS[2])])
def test_small_motion_is_no_fault_of_the_log(name):
    x = healthy(robot(name), seed=5, fill=0.08, duration=5.0)
    assert inspect_recording(x, robot(name)).doubts == ()


@pytest.mark.filterwarnings("ignore:the drive of")  # is at its limit: a gap as well
@given(
    mass=st.floats(0.1, 3.0),
    level=st.floats(0.0, 20.0),
    joint=st.integers(0, 5),
)
@settings(max_examples=5)
@pytest.mark.study
def test_no_gap_however_large_is_taken_for_another_order(mass, level, joint):
    arm = robot("coman_like")
    sizes = {"mass": 1.0, "mz": 0.1, "Ixx": 0.012, "Iyy": 0.012, "Izz": 0.002}
    load = Payload(tuple(range(6)), {name: mass * x for name, x in sizes.items()})
    effects = [load, Coulomb((joint,), {"level": level})]
    doubts = inspect_recording(healthy(arm, effects=effects, duration=5.0), arm).doubts
    assert not any(d.severity == "error" for d in doubts)


@cache
def model() -> DynamicModel:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        arm = robot("scara")
        logs = [healthy(arm, seed=seed, duration=5.0) for seed in (1, 2)]
        return identify(arm, logs, stages=("rigid",)).model


@cache
def holed():
    """A log, and its rows about a gap."""
    x = healthy(robot("scara"), seed=4, duration=6.0)
    return x, np.r_[0:1400, 1600 : len(x.t)]


VERBS = {
    "identify": lambda arm, x: identify(arm, [x], stages=("rigid",)),
    "validate": lambda arm, x: validate(model(), [x]),
    "predict": lambda arm, x: predict(model(), x),
    "diagnose": lambda arm, x: examine(arm, [x]),
}


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_refuses_the_same_log_for_the_same_reason(verb):
    arm = robot("scara")
    with pytest.raises(RecordingError, match=r"tau1 \(shoulder\) and tau2 .* swapped"):
        VERBS[verb](arm, wrong("scara", "torques swapped"))


@pytest.mark.parametrize(
    "verb",
    [
        pytest.param(x, marks=pytest.mark.study if x == "diagnose" else ())
        for x in VERBS
    ],
)
def test_every_verb_splits_a_log_at_its_gaps(verb):
    with pytest.warns(HybridWarning, match="taken as 2 recordings"):
        VERBS[verb](robot("scara"), gapless(*holed()))


def test_what_is_predicted_of_a_log_with_a_gap_has_a_row_for_each_sample():
    x, keep = holed()
    x = replace(x, v=None)
    with pytest.warns(HybridWarning, match="taken as 2 recordings"):
        tau = predict(model(), gapless(x, keep))
    whole = predict(model(), x)
    away = np.r_[0:1300, 1500 : len(keep)]  # filters do not see across the gap
    assert tau.shape == (len(keep), 2)
    assert np.allclose(tau[away], whole[keep][away], atol=0.02 * np.abs(whole).max())


def test_the_command_line_refuses_a_wrong_log_in_one_line(tmp_path, capsys):
    path, logs, out = MODELS / "scara.xml", tmp_path / "log.csv", tmp_path / "m.json"
    write(wrong("scara", "torques swapped"), logs)
    command = f"identify --robot {path} --recordings {logs} --out {out}"
    assert main(command.split()) == 2
    said = capsys.readouterr().err.strip()
    assert "look swapped" in said and str(logs) in said
    assert not out.exists()


def test_a_doubt_says_what_where_and_what_is_valid():
    doubt = found("scara", "torques swapped")[0]
    assert isinstance(doubt, Doubt)
    assert (doubt.channel, doubt.joints, doubt.severity) == ("tau", (0, 1), "error")
    assert doubt.evidence > 3
    assert doubt.line.startswith("tau1 (shoulder) and tau2 (elbow) look")
    assert "; valid are" in doubt.line
