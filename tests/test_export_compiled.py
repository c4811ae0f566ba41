"""The exported header, compiled and called from Python, as a control loop would."""

import compiled_model
import numpy as np
import pytest
from compiled_model import CompiledModel
from test_export import full_model, model_of, motion_of

from hybrid.effects.presliding import Presliding
from hybrid.errors import HybridError


@pytest.fixture(scope="module")
def fast():
    return CompiledModel(full_model())


def test_a_compiled_model_predicts_what_the_model_predicts(fast):
    model, motion = full_model(), motion_of(full_model().robot, 500)
    tau = fast.predict(motion.q, motion.v, motion.a)
    np.testing.assert_allclose(tau, model.predict(motion), rtol=0, atol=1e-9)
    one = fast.predict(motion.q[7], motion.v[7], motion.a[7])
    np.testing.assert_array_equal(one, tau[7])


def test_it_remembers_from_call_to_call_and_forgets_when_started_anew():
    robot = full_model().robot
    model = model_of(robot, [Presliding((1,), {"level": 3.0, "distance": 0.1})])
    fast = CompiledModel(model)
    q = np.outer(np.sin(np.arange(30) * 0.3), np.ones(6))
    still = np.zeros_like(q)
    whole = fast.predict(q, still, still)
    fast.start()
    steps = [fast.predict(q[k], still[k], still[k]) for k in range(30)]
    np.testing.assert_array_equal(steps, whole)


def test_numbers_that_are_not_finite_and_wrong_shapes_are_refused(fast):
    zero = np.zeros((2, 6))
    with pytest.raises(HybridError, match="not finite"):
        fast.predict(zero, zero * np.nan, zero)
    with pytest.raises(HybridError, match=r"valid is \(N, 6\)"):
        fast.predict(zero, zero, zero[:, :5])


def test_without_a_compiler_it_says_what_is_missing(monkeypatch):
    monkeypatch.setattr(compiled_model, "_COMPILERS", ("no-such-compiler",))
    with pytest.raises(HybridError, match="no C compiler"):
        CompiledModel(full_model())
