"""Functions on lanes for physics and tasks. A batch of arms and a single arm get the same bits from these functions."""

import math

from ..compiler import Lanes, absolute, kernel, select_lt, square_root


@kernel
def scaled_by_share(shares, k, value):
    """Return value * shares[k] if shares is an array, or value if shares is None or a compile-time tag (a tuple)."""
    if shares is None or isinstance(shares, tuple):
        return value
    return value * shares[k]


@kernel
def gravity_along(gravity, k):
    """Return the gravitational acceleration (m/s^2) along inertial axis k; 0.0 if gravity is None."""
    if gravity is None:
        return 0.0
    return gravity[k]


@kernel
def minimum(x, y):
    """Return the smaller of x and y. The result is y if x is NaN."""
    return select_lt(x, y, x, y)


@kernel
def clip(x, bound):
    """Return x limited to the interval [-bound, bound]."""
    return select_lt(x, -bound, -bound, select_lt(bound, x, bound, x))


@kernel
def decay(x):
    """Return exp(-x) for x >= 0, with an error of 1e-11. If x is above 60, return exp(-60).

    The function computes exp(-x) = exp(-x / 1024)^1024 by a Taylor polynomial of order 7 and ten squarings.
    """
    y = minimum(x, 60.0) * (-1.0 / 1024.0)
    z = y * (1.0 / 5040.0) + 1.0 / 720.0
    z = z * y + 1.0 / 120.0
    z = z * y + 1.0 / 24.0
    z = z * y + 1.0 / 6.0
    z = z * y + 0.5
    z = z * y + 1.0
    z = z * y + 1.0
    # exp(-x) = exp(y)^1024: squared ten times
    for _ in range(10):
        z = z * z
    return z


# coefficients of the series atan(t) / t = 1 - t^2/3 + t^4/5 - ...
_ATAN = tuple((-1.0) ** k / (2 * k + 1) for k in range(12))
_EIGHTH = math.sqrt(2.0) - 1.0  # tan(pi/8)


@kernel
def arctangent(y, x):
    """Return the angle (rad, in (-pi, pi]) from the x axis to the vector (x, y), to 1e-15; 0 for the zero vector."""
    a, b = absolute(y), absolute(x)
    # first octant: t = tan(angle) in [0, 1]; 1e-300 avoids 0/0
    low, high = select_lt(a, b, a, b), select_lt(a, b, b, a)
    t = low / select_lt(high, 1e-300, 1e-300, high)
    # above pi/8: atan t = pi/4 + atan((t - 1) / (t + 1))
    far = select_lt(t, _EIGHTH, 0.0, math.pi / 4)
    t = select_lt(t, _EIGHTH, t, (t - 1.0) / (t + 1.0))
    # t <- tan(angle / 2) < tan(pi/16), where twelve terms of the series of atan(t) / t suffice
    t = t / (square_root(t * t + 1.0) + 1.0)
    z = t * t
    p = z * _ATAN[11] + _ATAN[10]
    for k in range(9, -1, -1):
        p = p * z + _ATAN[k]
    angle = t * p * 2.0 + far
    # angle of (x, y) in (-pi, pi]: pi/2 - angle where b > a, pi - angle where x < 0
    angle = select_lt(a, b, angle, math.pi / 2 - angle)
    angle = select_lt(x, 0.0, math.pi - angle, angle)
    return select_lt(y, 0.0, -angle, angle)


@kernel
def add_to(lane, array: Lanes, k, value):
    """Add value to element k of an array of lanes: array[k] <- array[k] + value."""
    array[k] += value


@kernel
def load_pair(lane, array: Lanes, k):
    """Return elements k and k + 1 of an array of lanes."""
    return array[k], array[k + 1]


@kernel
def store_pair(lane, array: Lanes, k, a):
    """Store the pair a in elements k and k + 1 of an array of lanes."""
    array[k] = a[0]
    array[k + 1] = a[1]


@kernel
def load_vector(lane, array: Lanes, k):
    """Return elements k, k + 1 and k + 2 of an array of lanes."""
    return array[k], array[k + 1], array[k + 2]


@kernel
def store_vector(lane, array: Lanes, k, a):
    """Store the three components of a in elements k, k + 1 and k + 2 of an array of lanes."""
    store_pair(lane, array, k, a)
    array[k + 2] = a[2]


@kernel
def rotate_2d(c, s, x, y):
    """Return the plane vector (x, y) rotated counter-clockwise by the angle with cosine c and sine s."""
    return c * x - s * y, s * x + c * y


@kernel
def rotate_back_2d(c, s, x, y):
    """Return the plane vector (x, y) rotated clockwise by the angle with cosine c and sine s."""
    return c * x + s * y, c * y - s * x


@kernel
def store_where(lane, live, array: Lanes, k, value, old):
    """Store `value` in array[k] in the lanes with live > 1/2, and `old` in the other lanes."""
    array[k] = select_lt(0.5, live, value, old)
