"""Laws of projections between two polytopes, against the exact ones by vertices."""

import numpy as np
import pytest

from sets.polytope import Polytope
from sets.projection import project


def draw_polytope(seed: int, kept: int, dropped: int):
    generator = np.random.default_rng(seed)
    dimension = kept + dropped
    normals = generator.normal(size=(6 * dimension, dimension))
    scales = 10.0 ** generator.uniform(-2, 2, dimension)
    normals = np.concatenate([normals, np.eye(dimension), -np.eye(dimension)]) / scales
    return normals, generator.uniform(0.5, 1.5, len(normals))


@pytest.mark.parametrize(("kept", "dropped"), [(2, 1), (2, 2), (3, 1), (3, 3), (3, 0)])
@pytest.mark.parametrize("seed", range(3))
def test_the_exact_projection_lies_between_both_polytopes(seed, kept, dropped):
    normals, offsets = draw_polytope(seed, kept, dropped)
    exact = Polytope(normals, offsets).image(np.eye(kept, kept + dropped))
    found = project(normals[:, :kept], normals[:, kept:], offsets, share=0.01)
    inner = found.inner
    assert found.gap <= 0.01
    assert np.all(exact.normals @ found.points.T <= exact.offsets[:, None] * (1 + 1e-7))
    assert np.all(exact.support(inner.normals) <= (1 + found.gap) * inner.offsets * (1 + 1e-6))
    assert inner.volume() <= exact.volume() * (1 + 1e-7)
    assert exact.volume() <= (1 + found.gap) ** kept * inner.volume() * (1 + 1e-6)


def test_a_smaller_share_comes_closer():
    normals, offsets = draw_polytope(7, 3, 2)
    volumes = [
        project(normals[:, :3], normals[:, 3:], offsets, share).inner.volume()
        for share in (0.1, 0.01, 0.001)
    ]
    assert volumes == sorted(volumes)


def test_units_change_nothing():
    normals, offsets = draw_polytope(3, 3, 2)
    units = np.array([1e-3, 1.0, 1e3])
    plain = project(normals[:, :3], normals[:, 3:], offsets)
    scaled = project(normals[:, :3] / units, normals[:, 3:], offsets)
    assert scaled.inner.volume() == pytest.approx(plain.inner.volume() * units.prod(), rel=0.01)


def test_without_the_origin_inside_it_is_refused():
    box = Polytope.box([1.0, 1.0, 1.0], [2.0, 2.0, 2.0])
    with pytest.raises(ValueError, match="0 is not inside"):
        project(box.normals[:, :2], box.normals[:, 2:], box.offsets)
