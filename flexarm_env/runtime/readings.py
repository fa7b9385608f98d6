"""Sensor readings at the instants of a recorded trajectory."""

from __future__ import annotations

from ..compiler import SINGLE, kernel, size
from ..physics.space.rotations import Vector
from .inertial import specific_force
from .laws import read, read_encoder, tip_acceleration


@kernel
def read_rows(laws, room, memory, stream, period, gravity, encoders, shaken, inputs, out):
    """Compute the sensor readings at instants `period` s apart, one row of `out` for each row of `inputs`, in SI units.

    Columns of inputs: an angle (rad) for each of `encoders` encoders; for an accelerometer the tip's x, y, angle and
    their rates in the plane, or position, rotation vector, velocity (inertial axes) and angular velocity (tip axes) in
    space; then quantities that are read directly. Columns of out: angle and rate for each encoder, then one column for
    each further channel.

    # model     laws: one `LAW` per channel, with `room` past outputs;  gravity (3,): m/s^2, inertial axes
    #           shaken: one zero per axis of the accelerometer (2 or 3), or None without accelerometer
    # in        inputs (instants, quantities)
    # in, out   memory: a `CHANNEL` for each law;  stream: state of the random numbers, or None for no noise
    # out       out (instants, readings)
    """
    for k in range(inputs.shape[0]):
        first, c, column, put = k == 0, 0, 0, 0
        # encoders: angle and filtered rate (rad, rad/s) from one channel
        for _ in range(encoders):
            angle, rate = read_encoder(SINGLE, laws, room, c, memory, 0, stream, 0, inputs[k, column], first)
            out[k, put], out[k, put + 1] = angle, rate
            c, column, put = c + 1, column + 1, put + 2
        # accelerometer: specific force r'' - g (m/s^2) in the tip's axes, a channel for each axis
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
                    Vector(gravity[0], gravity[1], gravity[2]), first,
                )  # fmt: skip
            for axis in range(size(shaken)):
                out[k, put] = read(SINGLE, laws, room, c, memory, 0, stream, 0, found[axis], first)
                c, put = c + 1, put + 1
            column += 6 if size(shaken) == 2 else 12
        # the rest have one number each, hence one channel
        while put < out.shape[1]:
            out[k, put] = read(SINGLE, laws, room, c, memory, 0, stream, 0, inputs[k, column], first)
            c, column, put = c + 1, column + 1, put + 1


@kernel
def _three(inputs, k, column):
    """Return the vector of the three numbers of row k of `inputs` that begin at `column`."""
    return Vector(inputs[k, column], inputs[k, column + 1], inputs[k, column + 2])
