"""Learned remainders, number by number: fades, evidence, choices, what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from test_gmr import random_mixture, sample

from hybrid.compensator import GaussianMixtureRegression, gmr_fit
from hybrid.compensator.arm_remainder import ArmRemainder, JointRemainder
from hybrid.compensator.gmr import check_matrix
from hybrid.compensator.gmr_fit import (
    _usable,
    check_pair,
    choose_components,
    draw,
    fit_gmr,
    predictive_log_likelihood,
)
from hybrid.errors import HybridError, IdentificationError, ModelFileError

# --- mixtures -------------------------------------------------------------------------


def test_prediction_and_variance_of_a_mixture_are_those_of_its_formula():
    model = random_mixture(2, k=3, d=2)
    x = np.random.default_rng(0).normal(size=(40, 2))
    density, means, variances = [], [], []
    for w, mu, S in zip(model.weights, model.means, model.covariances, strict=True):
        inner = np.linalg.inv(S[:2, :2])
        off = x - mu[:2]
        square = np.einsum("ni,ij,nj->n", off, inner, off)
        density.append(w * np.exp(-0.5 * square) * np.sqrt(np.linalg.det(inner)))
        means.append(mu[2] + off @ inner @ S[:2, 2])
        variances.append(S[2, 2] - S[2, :2] @ inner @ S[:2, 2])
    h = np.array(density) / np.sum(density, axis=0)
    m, s = np.array(means), np.array(variances)[:, None]
    expected = (h * m).sum(axis=0)
    spread = (h * (s + m**2)).sum(axis=0) - expected**2
    mean, variance = model.predict_distribution(x)
    np.testing.assert_allclose(mean[:, 0], expected, rtol=1e-9)
    np.testing.assert_allclose(variance[:, 0], spread, rtol=1e-7)


def fading(mixture):
    """The same mixture, cut off where it is large, and trusted less and less."""
    changed = {"bound": np.array([0.8]), "fade": np.array([0.5, 60.0])}
    return GaussianMixtureRegression(**{**mixture.arrays(), **changed})


def test_an_arms_mixtures_together_are_each_of_them_apart():
    """Of other numbers of inputs and components, in blocks and single samples."""
    sizes = [(0, (0,), (), 1), (2, (0, 1), (2,), 4), (3, (3,), (1, 3), 2)]
    parts = tuple(
        JointRemainder(j, p, v, fading(random_mixture(j, k=k, d=len(p) + len(v))))
        for j, p, v, k in sizes
    )
    arm = ArmRemainder(4, parts)
    q, v = 3 * np.random.default_rng(1).normal(size=(2, 1700, 4))
    tau = arm.predict(q, v)
    away = [p.regression.distance(p.inputs(q, v)) for p in parts]
    assert all(((x > 0.5) & (x < 60.0)).mean() > 0.1 for x in away)
    assert not tau[:, 1].any()
    for part in parts:
        own = part.regression.predict(part.inputs(q, v))[:, 0]
        np.testing.assert_allclose(tau[:, part.joint], own, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(arm.predict(q[:1], v[:1]), tau[:1], rtol=1e-12)
    far = np.full((1, 4), 1e200)
    assert np.isfinite(arm.predict(far, far)).all()
    with pytest.raises(HybridError, match="finite"):
        arm.predict(q[:1] * np.nan, v[:1])


def test_numbers_of_inputs_that_do_not_match_are_refused():
    arm = ArmRemainder(2, (JointRemainder(1, (0,), (1,), random_mixture(0, d=2)),))
    content = arm.as_dict()
    assert content == [{"kind": "gmr", "joint": 1, "positions": [0], "speeds": [1]}]
    again = ArmRemainder.from_dict(2, content, arm.arrays())
    assert again.parts[0].positions == (0,) and again.parts[0].speeds == (1,)
    with pytest.raises(ModelFileError, match="inputs do not match"):
        ArmRemainder.from_dict(2, [content[0] | {"speeds": []}], arm.arrays())
    with pytest.raises(ModelFileError, match="of kind 'network'; valid is gmr"):
        ArmRemainder.from_dict(2, [content[0] | {"kind": "network"}], arm.arrays())


def test_by_itself_a_fit_tries_powers_of_two_and_finds_two_parts():
    rng = np.random.default_rng(0)
    side = np.where(rng.random(3000) < 0.5, -4.0, 4.0)[:, None]
    x = side + rng.normal(size=(3000, 1))
    y = np.where(side > 0, x, -2.0 * x) + 0.3 * rng.normal(size=x.shape)
    held_out = slice(2000, None)
    model = fit_gmr(x[:2000], y[:2000], validation=(x[held_out], y[held_out]))
    assert model.components == 2


def test_the_fewest_components_within_a_hundredth_of_a_nat_are_chosen():
    assert choose_components({1: -1.02, 2: -1.009, 4: -1.0, 8: -1.2}) == 2
    assert choose_components({1: -1.009, 2: -1.0}) == 1
    assert choose_components({1: -1.011, 2: -1.0}) == 2


def test_predictive_likelihood_is_that_of_the_stated_mean_and_variance():
    model = random_mixture(1)
    x, y = np.random.default_rng(0).normal(size=(2, 200, 1))
    mean, variance = model.predict_distribution(x)
    gauss = np.exp(-((y - mean) ** 2) / (2 * variance)) / np.sqrt(2 * np.pi * variance)
    expected = np.log(gauss).mean()
    assert predictive_log_likelihood(model, x, y) == pytest.approx(expected)


def test_components_need_one_sample_more_each_than_they_have_rows():
    assert _usable((8, 2, 1, 2, 0), samples=16, width=3) == [1, 2]
    assert _usable((4, 5), samples=16, width=3) == [4]
    with pytest.raises(IdentificationError, match="valid is 1 to 4"):
        _usable((5,), samples=16, width=3)


def test_the_fade_starts_where_all_but_a_two_hundredth_of_the_samples_lie():
    x, y = sample(0, n=4000)
    model = fit_gmr(x, y, components=4)
    start, end = model.fade
    assert end == 4.0 * start
    assert np.mean(model.distance(x) > start) == pytest.approx(0.005, abs=0.001)
    np.testing.assert_allclose(model.prior_variance, (y**2).mean(axis=0), rtol=1e-9)
    np.testing.assert_allclose(model.bound, np.abs(y).max())
    np.testing.assert_allclose(model.input_offset, x.mean(axis=0))
    np.testing.assert_allclose(model.input_scale, x.std(axis=0))


# --- checks ---------------------------------------------------------------------------


def test_what_is_no_matrix_is_refused_with_its_place():
    assert check_matrix("x", [[1, 2]], 2).shape == (1, 2)
    for bad, columns in (([1.0, 2.0], None), ([[1.0, 2.0]], 3)):
        with pytest.raises(HybridError, match="x has shape"):
            check_matrix("x", bad, columns)
    with pytest.raises(HybridError, match="is nan at row 1, column 0"):
        check_matrix("x", [[1.0, 2.0], [np.nan, np.inf]])
    for x, y in (([[1.0]], [[1.0], [2.0]]), (np.zeros((0, 1)), np.zeros((0, 1)))):
        with pytest.raises(HybridError, match="equal numbers of rows"):
            check_pair(x, y)


def test_a_draw_keeps_rows_together_and_in_order():
    x = np.arange(100.0)[:, None]
    few, same = draw(x, 2 * x, 10, np.random.default_rng(0))
    assert few.shape == (10, 1) and (np.diff(few[:, 0]) > 0).all()
    np.testing.assert_array_equal(same, 2 * few)
    everything, _ = draw(x, x, 100, np.random.default_rng(0))
    assert everything is x


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("weights", [0.5, 0.4, 0.1001], "sum 1"),
        ("weights", [0.0, 0.5, 0.5], "not positive"),
        ("input_scale", [0.0], "must be positive"),
        ("prior_variance", [0.0], "must be positive"),
        ("bound", [-1.0], "bound must not be negative"),
        ("fade", [0.0, 1.0], "fade must increase"),
        ("fade", [2.0, 2.0], "fade must increase"),
        ("input_offset", [np.inf], "not finite"),
    ],
)
def test_a_mixture_that_could_not_predict_is_refused(name, value, message):
    arrays = random_mixture(0).arrays()
    with pytest.raises(HybridError, match=message):
        GaussianMixtureRegression(**{**arrays, name: np.array(value)})
    silent = GaussianMixtureRegression(**{**arrays, "bound": np.zeros(1)})
    assert not silent.predict(np.zeros((3, 1))).any()


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_far_away_a_mixture_is_as_unsure_as_torque_is_large(size):
    """Whatever its unit."""
    x, y = sample(0, n=500)
    model = fit_gmr(x, size * y, components=1)
    np.testing.assert_allclose(model.prior_variance, size**2 * (y**2).mean(axis=0))
    _, variance = model.predict_distribution(np.full((1, 2), 1e3))
    np.testing.assert_allclose(variance[0], model.prior_variance, rtol=1e-6)


def test_a_score_is_a_log_likelihood_per_sample(monkeypatch):
    """Of white noise in d channels −d/2·(1 + log 2π), less what BIC asks of numbers."""
    seen = {}
    monkeypatch.setattr(gmr_fit, "choose_components", lambda s: seen.update(s) or 1)
    x, y = np.random.default_rng(0).normal(size=(2, 4000, 1))
    fit_gmr(x, y, components=(1, 2))
    bic = {1: 5, 2: 11}  # numbers of means, covariances and weights
    for count, numbers in bic.items():
        expected = -(1 + np.log(2 * np.pi)) - numbers * np.log(4000) / 8000
        assert seen[count] == pytest.approx(expected, abs=0.002)


def test_trust_falls_smoothly_from_one_to_nothing():
    """From the fade's start to its end, half of it in the middle of the distance."""
    mixture = random_mixture(3, k=1)
    near, far = 4.0, 16.0
    at = np.linspace(0.0, 20.0, 600)[:, None] + mixture.means[0, 0]
    whole, variance = mixture.predict_distribution(at)
    faded = replace(mixture, fade=np.array([near, far]))
    mean, spread = faded.predict_distribution(at)
    distance = mixture.distance(at)
    u = np.clip((far - distance) / (far - near), 0.0, 1.0)
    trust = (u**2 * (3 - 2 * u))[:, None]
    assert trust.min() == 0.0 and trust.max() == 1.0
    np.testing.assert_allclose(mean, trust * whole, atol=1e-9)
    expected = trust * variance + trust * (1 - trust) * whole**2 + (1 - trust)
    np.testing.assert_allclose(spread, expected, rtol=1e-6)
