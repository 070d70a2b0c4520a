"""The training series: reproducible, shaped, and like the temperatures they stand for."""

import numpy as np
import pytest

from benchmarks.pretraining.series import draw_batch

CONTEXT, HORIZON = 512, 64


@pytest.fixture(scope="module")
def batch():
    return draw_batch(np.random.default_rng(7), 256, CONTEXT, HORIZON)


def test_shapes_and_types(batch):
    assert batch.context.shape == (256, CONTEXT)
    assert batch.future.shape == (256, HORIZON)
    assert batch.context.dtype == batch.future.dtype == np.float32


def test_the_generator_state_alone_decides_the_batch():
    one, same, other = (draw_batch(np.random.default_rng(seed), 16, 128, 24) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.context, same.context)
    np.testing.assert_array_equal(one.future, same.future)
    assert not np.array_equal(np.nan_to_num(one.context), np.nan_to_num(other.context))


def test_the_weather_of_a_series_goes_with_it(batch):
    """Outdoor temperature explains part of rooms' course; the clock is a wave of known phase, ahead as before."""
    assert batch.covariates.shape == (256, 3, CONTEXT + HORIZON)
    assert np.isfinite(batch.covariates).all()
    wave = batch.covariates[:, 2]
    assert np.abs(wave).max() <= 1.0
    # Equal steps of the angle: each value follows from the two before.
    turn = (wave[:, 2:] + wave[:, :-2]) * wave[:, 1:-1]
    step = turn.sum(axis=1) / (2.0 * (wave[:, 1:-1] ** 2).sum(axis=1))
    np.testing.assert_allclose(wave[:, 2:], 2.0 * step[:, None] * wave[:, 1:-1] - wave[:, :-2], atol=2e-3)
    same = batch.context.copy()
    same[np.isnan(same)] = 0.0
    known = np.isfinite(batch.context).all(axis=1)

    def alike(outdoor):
        return np.mean([abs(np.corrcoef(a, b)[0, 1]) for a, b in zip(same[known], outdoor[known], strict=True)])

    own = batch.covariates[:, 0, :CONTEXT]
    assert alike(own) > alike(np.roll(own, 1, axis=0)) + 0.1


def test_padding_lies_on_the_left_only_and_on_about_half(batch):
    missing = np.isnan(batch.context)
    padded = missing[:, 0] & missing[:, 1]
    assert 0.35 < padded.mean() < 0.6
    # After the first known value gaps are rare: a sensor's gap, not padding.
    first = (~missing).argmax(axis=1)
    after = np.concatenate([row[k:] for row, k in zip(missing, first, strict=True)])
    assert after.mean() < 0.005
    assert (~missing).sum(axis=1).min() >= 24


def test_the_future_goes_on_where_the_context_ends(batch):
    """A shuffled pairing of past and future, or an offset between them, would show as a jump many steps wide."""
    known = np.isfinite(batch.context[:, -24:]).all(axis=1) & np.isfinite(batch.future[:, :2]).all(axis=1)
    past, future = batch.context[known], batch.future[known]
    usual = np.abs(np.diff(past[:, -24:], axis=1)).max(axis=1) + 0.1
    jump = np.abs(future[:, 0] - past[:, -1])
    assert np.median(jump / usual) < 0.6
    assert (jump < 3 * usual).mean() > 0.95


def test_rooms_move_by_kelvins_and_follow_the_day():
    """Most series must be plausible temperatures, and a good part of hourly ones must carry a 24-step wave."""
    batch = draw_batch(np.random.default_rng(3), 512, CONTEXT, HORIZON)
    whole = batch.context[np.isfinite(batch.context).all(axis=1)]
    spread = whole.std(axis=1)
    assert 0.3 < np.median(spread) < 6.0
    assert np.abs(whole).max() < 150.0
    centred = whole - whole.mean(axis=1, keepdims=True)
    ordinates = np.abs(np.fft.rfft(centred[:, -504:], axis=1)) ** 2
    around = np.median(ordinates[:, 15:28], axis=1)
    daily = ordinates[:, 504 // 24] > 10 * around
    assert 0.25 < daily.mean() < 0.95
