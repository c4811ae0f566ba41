"""Write a dynamic model as a program: the operations from one state to its torque."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid.arrays import Array
from hybrid.compensator.arm_remainder import ArmRemainder
from hybrid.dynamics.law import Law
from hybrid.dynamics.newton_euler import newton_euler
from hybrid.dynamics.tape import Tape
from hybrid.effects import Effect, JointState
from hybrid.errors import EffectError, HybridError
from hybrid.signals.filters import LOWER_BAND

if TYPE_CHECKING:
    from hybrid.model.dynamic_model import DynamicModel


@dataclass(frozen=True)
class Program:
    """Program that computes torque and the next memory from the state of an arm.

    Inputs on the tape are ``q[j]``, ``v[j]``, ``a[j]``, ``t`` (time since the start,
    [s]), ``step`` (time since the last call, [s]), ``known`` (1 if there was a call
    before, else 0) and ``memory[i]``.

    Attributes:
        joints: Joint names.
        tape: The operations.
        torque: Torque of the drives, length n, [N·m].
        variance: Variance of its learned part, length n, [(N·m)²]; NaN without one.
        memory: Values to keep for the next call, length s.
        memory_names: Name of each value.
        left_out: Effects that are not in the program, and why.
    """

    joints: tuple[str, ...]
    tape: Tape
    torque: tuple[Any, ...]
    variance: tuple[Any, ...]
    memory: tuple[Any, ...]
    memory_names: tuple[str, ...]
    left_out: tuple[str, ...]

    @property
    def results(self) -> tuple[Any, ...]:
        """Torque, variance and memory."""
        return (*self.torque, *self.variance, *self.memory)

    @property
    def uses(self) -> frozenset[str]:
        """Names of the inputs that the results depend on."""
        lines = (self.tape.lines[k] for k in self.tape.needed(self.results))
        return frozenset(str(x.arguments[0]) for x in lines if x.name == "input")

    def widths(self) -> tuple[dict[str, int], dict[str, int]]:
        """Columns of each input that is used, and of each output."""
        n, s = len(self.joints), len(self.memory)
        given = {"q": n, "v": n, "a": n}
        given |= {x: 1 for x in ("t", "step", "known") if x in self.uses}
        found = {"tau": n, "variance": n}
        if s:
            given["memory"] = found["memory_out"] = s
        return given, found

    def run(
        self,
        q: Array,
        v: Array,
        a: Array,
        *,
        memory: Array | None = None,
        t: float = 0.0,
        step: float = 0.001,
    ) -> tuple[Array, Array]:
        """Compute torque, shape (N, n), [N·m], and memory, shape (N, s), of N states.

        Inputs are those of the tape, with the memory of the last call, shape (N, s), or
        None for the first one.
        """
        past = np.zeros((len(q), len(self.memory))) if memory is None else memory
        known = 0.0 if memory is None else 1.0
        found = self._law.along((q, v, a, past), (t, step, known))
        return found[:, : len(self.joints)], found[:, len(self.joints) :]

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of all inputs, in the order of q, v, a, memory, t, step and known."""
        names = [f"{x}[{j}]" for x in "qva" for j in range(len(self.joints))]
        names += [f"memory[{i}]" for i in range(len(self.memory))]
        return (*names, "t", "step", "known")

    @cached_property
    def _law(self) -> Law:
        return Law(self.tape, (*self.torque, *self.memory), self.inputs)


def program_from_model(model: DynamicModel) -> Program:
    """Write a model as a program.

    Raises:
        EffectError: An effect needs more than one state and a few values of memory.
    """
    robot, tape, n = model.robot, Tape(), model.robot.size
    left_out = [
        f"{e.id} of {', '.join(robot.joints[j] for j in e.joints)}: {e.not_in_loop}"
        for e in model.effects if e.not_in_loop
    ]  # fmt: skip
    effects = [e for e in model.effects if not e.not_in_loop]
    q, v, a = ([tape.input(f"{x}[{j}]") for j in range(n)] for x in "qva")
    for effect in effects:
        for j in effect.joints if effect.observes else ():
            q[j], v[j], a[j] = _traced(effect.true_state, effect, q[j], v[j], a[j])
    load, torque = _rigid_torque(model, effects, q, v, a)
    t, memory = tape.input("t"), _Memory(tape)
    states = [JointState(t, q[j], v[j], a[j], np.sign(v[j]), load[j]) for j in range(n)]
    for effect in effects:
        if not effect.observes and _rigid_change(model, effect) is None:
            own = [states[j] for j in effect.joints]
            values = memory.run(effect.at_instant, effect, own, own)
            for j, x in zip(effect.joints, values, strict=True):
                torque[j] = torque[j] + x
    for effect in effects:
        if effect.reports or effect.asks:
            own = [states[j] for j in effect.joints]
            given = [torque[j] for j in effect.joints]
            rest = [0.0] * len(given)
            if shows_noise(effect) and np.isfinite(model.cutoff):
                smooth = [memory.smoothed(effect, x, model.cutoff) for x in given]
                rest = [x - y for x, y in zip(given, smooth, strict=True)]
                given = smooth
            values = memory.run(effect.report_at_instant, effect, own, given)
            for j, x, y in zip(effect.joints, values, rest, strict=True):
                torque[j] = x + y
    learned = model.remainder or ArmRemainder(n, ())
    mean, variance = learned.at_instant(q, v)
    torque = [x + y for x, y in zip(torque, mean, strict=True)]
    return Program(
        robot.joints, tape, tuple(torque), tuple(variance), tuple(memory.now),
        tuple(memory.names), tuple(left_out),
    )  # fmt: skip


def shows_noise(effect: Effect) -> bool:
    """Whether an effect adds a derivative of the torque to it, as a drive's lag does.

    Positions are noisy up to twice the cut-off: such a law would show the noise of a
    third derivative, which no fit has seen.
    """
    return effect.reports and effect.differentiates and bool(effect.actuator)


def is_instant(model: DynamicModel, effect: Effect) -> bool:
    """Whether the torque of an effect is a law of one state, which can be traced."""
    if _rigid_change(model, effect) is not None:
        return True
    if effect.changes_signals or effect.asks or effect.memory or effect.not_in_loop:
        return False
    tape = Tape()
    t, q, v, a, load = map(tape.input, ("t", "q", "v", "a", "load"))
    state = JointState(t, q, v, a, np.sign(v), load)
    try:
        values, _ = effect.at_instant([state] * len(effect.joints), (), 0.0)
    except (HybridError, TypeError, ValueError):
        return False
    return t.line not in tape.needed(values)


def _rigid_change(model: DynamicModel, effect: Effect) -> tuple[Array, Array] | None:
    return effect.rigid_change(model.robot.size, model.robot.chain.gravity)


def _rigid_torque(
    model: DynamicModel, effects: Sequence[Effect], q: Any, v: Any, a: Any
) -> tuple[list[Any], list[Any]]:
    """Torque of the links, without and with changes of links and of gravity."""
    chain, still = model.robot.chain, [0.0] * model.robot.size
    changes = [x for e in effects if (x := _rigid_change(model, e)) is not None]
    inertial, down = model.link_parameters.tolist(), chain.gravity.tolist()
    load = newton_euler(chain, inertial, down, q=q, v=v, a=a)
    torque = list(load)
    if changes:
        links, gravity = (sum(x[1:], x[0]).tolist() for x in zip(*changes, strict=True))
        moving = newton_euler(chain, links, down, q=q, v=v, a=a)
        static = newton_euler(chain, inertial, gravity, q=q, v=still, a=still)
        parts = zip(load, moving, static, strict=True)
        torque = [x + y + z for x, y, z in parts]
    return load, torque


class _Memory:
    """Memory of all effects."""

    def __init__(self, tape: Tape) -> None:
        self.tape = tape
        self.names: list[str] = []
        self.now: list[Any] = []
        self._first: dict[int, int] = {}

    def run(
        self, law: Any, effect: Effect, states: Sequence[JointState], given: Any
    ) -> Sequence[Any]:
        """Evaluate a law of an effect with its memory, and keep the new memory."""
        if id(effect) not in self._first:
            self._first[id(effect)] = self._added(effect, effect.memory)
        first = self._first[id(effect)]
        begin = enumerate(effect.begin(states), first)
        before = tuple(self._past(place, x) for place, x in begin)
        values, now = _traced(law, effect, given, before, self.tape.input("step"))
        self.now[first : first + len(now)] = now
        return values  # type: ignore[no-any-return]

    def smoothed(self, effect: Effect, now: Any, cutoff: float) -> Any:
        """A torque up to the lower half of a cut-off, [Hz], by a filter of first order.

        It has only the past: it lets more pass than that of whole motions, and later.
        """
        first = self._added(effect, ("torque", "smoothed"))
        before, smooth = self._past(first, now), self._past(first + 1, now)
        step, time = self.tape.input("step"), 1.0 / (2 * np.pi * LOWER_BAND * cutoff)
        smooth = smooth + step / (step + 2 * time) * (now + before - 2.0 * smooth)
        self.now[-2:] = now, smooth
        return smooth

    def _added(self, effect: Effect, names: Sequence[str]) -> int:
        """Add values of an effect, and return the place of the first."""
        where = "+".join(str(j + 1) for j in effect.joints)
        self.names += [f"{effect.id} {where}: {x}" for x in names]
        self.now += [0.0] * len(names)
        return len(self.names) - len(names)

    def _past(self, place: int, first: Any) -> Any:
        """Value kept at a place in the last call; ``first`` if there was none."""
        known = self.tape.input("known") > 0.5
        kept = self.tape.input(f"memory[{place}]")
        return self.tape.apply("where", known, kept, first)


def _traced(law: Any, effect: Effect, *given: Any) -> Any:
    try:
        return law(*given)
    except EffectError:
        raise
    except (HybridError, TypeError, ValueError) as error:
        raise EffectError(f"{effect.id} cannot be exported: {error}") from error
