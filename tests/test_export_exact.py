"""Exports against formulas: operations, curves of friction, draws, servos."""

import sys
import types
from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from pendulum import pendulum, swings
from scipy.optimize import nnls
from test_export import model_of

from hybrid.dynamics import RigidBody
from hybrid.dynamics.tape import Tape
from hybrid.effects.command_latency import CommandLatency
from hybrid.effects.controller_gain import ControllerGain
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.spring import Spring
from hybrid.effects.stribeck import Stribeck
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.viscous import Viscous
from hybrid.exports.simulator import model as simulator_model
from hybrid.exports.simulator.check import file_torque, gaps
from hybrid.exports.simulator.friction import (
    approximate_friction,
    curve,
    is_friction,
    typical_motion,
)
from hybrid.exports.simulator.model import (
    fields_of_model,
    missing_model,
    model_simulator,
    usual_motion,
)
from hybrid.exports.simulator.plan import plan
from hybrid.exports.simulator.ranges import Ranges, ranges
from hybrid.exports.simulator.simulator import build_simulator
from hybrid.exports.simulator.snippets import (
    isaac_events,
    isaac_lab,
    mjx,
    mjx_notes,
)
from hybrid.model.program import Program, program_from_model
from hybrid.robot import Robot


def operations() -> Program:
    """Every operation of a tape, once or twice, of one joint; 0.1 is not binary."""
    tape = Tape()
    q, v, a = (tape.input(f"{x}[0]") for x in "qva")
    t, memory = tape.input("t"), tape.input("memory[0]")
    torque = np.minimum(q, 0.1) + np.maximum(v, -0.1) * 0.7 - np.sqrt(abs(a) + 0.3)
    torque = torque + np.where(q > v, np.exp(-q), np.sin(v) / 1.7) - (-np.tanh(a))
    torque = torque + np.sign(v) * np.cos(a) ** 2 + np.log(abs(q) + 1.1) * t
    torque = torque + np.where(a >= 0.1, 0.1, np.where(v <= q, v, q)) - (q < 0.3)
    return Program(
        ("a",), tape, (torque,), (np.nan,), (memory + 0.1 * q,), ("a: sum",), ()
    )


def test_every_operation_is_that_of_numbers_in_python_torch_and_onnx():
    torch = pytest.importorskip("torch")
    onnxruntime = pytest.importorskip("onnxruntime")
    from hybrid.exports.onnx_graph import onnx_model
    from hybrid.exports.torch_module import ProgramModule

    program, rng = operations(), np.random.default_rng(0)
    q, v, a, m = rng.normal(scale=0.5, size=(4, 40, 1))
    right = np.minimum(q, 0.1) + np.maximum(v, -0.1) * 0.7 - np.sqrt(abs(a) + 0.3)
    right += np.where(q > v, np.exp(-q), np.sin(v) / 1.7) + np.tanh(a)
    right += np.sign(v) * np.cos(a) ** 2 + np.log(abs(q) + 1.1) * 2.5
    right += np.where(a >= 0.1, 0.1, np.where(v <= q, v, q)) - (q < 0.3)
    tau, memory = program.run(q, v, a, memory=m, t=2.5)
    np.testing.assert_allclose(tau, right, rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(memory, m + 0.1 * q, rtol=1e-14)
    module, time = ProgramModule(program), np.full((40, 1), 2.5)
    assert module.names == ["t", "memory"]
    found = module(*map(torch.tensor, (q, v, a, time, m)))
    session = onnxruntime.InferenceSession(
        onnx_model(program, {"format": "onnx"}).SerializeToString()
    )
    given = {"q": q, "v": v, "a": a, "t": time, "memory": m}
    other = session.run(["tau", "variance", "memory_out"], given)
    for x in (found, other):
        np.testing.assert_allclose(x[0], right, rtol=1e-13, atol=1e-14)
        assert np.isnan(np.asarray(x[1])).all()
        np.testing.assert_allclose(x[2], m + 0.1 * q, rtol=1e-13)


def test_a_program_is_the_torque_of_its_links_and_effects():
    robot = pendulum(2)
    effects = [
        Viscous((0,), {"coefficient": 0.7}),
        Spring((1,), {"stiffness": 3.0, "preload": 1.0}),
        TorqueOffset((1,), {"level": 0.2}),
    ]
    program = program_from_model(model_of(robot, effects))
    (m,) = swings(2, count=1, seconds=1.0)
    tau, memory = program.run(m.q, m.v, m.a)
    load = RigidBody(robot.chain, m).load
    added = np.stack([0.7 * m.v[:, 0], 3 * m.q[:, 1] + 1 + 0.2], axis=1)
    np.testing.assert_allclose(tau, load + added, atol=1e-10)
    assert memory.shape == (100, 0) and program.memory_names == ()
    assert program.uses == {f"{x}[{j}]" for x in "qva" for j in (0, 1)}
    assert program.inputs[-3:] == ("t", "step", "known") and len(program.inputs) == 9


# --- friction -------------------------------------------------------------------------


def test_the_fields_of_a_joint_make_a_curve():
    v = np.linspace(-2, 2, 41)
    values = {
        "frictionloss": 0.5, "damping": 0.3, "quadratic": -0.2, "cubic": 0.1,
        "preload": 0.15, "knee": 0.7, "knee_speed": 0.4,
        "fall": 0.6, "fall_speed": 0.25,
    }  # fmt: skip
    expected = (
        0.3 * v - 0.2 * v * abs(v) + 0.1 * v**3 + 0.15 + 0.7 * np.clip(v / 0.4, -1, 1)
        + np.sign(v) * (0.5 + 0.6 * np.exp(-((v / 0.25) ** 2)))
    )  # fmt: skip
    np.testing.assert_allclose(curve(values, v), expected, atol=1e-12)
    assert (curve({}, v) == 0.0).all()


FIELDS = ("frictionloss", "damping", "quadratic", "cubic", "preload", "knee", "fall")


def fitted(effects, fields=FIELDS, **exact):
    robot, logs = pendulum(1), swings(1, count=2, seconds=3.0)
    moved = [(m, RigidBody(robot.chain, m)) for m in logs]
    v = np.concatenate([m.v[:, 0] for m in logs])
    return approximate_friction(effects, exact, moved, fields), v


def test_friction_that_a_joint_can_have_is_found_as_it_is():
    fastest = np.abs(
        np.concatenate([m.v for m in swings(1, count=2, seconds=3.0)])
    ).max()
    u = fastest * np.geomspace(0.003, 1.0, 25)[12]
    fall = Stribeck((0,), {"level": 0.8, "velocity": u, "exponent": 2.0})
    found, v = fitted([fall], damping=0.4, frictionloss=1.5)
    assert found.values["fall"] == pytest.approx(0.8, rel=1e-4)
    assert found.values["fall_speed"] == pytest.approx(u)
    assert found.values["frictionloss"] == pytest.approx(1.5, rel=1e-4)
    assert found.values["damping"] == pytest.approx(0.4, rel=1e-4)
    law = np.sign(v) * (1.5 + 0.8 * np.exp(-((v / u) ** 2))) + 0.4 * v
    assert found.torque == pytest.approx(np.sqrt(np.mean(law**2)))
    assert found.missed < 1e-4 * found.torque and found.joint == 0
    bent = ThresholdFriction((0,), {"rising": 1.2, "threshold": 0.61, "width": 0.0})
    found, _ = fitted([bent], knee_speed=0.61, preload=0.7, damping=0.2)
    assert found.values["knee"] == pytest.approx(1.2, rel=1e-3)
    assert found.values["knee_speed"] == 0.61 and found.values["fall"] == 0.0
    assert found.values["preload"] == pytest.approx(0.7, abs=1e-3)


def test_friction_of_a_urdf_is_the_line_of_least_squares():
    fall = Stribeck((0,), {"level": 0.8, "velocity": 0.5, "exponent": 1.0})
    found, v = fitted([fall], ("frictionloss", "damping"), damping=0.1)
    law = 0.8 * np.exp(-np.abs(v / 0.5)) * np.sign(v) + 0.1 * v
    X = np.stack([v, np.sign(v)], axis=1)
    gains, rest = nnls(X, law)
    assert found.values["damping"] == pytest.approx(gains[0], abs=1e-6)
    assert found.values["frictionloss"] == pytest.approx(gains[1])
    assert found.missed == pytest.approx(rest / np.sqrt(len(v)), rel=1e-6)
    assert set(found.values) == {"frictionloss", "damping"}


def test_friction_is_of_one_joint_and_of_its_speed():
    own = [Coulomb((0,), {"level": 1.0}), Viscous((0,), {"coefficient": 1.0})]
    assert all(map(is_friction, own))
    assert not is_friction(Spring((0,), {"stiffness": 1.0, "preload": 0.0}))


def test_a_typical_motion_is_at_all_speeds_of_the_arm():
    motion = typical_motion(replace(pendulum(1), v_max=np.array([1.5])))
    fastest = np.abs(motion.v).max()
    assert 0.3 < fastest <= 1.5 and np.isnan(motion.tau).all() and motion.mask.all()
    assert len(motion.t) == 2001 and motion.t[-1] == 20.0


def test_a_usual_motion_is_that_of_the_recordings():
    robot = pendulum(2)
    seen = {
        "q_min": np.array([-0.3, 0.1]), "q_max": np.array([0.4, 0.9]),
        "v_max": np.array([0.8, 2.0]),
    }  # fmt: skip
    motion = usual_motion(model_of(robot, range=seen))
    assert (motion.q > seen["q_min"]).all() and (motion.q < seen["q_max"]).all()
    np.testing.assert_allclose(np.abs(motion.v).max(axis=0), seen["v_max"])
    free = usual_motion(model_of(robot, range={}))
    assert np.abs(free.v).max() > 1.0


def test_a_plan_and_what_it_lacks_make_the_friction_that_was_asked_for():
    robot = replace(pendulum(1), damping=np.array([0.3]), frictionloss=np.array([0.4]))
    fall = Stribeck((0,), {"level": 0.8, "velocity": 0.5, "exponent": 1.0})
    late = CommandLatency((0,), {"time": 0.02})
    logs = swings(1, count=2, seconds=3.0)
    for kind in ("mjcf", "urdf"):
        made = plan(robot, [fall, late], kind, logs)
        new = made.change.robot
        (m,), body = logs[:1], RigidBody(robot.chain, logs[0])
        own = new.joint_torque(m.q, m.v, m.a) + new.dry_friction(m.v)
        for e in made.corrections:
            own[:, list(e.joints)] += e.torque(m, body)
        law = robot.joint_torque(m.q, m.v, m.a) + robot.dry_friction(m.v)
        law += fall.torque(m, body)
        np.testing.assert_allclose(own, law, atol=1e-9)
        assert len(made.friction) == 1 and made.friction[0].missed > 0.0
        assert [e.id for e in made.missing] == ["command_latency"] * (kind == "urdf")
        assert len(made.change.drives) == (kind == "mjcf")


def test_what_a_simulator_lacks_is_a_model_of_its_own():
    robot = pendulum(2)
    effects = [Viscous((0,), {"coefficient": 0.6}), TorqueOffset((1,), {"level": 0.9})]
    model = model_of(robot, effects)
    logs = swings(2, count=1, seconds=1.0)
    made = model_simulator(model, kind="urdf", motions=logs)
    lacks = missing_model(model, made)
    tau = lacks.predict(logs[0])
    np.testing.assert_allclose(tau[:, 0], 0.0, atol=1e-9)
    np.testing.assert_allclose(tau[:, 1], 0.9, atol=1e-9)
    fields = fields_of_model(model, logs)
    np.testing.assert_allclose(fields.damping, [0.6, 0.0])
    assert not fields.chain.armature.any()  # effects have them all
    np.testing.assert_allclose(fields.stiffness * fields.springref, [0.0, -0.9])


# --- ranges and snippets --------------------------------------------------------------


def spread(draws=500) -> Ranges:
    rng = np.random.default_rng(0)
    x = rng.multivariate_normal([1.0, 0.2, 0.5], 0.01 * np.array(
        [[1.0, 0.6, 0.0], [0.6, 1.0, 0.2], [0.0, 0.2, 4.0]]), draws)  # fmt: skip
    low, high = np.percentile(x, [2.5, 97.5], axis=0)
    keys = (("a", "frictionloss"), ("b", "frictionloss"), ("b", "armature"))
    correlation = np.corrcoef(x, rowvar=False)
    units = ("N·m", "N·m", "kg·m²")
    return Ranges(nominal(), keys, units, x.mean(axis=0), low, high, correlation, x)


def run(text, monkeypatch):
    """The names of a snippet, in a world with Isaac Lab's names in it."""
    for name in ("isaaclab", "isaaclab.actuators", "isaaclab.managers"):
        module = types.ModuleType(name)
        module.DelayedPDActuatorCfg = module.EventTermCfg = dict
        monkeypatch.setitem(sys.modules, name, module)
    names = {}
    exec(compile(text, "snippet", "exec"), names)
    return names


def test_an_interval_is_of_a_joint_and_a_number():
    found = spread()
    content = found.as_dict()
    assert content["level"] == 0.95
    assert content["parameters"][2] == {
        "joint": "b", "name": "armature", "unit": "kg·m²", "nominal": found.nominal[2],
        "interval": [found.low[2], found.high[2]],
    }  # fmt: skip


def nominal() -> Robot:
    """The arm of :func:`spread`."""
    robot = pendulum(2)
    chain = replace(robot.chain, joints=("a", "b"), armature=np.array([0.3, 0.5]))
    friction = {"frictionloss": np.array([1.0, 0.2]), "damping": np.array([0.7, 0.8])}
    return replace(robot, chain=chain, **friction)


def test_isaac_lab_gets_all_friction_of_a_joint_and_its_rotor(monkeypatch):
    """Static and dynamic friction alike, and viscous friction as such."""
    torch = pytest.importorskip("torch")
    found, wrote = spread(), {}

    class Arm:
        device = "cpu"

        def find_joints(self, names, preserve_order):
            assert names == ["a", "b"] and preserve_order
            return [4, 5], names

        def write_joint_friction_coefficient_to_sim(self, **given):
            wrote.update(given)

        def write_joint_armature_to_sim(self, rotors, joint_ids, env_ids):
            wrote["rotors"] = rotors

    made = run(isaac_events(found), monkeypatch)
    (event,) = made["EVENTS"].values()
    env = types.SimpleNamespace(scene={"robot": Arm()}, num_envs=2000)
    event["func"](env, None)
    dry, viscous = wrote["joint_friction_coeff"], wrote["joint_viscous_friction_coeff"]
    assert wrote["joint_ids"] == [4, 5] and len(wrote["env_ids"]) == 2000
    assert torch.equal(dry, wrote["joint_dynamic_friction_coeff"])
    drawn = torch.cat([dry, wrote["rotors"][:, 1:]], dim=1).double().numpy()
    np.testing.assert_allclose(drawn.mean(0), found.draws.mean(0), atol=0.02)
    np.testing.assert_allclose(np.cov(drawn.T), np.cov(found.draws.T), atol=4e-3)
    assert np.unique(viscous.numpy(), axis=0) == pytest.approx(np.array([[0.7, 0.8]]))
    assert np.unique(wrote["rotors"][:, 0].numpy()) == pytest.approx([0.3])
    event["func"](env, torch.tensor([7]))
    assert wrote["joint_friction_coeff"].shape == (1, 2)


class Drawn(np.ndarray):
    """An array that is changed as those of JAX are."""

    @property
    def at(self):
        source = self

        class Places:
            def __getitem__(self, where):
                def put(x):
                    out = source.copy()
                    out[where] = x
                    return out

                return types.SimpleNamespace(set=put)

        return Places()


class Model:
    """A model of MJX, as far as the function needs one."""

    impl = types.SimpleNamespace(value="warp")

    def __init__(self, **fields):
        self.__dict__.update(fields)

    def tree_replace(self, fields):
        return Model(**{**self.__dict__, **fields})


def randomised(text, compiled, draws, monkeypatch):
    """Fields of each of some draws of a function for MJX."""
    jax = types.ModuleType("jax")
    jax.numpy = types.ModuleType("jax.numpy")
    jax.numpy.array = lambda x: np.array(x).view(Drawn)
    jax.random = types.SimpleNamespace(randint=lambda key, *_: key)
    jax.tree_util = types.SimpleNamespace(tree_map=lambda _, model: Model())
    jax.vmap = lambda f: (
        lambda keys: {name: np.stack([f(k)[name] for k in keys]) for name in f(keys[0])}
    )
    monkeypatch.setitem(sys.modules, "jax", jax)
    monkeypatch.setitem(sys.modules, "jax.numpy", jax.numpy)
    names = {}
    exec(compile(text, "mjx", "exec"), names)
    fields = (
        "dof_armature", "dof_damping", "dof_frictionloss", "dof_dampingpoly",
        "tendon_frictionloss",
    )  # fmt: skip
    model = Model(**{x: getattr(compiled, x).view(Drawn) for x in fields})
    out, axes = names["domain_randomize"](model, range(draws), compiled)
    changed = vars(axes)
    assert set(changed.values()) == {0}
    return {x: getattr(out, x) for x in changed}


@pytest.mark.parametrize("rises", [False, True])
def test_the_function_for_mjx_puts_draws_where_the_file_has_the_numbers(
    rises, monkeypatch
):
    """Friction that rises takes the place of dry friction, which it once erased."""
    found, robot = spread(40), nominal()
    keys = found.keys
    if rises:
        level, speed = np.array([0.0, 2.0]), np.array([0.0, 0.1])
        robot = replace(robot, knee=level, knee_speed=speed)
        keys = (keys[0], keys[1], ("b", "knee"))
    text = mjx(replace(found, keys=keys, robot=robot))
    made = mujoco.MjModel.from_xml_string(build_simulator(robot).text.decode())
    fields = randomised(text, made, 40, monkeypatch)
    expected = {
        x: np.tile(getattr(made, x), (40, 1)) for x in fields
    }  # those that are not drawn stay
    draws = found.draws
    if rises:
        expected["dof_frictionloss"][:] = draws[:, [0, 2]]
        expected["tendon_frictionloss"][:, 0] = draws[:, 1]
    else:
        expected["dof_frictionloss"][:] = draws[:, :2]
        expected["dof_armature"][:, 1] = draws[:, 2]
    assert fields.keys() == expected.keys()
    for name, x in expected.items():
        np.testing.assert_allclose(fields[name], x, rtol=1e-4)


def test_what_the_function_for_mjx_does_not_draw_is_said_by_joint():
    robot = pendulum(3)
    assert mjx_notes(robot, drawn=True) == []
    odd = replace(
        robot, falling=np.array([[2, 0.1, 0.2]]), knee=np.array([0.5, 0.5, 0.0]),
        knee_speed=np.full(3, 0.1), frictionloss=np.array([0.0, 0.3, 0.0]),
    )  # fmt: skip
    assert mjx_notes(odd, drawn=True)[:2] == [
        "for MJX: draws of friction that falls with speed, of hinge_2",
        "for MJX: draws of dry friction beside that which rises with speed, of hinge_0",
    ]


def test_what_mjx_on_jax_does_not_take_is_said_by_joint():
    robot = pendulum(3)
    assert mjx_notes(robot) == []
    odd = replace(
        robot, cubic=np.array([0, 0.1, 0]), quadratic=np.array([0.2, 0, 0]),
        ripple=np.array([[2, 0.1, 0, 5.0]]), falling=np.array([[0, 0.1, 0.2]]),
        stiffening=np.array([[1, 3.0, 0.2, 0.9]]),
    )  # fmt: skip
    hose, curved, motors = mjx_notes(odd)
    assert "spring of hinge_1, which it ignores" in hose
    assert "damping of hinge_0, hinge_1, which it ignores" in curved
    assert "friction of hinge_0, hinge_2, which it refuses" in motors


def test_isaac_lab_gets_the_servo_of_the_file_as_the_model_changes_it(monkeypatch):
    robot = replace(
        pendulum(2), kp=np.array([50.0, 40.0]), kd=np.array([5.0, 2.0]),
        tau_max=np.array([60.0, 30.0]), v_max=np.array([3.0, np.inf]),
    )  # fmt: skip
    effects = [
        ControllerGain((1,), {"stiffness": -0.2, "damping": 0.5}),
        CommandLatency((0,), {"time": 0.012}), Viscous((1,), {"coefficient": 0.4}),
        Coulomb((0,), {"level": 0.3}), TorqueOffset((1,), {"level": 0.1}),
        Spring((0,), {"stiffness": 3.0}),
    ]  # fmt: skip
    text, notes = isaac_lab(model_of(robot, effects), swings(2, count=1))
    own = run(text, monkeypatch)["ACTUATORS"]["arm"]
    joints = robot.joints
    assert own["stiffness"] == pytest.approx({joints[0]: 50.0, joints[1]: 32.0})
    assert own["damping"] == pytest.approx({joints[0]: 5.0, joints[1]: 3.0})
    assert own["effort_limit"] == {joints[0]: 60.0, joints[1]: 30.0}
    assert own["velocity_limit"] == {joints[0]: 3.0}
    assert own["viscous_friction"] == pytest.approx({joints[0]: 0.0, joints[1]: 0.4})
    assert own["dynamic_friction"] == pytest.approx({joints[0]: 0.3, joints[1]: 0.0})
    assert (own["min_delay"], own["max_delay"]) == (2, 3)  # 12 ms by steps of 5 ms
    assert set(notes) == {
        "torque_offset of hinge_1 (level 0.1 N·m)",
        "spring of hinge_0 (stiffness 3 N·m/rad)",
    }
    stepped = replace(robot, timestep=0.004)
    text, _ = isaac_lab(model_of(stepped, effects), swings(2, count=1))
    own = run(text, monkeypatch)["ACTUATORS"]["arm"]
    assert (own["min_delay"], own["max_delay"]) == (3, 3)


def test_friction_of_all_draws_rises_at_the_speed_of_the_files():
    """Each form of its own would put dry friction where a level is that it rises to."""
    rising = {"rising": 1.0, "threshold": 0.4, "width": 0.1, "viscous": 0.2}
    model = model_of(pendulum(2), [ThresholdFriction((0,), rising)])
    motions = (usual_motion(model),)
    form = fields_of_model(model, motions)
    assert form.knee[0] > 0.5 and not form.knee[1]
    for level, slope in ((0.0, 0.5), (2.0, 0.0), (0.3, 3.0)):
        drawn = model.effects[0].at({"rising": level, "viscous": slope})
        found = fields_of_model(replace(model, effects=(drawn,)), motions, form=form)
        assert found.knee_speed[0] in (form.knee_speed[0], 0.0)
        assert (found.knee[0] > 0.1) == (level > 0) and not found.knee[1]
        assert found.frictionloss[0] < 0.2


def test_intervals_are_those_of_the_draws():
    robot = pendulum(1)
    model = model_of(robot, [Viscous((0,), {"coefficient": 0.5})])
    object.__setattr__(model.effects[0], "std", {"coefficient": 0.05})
    model = replace(model, covariance=1e-12 * np.eye(10))
    found = ranges(model, np.random.default_rng(1), draws=200)
    k = found.keys.index((robot.joints[0], "damping"))
    assert found.units[k] == "N·m·s/rad" and found.nominal[k] == pytest.approx(0.5)
    own = found.draws[:, k]
    assert own.std() == pytest.approx(0.05, rel=0.2) and (own >= 0).all()
    np.testing.assert_allclose(
        [found.low[k], found.high[k]], np.percentile(own, [2.5, 97.5])
    )


def test_a_simulator_is_compared_while_a_joint_moves_and_the_log_counts():
    robot, (log,) = pendulum(2), swings(2, count=1, seconds=1.0)
    v = np.where(np.arange(len(log.t))[:, None] < 40, 0.01, 1.0) * [1.0, -1.0]
    mask = np.arange(len(log.t)) < 90
    error = np.where(np.abs(v) > 0.1, [0.3, 0.4], 7.0)
    error[~mask] = 9.0
    exact = file_torque(robot, SimpleNamespace(robot=robot), replace(log, v=v))
    motion = replace(log, v=v, mask=mask, tau=exact + error)
    model = SimpleNamespace(
        robot=robot,
        standing=np.full(2, 0.1),
        cutoff=10.0,
        predict=lambda m: m.tau - 2.0 * error,
    )
    found = gaps(model, robot, [motion])
    for name in ("as it was", "exported"):
        np.testing.assert_allclose(found[name], [0.3, 0.4], rtol=1e-9)
    np.testing.assert_allclose(found["model"], [0.6, 0.8], rtol=1e-9)


def test_friction_is_written_for_the_speeds_of_the_motions_that_are_given(monkeypatch):
    given = []
    monkeypatch.setattr(
        simulator_model,
        "build_simulator",
        lambda *_, motions, **__: given.append(motions),
    )
    model, logs = model_of(pendulum(2)), swings(2, count=2, seconds=1.0)
    model_simulator(model, motions=logs)
    model_simulator(model)
    assert given[0] is logs
    (usual,) = given[1]
    np.testing.assert_array_equal(usual.v, usual_motion(model).v)
