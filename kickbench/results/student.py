"""Student's t distribution, for whole degrees of freedom: all that an interval over a few seeds needs."""

from __future__ import annotations

from math import atan, cos, pi, sin, sqrt


def central_probability(t: float, dof: int) -> float:
    """P(|T| <= t) of Student's t, exactly.

    With theta = atan(t/sqrt(dof)) a finite series in cos(theta): for an even dof
    sin(theta) (1 + 1/2 cos^2 + (1·3)/(2·4) cos^4 + ... up to cos^(dof-2)), for an odd one
    2/pi (theta + sin(theta) (cos + 2/3 cos^3 + (2·4)/(3·5) cos^5 + ... up to cos^(dof-2))).

    Args:
        t: bound, at least 0.
        dof: degrees of freedom, at least 1.

    Source: M. Abramowitz and I. Stegun, "Handbook of Mathematical Functions", 1964, 26.7.3 and 26.7.4.
    """
    theta, odd = atan(t / sqrt(dof)), dof % 2
    term = cos(theta) if odd else 1.0
    series = 0.0
    for power in range(odd, dof - 1, 2):
        series += term
        term *= (power + 1) / (power + 2) * cos(theta) ** 2
    return 2 / pi * (theta + sin(theta) * series) if odd else sin(theta) * series


def two_sided_quantile(level: float, dof: int) -> float:
    """The t with P(|T| <= t) = level.

    Args:
        level: probability in (0, 1).
        dof: degrees of freedom, at least 1.
    """
    low, high = 0.0, 1.0
    while central_probability(high, dof) < level:
        low, high = high, 2 * high
    while (middle := (low + high) / 2) not in (low, high):
        low, high = (middle, high) if central_probability(middle, dof) < level else (low, middle)
    return high
