"""Learned remainders of every kind: they learn, know their limits, and are safe."""

from functools import cache

import numpy as np
import pytest
from learners import NetworkRegression, RandomFeatureRegression, SymmetricRegression
from learners.em import fit_structured
from learners.network import groups

from hybrid.compensator.gmr_fit import fit_gmr
from hybrid.errors import HybridError

BOUND, NOISE = 0.6, 0.03
HISTORY = 4
ODD = np.array([1.0, -1.0])


def fit_mixture(x, y, **options):
    return fit_gmr(x, y, components=6, **options)


def fit_low_rank(x, y, **options):
    return fit_structured(x, y, structure="low_rank", rank=1, components=6, **options)


def fit_network(x, y, **options):
    return NetworkRegression.fit(x, y, width=12, epochs=20, **options)


def fit_convolution(x, y, **options):
    return NetworkRegression.fit(x, y, width=12, epochs=20, history=HISTORY, **options)


def fit_features(x, y, **options):
    return RandomFeatureRegression.fit(x, y, features=30, **options)


def fit_symmetric(x, y, **options):
    return SymmetricRegression.fit(
        x, y, signs=ODD, parity=-1.0, learn=fit_features, **options
    )


KINDS = {
    "mixture": fit_mixture,
    "low rank": fit_low_rank,
    "network": fit_network,
    "convolution": fit_convolution,
    "random features": fit_features,
    "symmetric": fit_symmetric,
}


def torque(x):
    """Friction with a bend: odd in speed, the last column; even in position."""
    return 0.5 * np.tanh(3 * x[:, -1:]) * (1.0 + 0.3 * x[:, -2:-1] ** 2)


def samples(kind, count=1600, seed=0):
    rng = np.random.default_rng(seed)
    width = 2 * HISTORY if kind == "convolution" else 2
    x = rng.uniform(-1, 1, (count, width))
    return x, torque(x) + NOISE * rng.normal(size=(count, 1))


@cache
def learned(kind):
    return KINDS[kind](*samples(kind), bound=BOUND, seed=0)


def rms(x):
    return float(np.sqrt(np.mean(np.square(x))))


each = pytest.mark.parametrize("kind", KINDS)


@each
def test_it_learns_and_states_its_error(kind):
    x, y = samples(kind, seed=1)
    mean, variance = learned(kind).predict_distribution(x)
    # A low rank joins inputs by one line a component: it is coarser.
    left = 0.6 if kind == "low rank" else 0.35
    assert rms(y - mean) < left * rms(y)
    inside = np.mean(np.abs(y - mean) < 1.645 * np.sqrt(variance))
    assert 0.75 < inside <= 1.0


@each
def test_a_quarter_of_a_million_random_inputs_give_bounded_torque(kind):
    model, rng = learned(kind), np.random.default_rng(5)
    for _ in range(10):
        x = rng.normal(size=(25_000, model.inputs))
        x *= 10.0 ** rng.uniform(-3, 12, (len(x), 1))
        mean, variance = model.predict_distribution(x)
        assert np.abs(mean).max() <= BOUND + 1e-12
        assert np.isfinite(variance).all()
        assert (variance > 0).all()


@each
def test_far_outside_its_data_it_is_silent_and_unsure(kind):
    model = learned(kind)
    far = np.concatenate([s * np.eye(model.inputs) for s in (30.0, -1e3, 1e300)])
    mean, variance = model.predict_distribution(far)
    assert not mean.any()
    _, y = samples(kind)
    np.testing.assert_allclose(variance, np.mean(y**2), rtol=0.01)


@each
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_it_refuses_numbers_that_are_not_finite(kind, bad):
    model = learned(kind)
    x = np.zeros((3, model.inputs))
    x[1, 0] = bad
    with pytest.raises(HybridError, match="at row 1, column 0; valid are finite"):
        model.predict(x)


@each
def test_equal_seeds_give_equal_models(kind):
    x, y = samples(kind, 600)
    models = [KINDS[kind](x, y, seed=4) for _ in range(2)]
    assert np.array_equal(models[0].predict(x), models[1].predict(x))


def test_a_symmetry_holds_exactly():
    model, x = learned("symmetric"), samples("symmetric", 500, seed=6)[0]
    np.testing.assert_array_equal(model.predict(x * ODD), -model.predict(x))
    _, variance = model.predict_distribution(x)
    _, mirrored = model.predict_distribution(x * ODD)
    np.testing.assert_allclose(mirrored, variance, rtol=1e-12)


def test_a_symmetry_of_signs_other_than_one_is_refused():
    with pytest.raises(HybridError, match="valid is −1 or 1 for each input"):
        SymmetricRegression(learned("network"), np.array([1.0, 2.0]), -1.0)


def test_a_history_that_has_no_layers_is_refused():
    assert groups(1) == [1]
    assert groups(16) == [4, 4]
    x, y = samples("network", 50)
    with pytest.raises(HybridError, match="history is 2"):
        NetworkRegression.fit(x, y, history=2)


def test_a_diagonal_mixture_has_no_slope_within_a_component():
    model = fit_structured(*samples("mixture"), structure="diagonal", components=3)
    assert not model.conditional.gain.any()
