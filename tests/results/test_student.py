"""Student's t distribution against scipy's."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from kickbench.results.student import central_probability, two_sided_quantile


@given(t=st.floats(0, 50), dof=st.integers(1, 60))
def test_the_series_is_the_distribution(t: float, dof: int) -> None:
    assert central_probability(t, dof) == pytest.approx(2 * stats.t(dof).cdf(t) - 1, abs=1e-8)


@pytest.mark.parametrize("dof", [1, 2, 3, 4, 17, 100])
@pytest.mark.parametrize("level", [0.1, 0.5, 0.95, 0.999])
def test_the_quantile_is_its_inverse(level: float, dof: int) -> None:
    assert two_sided_quantile(level, dof) == pytest.approx(stats.t(dof).ppf((1 + level) / 2), rel=1e-9)
