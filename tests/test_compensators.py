"""Learned remainders of every kind: they learn, know their limits, and are safe."""

from functools import cache

import numpy as np
import pytest
import torch
from learners import RandomFeatureRegression, SymmetricRegression

from hybrid.compensator import (
    GaussianMixtureRegression,
    NetworkRegression,
)
from hybrid.compensator.em import Mixture, log_likelihood, run_em, structured
from hybrid.compensator.envelope import Envelope
from hybrid.compensator.network import groups
from hybrid.errors import HybridError, ModelFileError

BOUND, NOISE = 0.6, 0.03
HISTORY = 4
ODD = np.array([1.0, -1.0])


def fit_gmr(x, y, **options):
    return GaussianMixtureRegression.fit(x, y, components=6, **options)


def fit_low_rank(x, y, **options):
    return GaussianMixtureRegression.fit(
        x, y, components=6, structure="low_rank", rank=1, **options
    )


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
    "mixture": fit_gmr,
    "low rank": fit_low_rank,
    "network": fit_network,
    "convolution": fit_convolution,
    "random features": fit_features,
    "symmetric": fit_symmetric,
}


def torque(x):
    """Friction with a bend: odd in speed, the last column; even in position."""
    return 0.5 * np.tanh(3 * x[:, -1:]) * (1.0 + 0.3 * x[:, -2:-1] ** 2)


def samples(kind, count=2500, seed=0):
    rng = np.random.default_rng(seed)
    width = 2 * HISTORY if kind == "convolution" else 2
    x = rng.uniform(-1, 1, (count, width))
    return x, torque(x) + NOISE * rng.normal(size=(count, 1))


@cache
def learned(kind):
    return KINDS[kind](*samples(kind), bound=BOUND, rng=0)


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
def test_a_million_random_inputs_give_bounded_torque(kind):
    model, rng = learned(kind), np.random.default_rng(5)
    for _ in range(10):
        x = rng.normal(size=(100_000, model.inputs))
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
def test_the_torch_module_has_the_same_mean_and_variance(kind):
    model = learned(kind)
    x = np.concatenate([samples(kind, 200, seed=2)[0] * s for s in (1.0, 3.0)])
    mean, variance = model.predict_distribution(x)
    found = [y.detach().numpy() for y in model.to_torch()(torch.tensor(x))]
    np.testing.assert_allclose(found[0], mean, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found[1], variance, rtol=1e-9, atol=1e-14)


@each
def test_saved_arrays_give_the_same_bits(kind):
    model, (x, _) = learned(kind), samples(kind, 100, seed=3)
    again = type(model).from_arrays(model.arrays())
    for ours, theirs in zip(
        model.predict_distribution(x), again.predict_distribution(x), strict=True
    ):
        assert np.array_equal(ours, theirs)


@each
def test_damaged_arrays_are_refused(kind):
    model = learned(kind)
    for name in model.arrays():
        arrays = dict(model.arrays())
        del arrays[name]
        with pytest.raises(ModelFileError):
            type(model).from_arrays(arrays)


@each
def test_equal_seeds_give_equal_models(kind):
    x, y = samples(kind, 600)
    models = [KINDS[kind](x, y, rng=4) for _ in range(2)]
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


def test_an_envelope_trusts_its_data_and_nothing_else():
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(3000, 3)), rng.normal(size=(3000, 1))
    envelope = Envelope.around(x, y, bound=None, rng=rng)
    assert np.mean(envelope.trust(envelope.standardised(x)) > 0.999) > 0.98
    assert not envelope.trust(envelope.standardised(10.0 * np.eye(3))).any()


# --- expectation maximisation ---------------------------------------------------------


def start_of(joint, count, seed=0):
    rng = np.random.default_rng(seed)
    means = joint[rng.choice(len(joint), count, replace=False)]
    eye = np.tile(np.eye(joint.shape[1]), (count, 1, 1))
    return Mixture(np.full(count, 1.0 / count), means, eye)


def joint_samples(seed=0, count=1500):
    rng = np.random.default_rng(seed)
    parts = [rng.normal(size=(count, 3)) @ rng.normal(size=(3, 3)) for _ in range(3)]
    return np.concatenate([x + 4 * rng.normal(size=3) for x in parts])


@pytest.mark.parametrize("structure", ["full", "diagonal", "low_rank"])
def test_no_pass_lowers_the_likelihood(structure):
    joint, mixture = joint_samples(), start_of(joint_samples(), 3)
    before = -np.inf
    for _ in range(8):
        mixture = run_em(
            joint, mixture, passes=1, floor=0.0, structure=structure, rank=1
        )
        now = log_likelihood(joint, mixture)
        assert now >= before - 1e-9 * abs(now)
        before = now


def test_one_component_is_the_sample_mean_and_covariance():
    joint = joint_samples()
    found = run_em(joint, start_of(joint, 1), passes=1, floor=0.0)
    np.testing.assert_allclose(found.means[0], joint.mean(axis=0), rtol=1e-9)
    expected = np.cov(joint.T, bias=True)
    np.testing.assert_allclose(found.covariances[0], expected, rtol=1e-8)


def test_a_low_rank_keeps_the_largest_directions_and_the_trace():
    rng = np.random.default_rng(1)
    root = rng.normal(size=(1, 5, 5))
    free = root @ root.transpose(0, 2, 1)
    (low,) = structured(free, "low_rank", 2)
    values, expected = np.linalg.eigvalsh(low), np.linalg.eigvalsh(free[0])
    np.testing.assert_allclose(values[-2:], expected[-2:])
    np.testing.assert_allclose(values[:3], expected[:3].mean())
    assert np.trace(low) == pytest.approx(np.trace(free[0]))


def test_old_samples_and_new_ones_weigh_as_many_as_they_are():
    rng = np.random.default_rng(2)
    old, new = rng.normal(size=(900, 2)), rng.normal(size=(300, 2)) + 1.0
    known = run_em(old, start_of(old, 1), passes=1, floor=0.0)
    found = run_em(new, known, passes=1, floor=0.0, known=900.0)
    both = np.concatenate([old, new])
    np.testing.assert_allclose(found.means[0], both.mean(axis=0), atol=1e-12)
    expected = np.cov(both.T, bias=True)
    np.testing.assert_allclose(found.covariances[0], expected, atol=1e-12)


def test_an_update_learns_a_change_and_keeps_what_it_was_not_shown():
    rng = np.random.default_rng(3)
    model = learned("mixture")
    x = rng.uniform(-1, 1, (1500, 2))
    right = x[:, 0] > 0.3
    changed = torque(x) + 0.15
    updated = model.updated(x[right], changed[right], known=300.0, passes=6)
    probe = rng.uniform(-1, 1, (800, 2))
    new, old = probe[:, 0] > 0.6, probe[:, 0] < -0.6
    before = rms(model.predict(probe[new]) - torque(probe[new]) - 0.15)
    after = rms(updated.predict(probe[new]) - torque(probe[new]) - 0.15)
    assert after < 0.6 * before
    kept = rms(updated.predict(probe[old]) - torque(probe[old]))
    assert kept < 0.1


def test_an_update_that_counts_for_nothing_is_refused():
    with pytest.raises(HybridError, match="known is 0"):
        learned("mixture").updated(*samples("mixture", 50), known=0.0)


def test_passes_over_all_samples_do_better_than_a_draw():
    x, y = samples("mixture", 20_000)
    options = {"components": 4, "max_samples": 200, "covariance_floor": 1e-3}
    drawn = GaussianMixtureRegression.fit(x, y, **options)
    passed = GaussianMixtureRegression.fit(x, y, passes=20, **options)
    probe, truth = samples("mixture", 2000, seed=9)
    assert rms(passed.predict(probe) - truth) < rms(drawn.predict(probe) - truth)


def test_a_diagonal_mixture_has_no_slope_within_a_component():
    x, y = samples("mixture")
    model = GaussianMixtureRegression.fit(x, y, components=3, structure="diagonal")
    assert not model.conditional.gain.any()
