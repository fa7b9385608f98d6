"""Measures of signals: variance accounted for, NRMSE, free vibrations, and the fit of one linear oscillator."""

from dataclasses import dataclass

import numpy as np

from flexarm_env import validation as check
from flexarm_env.sensors import Law
from flexarm_env.time_functions import spline_table

from ..validation import Array
from .log import Run


def vaf(measured: Array, predicted: Array) -> float:
    """Return the variance accounted for, %: 100 (1 - var(measured - predicted) / var(measured)).

    A constant offset of the prediction does not change the result. Raises ValueError if the measured signal is
    constant, or if the signals have different lengths.
    """
    measured, predicted = _comparable(measured, predicted)
    return float(100.0 * (1.0 - np.var(measured - predicted) / np.var(measured)))


def nrmse(measured: Array, predicted: Array, offset: bool) -> float:
    """Return the root mean square error divided by the standard deviation of the measured signal, %.

    measured, predicted (n,): measured and predicted readings. offset: True to subtract the mean error first. Raises
    ValueError if the measured signal is constant, or if the signals have different lengths.
    """
    measured, predicted = _comparable(measured, predicted)
    e = measured - predicted
    return float(100.0 * np.sqrt(np.mean((e - e.mean() if offset else e) ** 2)) / np.std(measured))


def _comparable(measured: Array, predicted: Array) -> tuple[Array, Array]:
    """Validate two signals: they have equal lengths, and the measured one is not constant."""
    measured, predicted = check.array("measured", measured, ("n",)), check.floats("predicted", predicted)
    if predicted.shape != measured.shape:
        raise check.InvalidValue("shape of predicted", predicted.shape, f"must be that of measured, {measured.shape}")
    if np.ptp(measured) == 0.0:
        raise check.InvalidValue("measured", measured, "must not be constant")
    return measured, predicted


# -------------------------------------------------------------------------------------------- ringing, free decay
@dataclass(frozen=True)
class Ringing:
    """Free vibration: a damped cosine, fitted to an interval of a signal.

    start: start of the interval, s. frequency: undamped natural frequency, Hz. damping: damping ratio. amplitude:
    amplitude at the interval's start, in the signal's unit. error: root mean square of the fit's residual, divided by
    the interval's standard deviation.
    """

    start: float
    frequency: float
    damping: float
    amplitude: float
    error: float


def ringing(t: Array, y: Array, low: float = 0.0, high: float = np.inf) -> Ringing | None:
    """Fit the strongest damped cosine with a frequency between `low` and `high`, Hz, to a signal y (n,).

    The initial guess is a peak of the spectrum. The function offset + exp(-d t) (a cos w t + b sin w t) is then fitted
    by least squares. Returns None if the signal has no power between the two frequencies.
    """
    from scipy.optimize import least_squares

    # zero-padded spectrum with a Hann window; at least 1.5 periods in the interval
    s, dt = t - t[0], (t[-1] - t[0]) / (len(t) - 1)
    n = 8 * len(y)
    power = np.abs(np.fft.rfft((y - y.mean()) * np.hanning(len(y)), n)) ** 2
    f = np.fft.rfftfreq(n, dt)
    allowed = (f >= max(low, 1.5 / s[-1])) & (f <= high)
    if not allowed.any() or not power[allowed].any():
        return None
    peak = f[allowed][power[allowed].argmax()]

    def parts(x: Array) -> tuple[Array, Array]:
        """Solve for the linear coefficients (a, b, offset), given x = (w, d) in rad/s and 1/s."""
        wave = np.exp(-x[1] * s)[:, None] * np.array([np.cos(x[0] * s), np.sin(x[0] * s)]).T
        table = np.column_stack([wave, np.ones_like(s)])
        return table, np.linalg.lstsq(table, y, rcond=None)[0]

    def error(x: Array) -> Array:
        """Return the residual of the fit, divided by the signal's standard deviation."""
        table, c = parts(x)
        return np.asarray((table @ c - y) / (y.std() + 1e-300))

    w = 2.0 * np.pi * peak
    found = least_squares(error, [w, 0.02 * w], bounds=([0.7 * w, -0.2 * w], [1.3 * w, 0.5 * w]), x_scale=[w, 0.02 * w])
    c = parts(found.x)[1]
    # undamped frequency sqrt(w^2 + d^2), damping ratio d over it
    natural = float(np.hypot(*found.x))
    return Ringing(
        float(t[0]), natural / (2.0 * np.pi), float(found.x[1] / natural), float(np.hypot(c[0], c[1])),
        float(np.sqrt(np.mean(found.fun**2))),
    )  # fmt: skip


def free_decay(t: Array, y: Array, *, periods: float = 4.0, high: float = np.inf) -> list[Ringing]:
    """Measure how frequency and damping of a decaying vibration depend on its amplitude.

    The signal is divided into intervals. The result has one `Ringing` for each interval, the largest amplitude first.

    Args:
        t (n,): instants, s, evenly spaced. y (n,): vibration signal, in any unit. periods: number of vibration periods
            in each interval.
        high: upper limit of the vibration's frequency, Hz.
    Raises:
        ValueError: the signal has fewer than two intervals, or no vibration.
    """
    t, y = check.column("t", t, "s"), check.column("y", y)
    if len(t) != len(y) or len(t) < 20:
        raise check.InvalidValue("y", f"{len(y)} samples", f"must be as many as t has, {len(t)}, and at least 20")
    steps = np.diff(t)
    if not 0.0 < steps.max() < 1.5 * np.median(steps) or steps.min() < 0.5 * np.median(steps):
        raise check.InvalidValue("t", t, "must be evenly spaced instants, each after the one before (s)")
    periods = check.number("periods", periods, above=0.0)
    # dominant frequency of the whole record, which sets the intervals' length
    whole = ringing(t, y, high=high)
    if whole is None or whole.error > 0.9:
        raise check.InvalidValue("y", y, "must contain a vibration: no damped cosine was found")
    # half-overlapping intervals of equal length
    size = round(periods / whole.frequency / (t[1] - t[0]))
    if size < 8 or len(t) < 2 * size:
        what = f"must hold two stretches of {periods:g} periods of {whole.frequency:.3g} Hz, of 8 samples and more each"
        raise check.InvalidValue("t", t, what)
    near = 0.7 * whole.frequency, 1.3 * whole.frequency
    stretches = [ringing(t[i : i + size], y[i : i + size], *near) for i in range(0, len(t) - size + 1, size // 2)]
    found = [s for s in stretches if s is not None and s.error < 0.5]
    return sorted(found, key=lambda s: -s.amplitude)


STILL = 0.02
"""An input counts as still while its rate is below `STILL` times its largest rate."""


def read_off(run: Run, name: str) -> list[Ringing]:
    """Fit an output's free vibration in each interval of at least 1.5 s with constant inputs."""
    still = np.ones(len(run.t), bool)
    for values in run.inputs.values():
        rate = np.abs(np.gradient(values, run.period))
        still &= rate < STILL * max(float(rate.max()), 1e-300)
    size, found = round(1.5 / run.period), []
    width = max(1, round(0.1 / run.period))
    still &= run.kept
    # ignore interruptions shorter than 0.1 s
    smooth = np.convolve(still, np.ones(width), "same") > 0.7 * width
    for first, end in np.flatnonzero(np.diff(smooth, prepend=False, append=False)).reshape(-1, 2):
        if end - first >= size:
            one = ringing(run.t[first:end], run.outputs[name][first:end])
            found += [one] if one is not None and one.error < 0.4 else []
    return found


# -------------------------------------------------------------------------------------------- one oscillator
@dataclass(frozen=True)
class Oscillator:
    """Linear oscillator y'' + 2 d w y' + w^2 y = sum of gain times input, whose output y passes the sensor's filter.

    frequency: natural frequency w / (2 pi), Hz. damping: damping ratio d. gains: gain of each input. If an input
    prescribes an angle, the sum contains the angle's second time derivative.
    """

    frequency: float
    damping: float
    gains: tuple[float, ...]
    law: Law

    def predict(self, run: Run) -> Array:
        """Return the filtered output (n,) of the oscillator for a run's inputs."""
        return np.asarray(_through(run, self.frequency, self.damping, self.law) @ np.array(self.gains))


def _through(run: Run, frequency: float, damping: float, law: Law) -> Array:
    """Filter each input by the oscillator with unit gain and by the sensor's low-pass, (n, inputs).

    frequency: natural frequency, Hz. damping: damping ratio. law: description of the sensor that reads the output.
    """
    from scipy.signal import cont2discrete, lfilter, ss2tf

    def second(w: float, damping: float, gain: float) -> tuple[Array, Array]:
        """Return the state space (A, B) of y'' + 2 damping w y' + w^2 y = gain u with states (y, y'/w)."""
        return np.array([[0.0, w], [-w, -2.0 * damping * w]]), np.array([[0.0], [gain / w]])

    filters = [second(2.0 * np.pi * frequency, damping, 1.0)]
    if law.low_pass is not None:
        v, first = 2.0 * np.pi * law.low_pass.frequency, law.low_pass.order == 1
        own = (np.array([[-v]]), np.array([[v]])) if first else second(v, law.low_pass.damping, v * v)
        filters.append(own)
    columns = []
    for name, u in run.inputs.items():
        # angles excite the oscillator by their acceleration
        if name.startswith(("joint", "motor")):
            u = spline_table(run.t, u)(run.t, derivative=2)
        for A, B in filters:
            # first-order-hold discretization, then filtering
            C = np.zeros((1, len(A)))
            C[0, 0] = 1.0
            a, b, c, d, _ = cont2discrete((A, B, C, [[0.0]]), run.period, "foh")
            num, den = ss2tf(a, b, c, d)
            u = lfilter(num[0], den, u)
        columns.append(u)
    return np.array(columns).T


def oscillator(runs: list[Run], name: str, law: Law) -> Oscillator:
    """Fit one oscillator to the readings of an output in all runs, with each run's mean subtracted.

    The best of 25 frequencies from 0.3 to 30 Hz is the initial guess of a least-squares fit of log frequency and log
    damping. name: name of the output. law: the output's `Law`, which describes the sensor.
    """
    from scipy.optimize import least_squares

    target = np.concatenate([y - y.mean() for y in (run.outputs[name][run.kept] for run in runs)])

    def solved(x: Array) -> tuple[Array, Array]:
        """Solve the linear problem for the gains; return the relative residual and the gains. x: logarithms of
        frequency and damping ratio.
        """
        tables = [_through(run, float(np.exp(x[0])), float(np.exp(x[1])), law)[run.kept] for run in runs]
        table = np.concatenate([columns - columns.mean(axis=0) for columns in tables])
        gains = np.linalg.lstsq(table, target, rcond=None)[0]
        return np.asarray(table @ gains - target) / target.std(), gains

    top = 0.4 / max(run.period for run in runs)
    # frequencies up to 0.4 of the sampling rate
    grid = [
        np.array([np.log(f), np.log(0.03)]) for f in np.geomspace(max(0.3, 2.0 / runs[0].t[-1]), min(top, 30.0), 25)
    ]
    best = min(grid, key=lambda x: float(np.square(solved(x)[0]).sum()))
    found = least_squares(lambda x: solved(x)[0], best, max_nfev=30).x
    return Oscillator(float(np.exp(found[0])), float(np.exp(found[1])), tuple(solved(found)[1].tolist()), law)
