"""Laws of the histograms: buckets are those of a search over the edges, quantiles those of the
sample to one bucket."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxtube.statistics import histogram
from jaxtube.statistics.histogram import BUCKETS, EDGES, bucket, quantile


def searched(values):
    """Find buckets by bisection; what is below the first edge or no number goes to the first or the
    last one."""
    found = np.searchsorted(EDGES, np.abs(np.asarray(values, float)), side="right") - 1
    return np.where(np.isnan(values), BUCKETS - 1, np.maximum(found, 0))


def counted(values):
    return np.bincount(np.asarray(bucket(jnp.asarray(values))), minlength=BUCKETS)


def test_edges_cut_each_octave_into_equal_parts():
    assert EDGES.shape == (BUCKETS,) and EDGES[0] == 2.0**histogram.LEAST
    octaves = EDGES.reshape(-1, histogram.CUTS)
    np.testing.assert_array_equal(
        octaves, octaves[:, :1] * (1 + np.arange(histogram.CUTS) / histogram.CUTS)
    )
    np.testing.assert_array_equal(octaves[1:, 0], 2 * octaves[:-1, 0])
    assert 2 * octaves[-1, 0] == 2.0**histogram.GREATEST


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_buckets_are_those_of_a_search_over_the_edges(kind):
    random = np.random.default_rng(0)
    edges = EDGES.astype(kind)
    info = np.finfo(kind)
    np.testing.assert_array_equal(edges, EDGES)
    special = [
        0.0,
        info.smallest_subnormal,
        info.tiny,
        info.eps,
        2.0,
        2.1,
        1e30,
        info.max,
        np.inf,
        np.nan,
    ]
    drawn = 10.0 ** random.uniform(-8, 4, 20_000)
    values = np.concatenate(
        [edges, np.nextafter(edges, kind(0)), np.nextafter(edges, kind(9)), special, drawn]
    )
    values = np.concatenate([values, -values]).astype(kind)
    found = bucket(jnp.asarray(values))
    assert found.dtype == jnp.int32
    np.testing.assert_array_equal(found, searched(values))
    np.testing.assert_array_equal(bucket(jnp.asarray(edges)), np.arange(BUCKETS))
    np.testing.assert_array_equal(found[np.isnan(values)], BUCKETS - 1)
    np.testing.assert_array_equal(
        bucket(jnp.asarray(values[:12].reshape(3, 4))), searched(values[:12]).reshape(3, 4)
    )


@pytest.mark.parametrize("share", [0.01, 0.25, 0.5, 0.9, 0.95, 0.999])
@pytest.mark.parametrize("size", [1, 2, 7, 1000, 20_001])
def test_quantiles_are_those_of_the_sample_to_one_bucket(share, size):
    random = np.random.default_rng(size)
    for values in (10.0 ** random.uniform(-3, 0.2, size), np.abs(random.normal(0, 0.01, size))):
        found = quantile(counted(values), share)
        # The sample's own quantile lies between the order statistics around it.
        least = searched(np.quantile(values, share, method="lower"))
        most = searched(np.quantile(values, share, method="higher"))
        lower = np.append(0.0, EDGES[1:])[least - (least > 0)]
        upper = np.append(EDGES, np.inf)[most + 1]
        assert lower <= found <= upper


def test_quantiles_rise_with_the_share_and_are_exact_for_uniform_numbers():
    values = (np.arange(80_000) + 0.5) / 80_000
    shares = np.linspace(0.01, 0.99, 99)
    found = np.array([quantile(counted(values), share) for share in shares])
    assert np.all(np.diff(found) > 0)
    np.testing.assert_allclose(found, shares, atol=2 / len(values))


def test_a_quantile_of_nothing_is_no_number_and_one_in_the_last_bucket_is_infinite():
    counts = np.zeros((4, BUCKETS), np.int64)
    counts[1, -1] = 7
    counts[2, 5] = 7
    counts[3, [5, -1]] = 7
    assert np.isnan(quantile(counts, 0.5)[0]) and quantile(counts, 0.5)[1] == np.inf
    assert EDGES[5] <= quantile(counts, 0.5)[2] <= EDGES[6]
    assert EDGES[5] <= quantile(counts, 0.5)[3] <= EDGES[6] and quantile(counts, 0.51)[3] == np.inf
    assert quantile(counts.reshape(2, 2, BUCKETS), 0.5).shape == (2, 2)


def test_quantiles_of_many_counts_do_not_overflow():
    counts = np.full(BUCKETS, 2**55 // BUCKETS, np.int64)
    assert EDGES[BUCKETS // 2 - 1] <= quantile(counts, 0.5) <= EDGES[BUCKETS // 2 + 1]
    assert quantile(np.full(BUCKETS, 2**30, np.int32), 0.5) == pytest.approx(quantile(counts, 0.5))
