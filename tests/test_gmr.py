"""Gaussian-mixture regression against closed forms and quadrature."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid.compensator import GaussianMixtureRegression
from hybrid.compensator.gmr_fit import fit_gmr
from hybrid.errors import HybridError, IdentificationError, ModelFileError


def residual(x):
    return 0.5 * np.sin(3 * x[:, :1]) + 0.3 * np.tanh(5 * x[:, 1:])


def sample(seed, *, n=8000, noise=0.02):
    """Position and speed in ±1, and a smooth torque with noise."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, (n, 2))
    return x, residual(x) + noise * rng.normal(size=(n, 1))


def joint_gaussian(seed, *, d=3, n=4000):
    rng = np.random.default_rng(seed)
    mix = rng.normal(size=(d + 1, d + 1))
    samples = rng.normal(size=(n, d + 1)) @ mix.T
    return samples[:, :d], samples[:, d:]


def random_mixture(seed, *, k=3, d=1):
    """An overlapping mixture that neither fades nor saturates near its data."""
    rng = np.random.default_rng(seed)
    factor = 0.6 * rng.normal(size=(k, d + 1, d + 1))
    return GaussianMixtureRegression(
        weights=rng.dirichlet(np.full(k, 5.0)),
        means=rng.normal(size=(k, d + 1)),
        covariances=factor @ factor.transpose(0, 2, 1) + 0.05 * np.eye(d + 1),
        input_offset=np.zeros(d),
        input_scale=np.ones(d),
        prior_variance=np.ones(1),
        bound=np.full(1, 100.0),
        fade=np.array([1e3, 4e3]),
    )


def rms(values):
    return np.sqrt(np.mean(values**2))


@pytest.fixture(scope="module")
def model():
    return fit_gmr(*sample(0), components=16)


@pytest.fixture(scope="module")
def wide():
    """Three inputs of different size and unit."""
    rng = np.random.default_rng(5)
    x = rng.uniform(-1, 1, (3000, 3)) * [1.0, 50.0, 1e-3] + [0.0, 300.0, 0.0]
    y = 10 * np.sin(3 * x[:, :1]) + 3 * (x[:, 1:2] - 300) / 50
    return fit_gmr(x, y + 0.3 * rng.normal(size=y.shape), components=6), x


def test_one_component_is_the_linear_regression():
    x, y = joint_gaussian(0)
    model = fit_gmr(x, y, components=1, covariance_floor=1e-12, bound=1e9)
    inside = model.distance(x) < model.fade[0]
    design = np.column_stack([np.ones(len(x)), x])
    coefficients, *_ = np.linalg.lstsq(design, y, rcond=None)
    mean, variance = model.predict_distribution(x[inside])
    np.testing.assert_allclose(mean, (design @ coefficients)[inside], atol=1e-9)
    expected = np.mean((y - design @ coefficients) ** 2, axis=0)
    np.testing.assert_allclose(variance, np.tile(expected, (len(mean), 1)), rtol=1e-8)


@pytest.mark.parametrize("seed", range(3))
def test_mean_and_variance_match_quadrature_over_the_joint_density(seed):
    from scipy.stats import multivariate_normal

    model = random_mixture(seed)
    x = np.linspace(-2, 2, 21)
    y = np.linspace(-30, 30, 40_001)
    grid = np.stack(np.broadcast_arrays(x[:, None], y), axis=-1)
    density = sum(
        w * multivariate_normal(mu, sigma).pdf(grid)
        for w, mu, sigma in zip(
            model.weights, model.means, model.covariances, strict=True
        )
    )
    density /= density.sum(axis=1, keepdims=True)
    mean = density @ y
    mean_here, variance_here = model.predict_distribution(x[:, None])
    np.testing.assert_allclose(mean_here[:, 0], mean, atol=1e-9)
    np.testing.assert_allclose(variance_here[:, 0], density @ y**2 - mean**2, rtol=1e-8)


def test_density_agrees_with_scikit_learn():
    from sklearn.mixture import GaussianMixture

    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (600, 1))
    y = np.sin(3 * x) + 0.1 * rng.normal(size=x.shape)
    scaled = [(v - v.mean(0)) / v.std(0) for v in (x, y)]
    model = fit_gmr(x, y, components=4, seed=7, bound=1e9)
    reference = GaussianMixture(
        4,
        reg_covar=1e-4,
        init_params="k-means++",
        max_iter=200,
        random_state=int(np.random.default_rng(7).integers(2**31)),
    ).fit(np.hstack(scaled))
    grid = np.linspace(-4, 4, 8001)
    points = scaled[0][:50]
    inside = model.distance(x[:50]) < model.fade[0]
    joint = np.stack(np.broadcast_arrays(points, grid), axis=-1).reshape(-1, 2)
    density = np.exp(reference.score_samples(joint)).reshape(len(points), -1)
    mean = y.mean() + y.std() * (density @ grid) / density.sum(axis=1)
    np.testing.assert_allclose(
        model.predict(x[:50])[inside, 0], mean[inside], atol=1e-6
    )


def test_order_of_components_does_not_matter(model):
    order = np.random.default_rng(0).permutation(model.components)
    other = replace(
        model,
        weights=model.weights[order],
        means=model.means[order],
        covariances=model.covariances[order],
    )
    x = np.random.default_rng(1).uniform(-2, 2, (500, 2))
    for a, b in zip(
        model.predict_distribution(x), other.predict_distribution(x), strict=True
    ):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)


def test_units_of_inputs_and_outputs_do_not_matter(model):
    x, y = sample(0)
    scale, offset = np.array([180 / np.pi, 1e-3]), np.array([40.0, -7.0])
    other = fit_gmr(x * scale + offset, 1e3 * y, components=16)
    probe = np.random.default_rng(1).uniform(-1.5, 1.5, (500, 2))
    mean, variance = model.predict_distribution(probe)
    mean_here, variance_here = other.predict_distribution(probe * scale + offset)
    np.testing.assert_allclose(mean_here, 1e3 * mean, rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(variance_here, 1e6 * variance, rtol=1e-5)
    # In MN·m a floor on variance that is not relative would hide what far inputs give.
    small = fit_gmr(x, 1e-6 * y, components=2)
    large = fit_gmr(x, y, components=2)
    np.testing.assert_allclose(small.prior_variance, 1e-12 * large.prior_variance)


def test_smooth_remainder_is_cut_by_nine_tenths_on_held_out_samples(model):
    x, y = sample(1, noise=0.0)
    assert rms(y - model.predict(x)) < 0.1 * rms(y)


def test_intervals_of_90_percent_cover_heteroscedastic_truth():
    def draw(seed):
        rng = np.random.default_rng(seed)
        x = rng.uniform(-1, 1, (8000, 1))
        return x, np.sin(3 * x) + (0.05 + 0.2 * np.abs(x)) * rng.normal(size=x.shape)

    model = fit_gmr(*draw(0), validation=draw(1))
    x, y = draw(2)
    mean, variance = model.predict_distribution(x)
    covered = np.abs(y - mean) < 1.645 * np.sqrt(variance)
    for part in (np.abs(x) < 0.3, np.abs(x) > 0.7, np.full(x.shape, True)):
        assert 0.85 < covered[part].mean() < 0.95


@settings(max_examples=200)
@given(
    angle=st.floats(0, 2 * np.pi),
    radius=st.floats(20, 1e300, allow_nan=False),
)
def test_far_outside_the_mean_is_zero_and_the_variance_the_prior(angle, radius):
    model = far_model()
    x = radius * np.array([[np.cos(angle), np.sin(angle)]])
    mean, variance = model.predict_distribution(x)
    assert (mean == 0).all()
    np.testing.assert_array_equal(variance[0], model.prior_variance)


_FAR = []


def far_model():
    if not _FAR:
        _FAR.append(fit_gmr(*sample(0, n=2000), components=4))
    return _FAR[0]


def test_within_the_fade_mixture_and_prior_share_the_variance(model):
    x = np.random.default_rng(0).uniform(-2, 2, (2000, 2))
    start, end = model.fade
    x = x[(model.distance(x) > start) & (model.distance(x) < end)]
    mean, variance = model.predict_distribution(x)
    unfaded = replace(model, fade=np.array([1e3, 4e3]))
    mixture_mean, mixture_variance = unfaded.predict_distribution(x)
    trust = mean / mixture_mean
    assert trust.min() < 0.1 and trust.max() > 0.9
    second_moment = trust * (mixture_variance + mixture_mean**2)
    second_moment += (1 - trust) * model.prior_variance
    np.testing.assert_allclose(variance, second_moment - mean**2, rtol=1e-9)


def test_mean_and_its_slope_have_no_jump_along_a_line_out_of_the_data(model):
    steps = np.linspace(0, 4, 400_001)
    for direction in ([1.0, 0.0], [0.0, 1.0], [-0.7, 0.7]):
        free = replace(model, bound=np.full(1, 1e6))  # the bound alone makes corners
        mean = free.predict(steps[:, None] * direction)[:, 0]
        slope = np.diff(mean) / steps[1]
        assert np.abs(slope).max() < 15  # N·m per unit of x; the truth has 1.5
        assert np.abs(np.diff(slope)).max() < 0.01
        assert mean[-1] == 0


def test_a_million_sized_input_stays_bounded(wide):
    model, x = wide
    rng = np.random.default_rng(0)
    size = 10 ** rng.uniform(-3, 6, (100_000, 1))
    probe = np.vstack([x, rng.normal(size=(100_000, 3)) * size, np.full((1, 3), 1e308)])
    mean, variance = model.predict_distribution(probe)
    assert (np.abs(mean) <= model.bound).all()
    assert np.isfinite(variance).all() and (variance > 0).all()
    np.testing.assert_allclose(mean, model.predict(probe), rtol=1e-12, atol=1e-15)


def test_a_bound_given_by_the_user_holds():
    x, y = sample(0, n=2000)
    model = fit_gmr(x, y, components=4, bound=0.2)
    assert np.abs(model.predict(x)).max() == 0.2


def test_chunks_do_not_show(model, monkeypatch):
    x, _ = sample(3, n=1000)
    whole = model.predict_distribution(x)
    monkeypatch.setattr("hybrid.compensator.gmr._ROWS", 7)
    for a, b in zip(whole, model.predict_distribution(x), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-15)
    assert model.predict(np.empty((0, 2))).shape == (0, 1)


def test_a_constant_input_changes_nothing():
    x, y = sample(0, n=4000)
    constant = np.column_stack([x, np.full(len(x), 0.3)])
    plain = fit_gmr(x, y, components=8)
    model = fit_gmr(constant, y, components=8)
    probe, truth = sample(1, noise=0.0)
    mean = model.predict(np.column_stack([probe, np.full(len(probe), 0.3)]))
    assert rms(mean - truth) < 1.3 * rms(plain.predict(probe) - truth)


@pytest.mark.parametrize("value", [0.0, 2.0])
def test_a_constant_output_is_learned(value):
    x, _ = sample(0, n=500)
    model = fit_gmr(x, np.full((500, 1), value))
    mean, variance = model.predict_distribution(np.zeros((1, 2)))
    np.testing.assert_allclose(mean, value)
    assert 0 < variance[0, 0] < 0.01


def test_held_out_motion_chooses_few_components_for_a_linear_remainder():
    (x, y), held_out = joint_gaussian(0, n=2000), joint_gaussian(0, n=4000)
    held_out = tuple(part[2000:] for part in held_out)
    assert fit_gmr(x, y, validation=held_out).components <= 2
    assert fit_gmr(x, y).components == 1


def test_held_out_motion_chooses_many_components_for_a_curved_remainder():
    model = fit_gmr(*sample(0, n=4000), validation=sample(1, n=4000))
    assert model.components >= 8


def test_equal_seeds_give_equal_models():
    x, y = sample(0, n=3000)
    a, b, c = (
        fit_gmr(x, y, components=4, seed=seed, max_samples=1000)
        for seed in (0, np.random.default_rng(0), 1)
    )
    for name, values in a.arrays().items():
        np.testing.assert_array_equal(values, b.arrays()[name])
    assert not np.array_equal(a.means, c.means)


def test_a_saved_model_predicts_the_same_bits(wide, tmp_path):
    model, x = wide
    np.savez(tmp_path / "arrays.npz", **model.arrays())
    other = GaussianMixtureRegression.from_arrays(np.load(tmp_path / "arrays.npz"))
    for a, b in zip(
        model.predict_distribution(x), other.predict_distribution(x), strict=True
    ):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("means", lambda a: a[:, 1:], "means has shape"),
        ("bound", lambda a: a[:, None], "bound has shape"),
        ("covariances", lambda a: -a, "not positive definite"),
        ("fade", lambda a: a[::-1], "increase"),
        ("prior_variance", lambda a: np.nan * a, "not finite"),
        ("bound", lambda a: np.array(["x"]), "damaged"),
    ],
)
def test_a_damaged_file_is_refused(model, name, change, message):
    arrays = model.arrays()
    with pytest.raises(ModelFileError, match=message):
        GaussianMixtureRegression.from_arrays({**arrays, name: change(arrays[name])})


def test_a_file_with_other_arrays_is_refused(model):
    arrays = model.arrays()
    del arrays["fade"]
    with pytest.raises(ModelFileError, match="valid is .*'fade'"):
        GaussianMixtureRegression.from_arrays(arrays)


def test_bad_inputs_are_refused_in_one_line(model):
    x, y = sample(0, n=100)
    dirty = x.copy()
    dirty[17, 1] = np.nan
    with pytest.raises(HybridError, match="x is nan at row 17, column 1"):
        model.predict(dirty)
    with pytest.raises(HybridError, match="inf"):
        model.predict_distribution(np.array([[0.0, np.inf]]))
    with pytest.raises(HybridError, match=r"shape \(2,\), valid is \(N, 2\)"):
        model.predict(np.zeros(2))
    with pytest.raises(HybridError, match="row 17"):
        fit_gmr(dirty, y)
    with pytest.raises(HybridError, match="equal numbers of rows"):
        fit_gmr(x, y[:-1])
    with pytest.raises(HybridError, match="valid is"):
        fit_gmr(x, y, validation=(x[:, :1], y))
    with pytest.raises(HybridError, match=r"y has shape \(100, 2\), valid is \(N, 1\)"):
        fit_gmr(x, x)
    with pytest.raises(HybridError, match="bound has shape"):
        fit_gmr(x, y, bound=[1.0, 2.0])
    with pytest.raises(IdentificationError, match="cannot support"):
        fit_gmr(x[:3], y[:3])
    with pytest.raises(IdentificationError, match="valid is 1 to 25"):
        fit_gmr(x, y, components=26)
    with pytest.raises(IdentificationError, match="larger floor"):
        fit_gmr(x, y, covariance_floor=-1.0)


def test_importing_the_regression_loads_neither_torch_nor_scikit_learn():
    code = (
        "import sys, hybrid.compensator.gmr;"
        "sys.exit('torch' in sys.modules or 'sklearn' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
