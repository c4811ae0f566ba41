"""Learned remainders, number by number: fades, evidence, choices, what is refused."""

import numpy as np
import pytest
from learners import RandomFeatureRegression, SymmetricRegression
from learners.random_features import _evidence, _features
from scipy.stats import multivariate_normal
from test_gmr import random_mixture, sample

from hybrid.compensator import (
    GaussianMixtureRegression,
    NetworkRegression,
)
from hybrid.compensator.arm_remainder import ArmRemainder, JointRemainder
from hybrid.compensator.checks import check_matrix, check_pair, draw
from hybrid.compensator.em import Mixture, log_likelihood, run_em
from hybrid.compensator.envelope import Envelope
from hybrid.compensator.gmr_fit import (
    _bic,
    _usable,
    choose_components,
    predictive_log_likelihood,
)
from hybrid.compensator.network import LOG_VARIANCE, groups
from hybrid.errors import HybridError, IdentificationError, ModelFileError


def smooth(u):
    """The fade's step from 0 to 1 and flat at both ends."""
    return u * u * (3.0 - 2.0 * u)


def one_component(d=2, bound=5.0, fade=(2.0, 8.0)):
    """A single round component: its distance is that of the inputs."""
    return Envelope(
        offset=np.arange(d, dtype=float),
        scale=np.full(d, 2.0),
        whitening=np.eye(d)[None],
        centre=np.zeros((1, d)),
        prior_variance=np.array([9.0]),
        bound=np.array([bound]),
        fade=np.array(fade),
    )


# --- the envelope ---------------------------------------------------------------------


def test_trust_falls_with_the_squared_distance_from_start_to_end_of_the_fade():
    envelope = one_component()
    for squared, u in ((0.0, 1.0), (2.0, 1.0), (5.0, 0.5), (6.5, 0.25), (8.0, 0.0)):
        z = np.array([[np.sqrt(squared), 0.0]])
        assert envelope.trust(z)[0] == pytest.approx(smooth(u), abs=1e-12)
    two = Envelope(
        np.zeros(1), np.ones(1), np.ones((2, 1, 1)), np.array([[0.0], [3.0]]),
        np.ones(1), np.ones(1), np.array([0.5, 4.0]),
    )  # fmt: skip
    z = 1.5
    distance = -2 * np.log(2 * np.exp(-(z**2) / 2))
    u = (4.0 - distance) / 3.5
    assert two.trust(np.array([[z]]))[0] == pytest.approx(smooth(u))


def test_inputs_are_standardised_and_cut_off_a_million_deviations_away():
    envelope = one_component()
    z = envelope.standardised([[4.0, 1.0], [1e300, -1e300]])
    np.testing.assert_allclose(z, [[2.0, 0.0], [1e6, -1e6]], rtol=1e-9)


def test_mean_and_variance_are_handed_over_to_the_prior():
    envelope = one_component()
    z = np.sqrt(np.array([[0.0, 0.0], [5.0, 0.0], [9.0, 0.0]]))
    mean, variance = np.array([[2.0], [7.0], [2.0]]), np.full((3, 1), 0.5)
    blended, spread = envelope.blended(z, mean, variance)
    np.testing.assert_allclose(blended[:, 0], [2.0, 2.5, 0.0])
    # Of two sources with equal chance: the mean variance, and what their means differ.
    middle = 0.5 * 0.5 + 0.5 * 9.0 + 0.25 * 5.0**2
    np.testing.assert_allclose(spread[:, 0], [0.5, middle, 9.0])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("scale", [0.0, 1.0]),
        ("scale", [1.0]),
        ("fade", [0.0, 1.0]),
        ("fade", [2.0, 2.0]),
        ("bound", [np.nan]),
        ("centre", [[0.0, np.inf]]),
    ],
)
def test_a_damaged_envelope_is_refused(name, value):
    arrays = one_component().arrays()
    again = Envelope.from_arrays(arrays)
    np.testing.assert_array_equal(again.offset, [0.0, 1.0])
    with pytest.raises(ModelFileError, match="envelope is damaged"):
        Envelope.from_arrays(arrays | {f"envelope.{name}": np.array(value)})


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
    assert not arm._together[2]  # that are worked out by themselves
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


def test_a_mixture_that_fades_late_is_worked_out_by_itself():
    near, late = (
        GaussianMixtureRegression(
            **{**random_mixture(0).arrays(), "fade": np.array([end / 4, end])}
        )
        for end in (1000.0, 1001.0)
    )
    for model, alone in ((near, 0), (late, 1)):
        arm = ArmRemainder(1, (JointRemainder(0, (0,), (), model),))
        assert len(arm._together[2]) == alone


def test_numbers_of_inputs_that_do_not_match_are_refused():
    arm = ArmRemainder(2, (JointRemainder(1, (0,), (1,), random_mixture(0, d=2)),))
    content = arm.as_dict()
    assert content == [{"kind": "gmr", "joint": 1, "positions": [0], "speeds": [1]}]
    again = ArmRemainder.from_dict(2, content, arm.arrays())
    assert again.parts[0].positions == (0,) and again.parts[0].speeds == (1,)
    with pytest.raises(ModelFileError, match="inputs do not match"):
        ArmRemainder.from_dict(2, [content[0] | {"speeds": []}], arm.arrays())
    with pytest.raises(ModelFileError, match="remainder 0 is damaged"):
        ArmRemainder.from_dict(2, [content[0] | {"kind": "none"}], arm.arrays())


def test_by_itself_a_fit_tries_powers_of_two_and_finds_two_parts():
    rng = np.random.default_rng(0)
    side = np.where(rng.random(3000) < 0.5, -4.0, 4.0)[:, None]
    x = side + rng.normal(size=(3000, 1))
    y = np.where(side > 0, x, -2.0 * x) + 0.3 * rng.normal(size=x.shape)
    held_out = slice(2000, None)
    model = GaussianMixtureRegression.fit(
        x[:2000], y[:2000], validation=(x[held_out], y[held_out])
    )
    assert model.components == 2


def test_the_likelihood_is_the_sum_of_the_logs_of_the_density():
    rng = np.random.default_rng(0)
    joint, means = rng.normal(size=(50, 2)), np.array([[0.0, 1.0], [2.0, -1.0]])
    covariances = np.array([[[2.0, 0.5], [0.5, 1.0]], [[1.0, 0.0], [0.0, 3.0]]])
    mixture = Mixture(np.array([0.3, 0.7]), means, covariances)
    density = sum(
        w * multivariate_normal(m, S).pdf(joint)
        for w, m, S in zip(mixture.weights, means, covariances, strict=True)
    )
    assert log_likelihood(joint, mixture) == pytest.approx(np.log(density).sum())


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


@pytest.mark.parametrize(
    ("structure", "free"), [("full", 6), ("diagonal", 3), ("low_rank", 2 * 3 + 1)]
)
def test_bic_counts_the_free_numbers_of_a_structure(structure, free):
    rng = np.random.default_rng(0)
    joint = rng.normal(size=(500, 3))
    mixture = Mixture(
        np.full(2, 0.5), rng.normal(size=(2, 3)), np.stack([np.eye(3)] * 2)
    )
    parameters = 2 * (1 + 3 + free) - 1
    expected = parameters * np.log(500) - 2 * log_likelihood(joint, mixture)
    assert _bic(joint, mixture, structure, 2) == pytest.approx(expected)


def test_components_need_one_sample_more_each_than_they_have_rows():
    assert _usable((8, 2, 1, 2, 0), samples=16, width=3) == [1, 2]
    assert _usable((4, 5), samples=16, width=3) == [4]
    with pytest.raises(IdentificationError, match="valid is 1 to 4"):
        _usable((5,), samples=16, width=3)


def test_the_fade_starts_where_all_but_a_two_hundredth_of_the_samples_lie():
    x, y = sample(0, n=4000)
    model = GaussianMixtureRegression.fit(x, y, components=4)
    start, end = model.fade
    assert end == 4.0 * start
    assert np.mean(model.distance(x) > start) == pytest.approx(0.005, abs=0.001)
    np.testing.assert_allclose(model.prior_variance, (y**2).mean(axis=0), rtol=1e-9)
    np.testing.assert_allclose(model.bound, np.abs(y).max())
    np.testing.assert_allclose(model.input_offset, x.mean(axis=0))
    np.testing.assert_allclose(model.input_scale, x.std(axis=0))


def test_a_pass_gives_every_component_the_moments_of_its_share():
    rng = np.random.default_rng(0)
    joint = np.concatenate([rng.normal(size=(300, 2)), 3 + rng.normal(size=(700, 2))])
    start = Mixture(
        np.full(2, 0.5), np.array([[0.0, 0], [3, 3]]), np.stack([np.eye(2)] * 2)
    )
    density = [0.5 * np.exp(-0.5 * ((joint - m) ** 2).sum(axis=1)) for m in start.means]
    share = np.array(density) / np.sum(density, axis=0)
    found = run_em(joint, start, passes=1, floor=0.01)
    np.testing.assert_allclose(found.weights, share.mean(axis=1))
    for k in range(2):
        mean = share[k] @ joint / share[k].sum()
        off = joint - mean
        spread = (share[k][:, None] * off).T @ off / share[k].sum() + 0.01 * np.eye(2)
        np.testing.assert_allclose(found.means[k], mean)
        np.testing.assert_allclose(found.covariances[k], spread)


# --- random features ------------------------------------------------------------------


def test_features_are_cosines_whose_products_are_the_kernel():
    rng = np.random.default_rng(0)
    directions, phases = rng.normal(size=(2, 20_000)), rng.uniform(0, 2 * np.pi, 20_000)
    z = rng.normal(size=(5, 2))
    phi = _features(z, directions, phases)
    apart = ((z[:, None] - z) ** 2).sum(axis=2)
    np.testing.assert_allclose(phi @ phi.T, np.exp(-0.5 * apart), atol=0.04)


def test_the_evidence_is_the_likelihood_of_the_data_with_the_weights_integrated_out():
    rng = np.random.default_rng(0)
    phi, y = rng.normal(size=(30, 6)), rng.normal(size=(30, 2))
    values, vectors = np.linalg.eigh(phi.T @ phi)
    seen = vectors.T @ phi.T @ y
    scores, exact = [], []
    for noise in (0.3, 0.7, 1.5):
        scores.append(_evidence(values, seen, y, noise))
        # Weights of unit variance.
        S = phi @ phi.T + noise**2 * np.eye(30)
        exact.append(
            -0.5 * (np.sum(y * np.linalg.solve(S, y)) + 2 * np.linalg.slogdet(S)[1])
        )
    np.testing.assert_allclose(np.diff(scores), np.diff(exact), rtol=1e-9)


def test_length_and_noise_of_random_features_follow_the_data():
    rng = np.random.default_rng(0)
    x = rng.uniform(-2, 2, (800, 1))
    lengths, noises = [], []
    for wave, noise in ((1.0, 0.05), (6.0, 0.05), (1.0, 0.5)):
        y = np.sin(wave * x) + noise * rng.normal(size=x.shape)
        model = RandomFeatureRegression.fit(x, y, features=80)
        lengths.append(1 / np.sqrt(np.mean(model.directions**2)))
        noises.append(np.sqrt(model.noise[0]))
        inside = np.abs(x[:, 0]) < 1.8
        error = model.predict(x[inside]) - np.sin(wave * x[inside])
        assert np.sqrt(np.mean(error**2)) < 0.35 * noise + 0.01
    assert lengths[0] > 1.5 * lengths[1]
    np.testing.assert_allclose(noises, [0.05, 0.05, 0.5], rtol=0.15)


def test_variance_of_random_features_is_noise_and_doubt_of_the_weights():
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (300, 1))
    model = RandomFeatureRegression.fit(
        x, x + 0.1 * rng.normal(size=x.shape), features=20
    )
    near = model.predict_distribution(np.array([[0.0]]))[1][0, 0]
    assert near == pytest.approx(model.noise[0], rel=0.1) and near > model.noise[0]
    phi = _features(model.envelope.standardised(x), model.directions, model.phases)
    doubt = np.einsum("np,pr,nr->n", phi, model.factor @ model.factor.T, phi)
    expected = model.noise[0] * (1 + doubt)
    trust = model.envelope.trust(model.envelope.standardised(x))
    sure = trust == 1.0
    found = model.predict_distribution(x)[1][:, 0]
    np.testing.assert_allclose(found[sure], expected[sure], rtol=1e-9)


# --- networks and symmetry ------------------------------------------------------------


def test_histories_join_in_fours():
    found = [groups(h) for h in (1, 4, 16, 2, 8, 12)]
    assert found == [[1], [4], [4, 4], None, None, None]


def network(weight, bias, m=1):
    """One layer from two inputs to mean and log variance."""
    envelope = one_component(fade=(1e3, 1e4), bound=50.0)
    return NetworkRegression(envelope, 1, ((weight, bias),), np.full(m, 3.0))


def test_a_network_of_one_layer_is_its_formula():
    W, b = np.array([[1.0, 0.1], [-2.0, 0.2]]), np.array([0.5, -1.0])
    x = np.array([[2.0, 3.0], [0.0, 1.0]])
    z = (x - [0.0, 1.0]) / 2.0
    out = z @ W + b
    mean, variance = network(W, b).predict_distribution(x)
    np.testing.assert_allclose(mean[:, 0], 3.0 * out[:, 0])
    np.testing.assert_allclose(variance[:, 0], 9.0 * np.exp(out[:, 1]))
    for wanted, limit in zip((-99.0, 99.0), LOG_VARIANCE, strict=True):
        _, variance = network(0 * W, np.array([0.0, wanted])).predict_distribution(x)
        np.testing.assert_allclose(variance, 9.0 * np.exp(limit))
    # Between a millionth and four hundred times the size of the torque.
    np.testing.assert_allclose(np.exp(LOG_VARIANCE), [8.3e-7, 403.4], rtol=0.01)


def test_a_symmetric_regression_is_half_the_sum_with_its_mirror_image():
    inner = network(np.array([[1.0, 0.3], [-2.0, 0.2]]), np.array([0.5, -1.0]))
    x = np.array([[2.0, 3.0], [0.5, -1.0]])
    for parity in (-1.0, 1.0):
        model = SymmetricRegression(inner, np.array([1.0, -1.0]), parity)
        (a, s), (b, r) = (inner.predict_distribution(y) for y in (x, x * [1.0, -1.0]))
        mean, variance = model.predict_distribution(x)
        np.testing.assert_allclose(mean, 0.5 * (a + parity * b))
        np.testing.assert_allclose(variance, 0.5 * (s + r))
        np.testing.assert_allclose(model.predict(x), mean)
        assert model.inputs == 2 and model.outputs == 1
    with pytest.raises(HybridError, match="signs are"):
        SymmetricRegression(inner, np.array([1.0, 0.5]), 1.0)
    with pytest.raises(HybridError, match="parity is 0.5"):
        SymmetricRegression(inner, np.array([1.0, 1.0]), 0.5)


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
