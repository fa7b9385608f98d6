"""Functions of lanes that physics and tasks need: the same bits for a batch and a single arm."""

import math

from ..compiler import absolute, kernel, load, select_lt, square_root, store


@kernel
def share_of(shares, k, value):
    """value times shares[k] where shares is an array; value where it is a tag or None."""
    if shares is None or isinstance(shares, tuple):
        return value
    return value * shares[k]


@kernel
def fall(gravity, k):
    """Gravity along axis k, m/s^2; 0 where there is none."""
    if gravity is None:
        return 0.0
    return gravity[k]


@kernel
def smaller(x, y):
    """The smaller of x and y; y where x is NaN."""
    return select_lt(x, y, x, y)


@kernel
def clip(x, bound):
    """x within +-bound."""
    return select_lt(x, -bound, -bound, select_lt(bound, x, bound, x))


@kernel
def decay(x):
    """exp(-x) for x >= 0, within 1e-11; 0 in effect from 60 on."""
    y = smaller(x, 60.0) * (-1.0 / 1024.0)
    z = y * (1.0 / 5040.0) + 1.0 / 720.0
    z = z * y + 1.0 / 120.0
    z = z * y + 1.0 / 24.0
    z = z * y + 1.0 / 6.0
    z = z * y + 0.5
    z = z * y + 1.0
    z = z * y + 1.0
    for _ in range(10):
        z = z * z
    return z


_ATAN = tuple((-1.0) ** k / (2 * k + 1) for k in range(12))
_EIGHTH = math.sqrt(2.0) - 1.0  # tan(pi/8)


@kernel
def arctangent(y, x):
    """Angle of the point (x, y) in (-pi, pi], within 1e-15; 0 at the origin."""
    a, b = absolute(y), absolute(x)
    low, high = select_lt(a, b, a, b), select_lt(a, b, b, a)
    t = low / select_lt(high, 1e-300, 1e-300, high)
    far = select_lt(t, _EIGHTH, 0.0, math.pi / 4)
    t = select_lt(t, _EIGHTH, t, (t - 1.0) / (t + 1.0))
    t = t / (square_root(t * t + 1.0) + 1.0)  # half the angle
    z = t * t
    p = z * _ATAN[11] + _ATAN[10]
    for k in range(9, -1, -1):
        p = p * z + _ATAN[k]
    angle = t * p * 2.0 + far
    angle = select_lt(a, b, angle, math.pi / 2 - angle)
    angle = select_lt(x, 0.0, math.pi - angle, angle)
    return select_lt(y, 0.0, -angle, angle)


@kernel
def add(lane, array, k, value):
    """array[k] <- array[k] + value."""
    store(array, k, load(lane, array, k) + value)


@kernel
def pair(lane, array, k):
    """Elements k and k + 1."""
    return load(lane, array, k), load(lane, array, k + 1)


@kernel
def put_pair(array, k, a):
    """Elements k and k + 1 <- a."""
    store(array, k, a[0])
    store(array, k + 1, a[1])


@kernel
def vector(lane, array, k):
    """Three elements from k on."""
    return load(lane, array, k), load(lane, array, k + 1), load(lane, array, k + 2)


@kernel
def put_vector(array, k, a):
    """Three elements from k on <- a."""
    put_pair(array, k, a)
    store(array, k + 2, a[2])


@kernel
def turned(c, s, x, y):
    """The vector (x, y) of a plane, turned by the angle with cosine c and sine s."""
    return c * x - s * y, s * x + c * y


@kernel
def turned_back(c, s, x, y):
    """The vector (x, y) of a plane, turned the other way by the angle with cosine c and sine s."""
    return c * x + s * y, c * y - s * x


@kernel
def put(live, array, k, value, old):
    """array[k] <- value where live, old elsewhere."""
    store(array, k, select_lt(0.5, live, value, old))
