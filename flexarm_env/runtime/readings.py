"""What sensors read at the instants of a trajectory."""

from __future__ import annotations

from ..compiler import SINGLE, kernel, size
from .inertial import specific_force
from .laws import read, read_encoder, tip_acceleration


@kernel
def read_rows(laws, room, memory, stream, period, gravity, encoders, shaken, inputs, out):
    """Readings at instants `period` apart, an instant a row of `out`; all in SI, not in scales.

    Columns of inputs: an angle for each encoder; of an accelerometer (shaken: None without one, a tuple of its 2 or 3
    axes) the tip's x, y, angle and their rates, in space its place, rotation vector, velocity and angular velocity
    about its own axes; then what is read as it stands. Columns of out: angle and rate for each encoder, then one for
    each channel. gravity (3,): m/s^2.
    """
    for k in range(inputs.shape[0]):
        first, c, column, put = k == 0, 0, 0, 0
        for _ in range(encoders):
            angle, rate = read_encoder(SINGLE, laws, room, c, memory, 0, stream, 0, inputs[k, column], first)
            out[k, put], out[k, put + 1] = angle, rate
            c, column, put = c + 1, column + 1, put + 2
        if shaken is not None:
            if size(shaken) == 2:
                x, y, angle = inputs[k, column], inputs[k, column + 1], inputs[k, column + 2]
                vx, vy, rate = inputs[k, column + 3], inputs[k, column + 4], inputs[k, column + 5]
                found = tip_acceleration(
                    SINGLE, memory, 0, room, c, 0, x, y, angle, vx, vy, rate, period, gravity[0], gravity[1], first
                )
            else:
                found = specific_force(
                    SINGLE, memory, 0, room, c, 0, _three(inputs, k, column), _three(inputs, k, column + 3),
                    _three(inputs, k, column + 6), _three(inputs, k, column + 9), period,
                    (gravity[0], gravity[1], gravity[2]), first,
                )  # fmt: skip
            for axis in range(size(shaken)):
                out[k, put] = read(SINGLE, laws, room, c, memory, 0, stream, 0, found[axis], first)
                c, put = c + 1, put + 1
            column += 6 if size(shaken) == 2 else 12
        while put < out.shape[1]:
            out[k, put] = read(SINGLE, laws, room, c, memory, 0, stream, 0, inputs[k, column], first)
            c, column, put = c + 1, column + 1, put + 1


@kernel
def _three(inputs, k, column):
    return inputs[k, column], inputs[k, column + 1], inputs[k, column + 2]
