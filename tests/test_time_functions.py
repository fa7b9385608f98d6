"""Time functions: values and derivatives against formulas and differences, kinks, tables and their errors."""

import copy
import math
import pickle
from pathlib import Path

import numpy as np
import pytest

from flexarm_env import time_functions as tf
from flexarm_env.time_functions import TimeFunction
from tests.processes import python
from tests.refusals import refusal, refuses, says

RNG = np.random.default_rng(3)
KNOTS = np.sort(RNG.uniform(0.0, 5.0, 9))
VALUES, RATES, ACCELERATIONS = RNG.normal(size=(3, 9))

FUNCTIONS = {
    "constant": tf.constant(2.5),
    "pulse": tf.pulse(80.0, 2.5),
    "late pulse": tf.pulse(80.0, 2.5, 1.0),
    "ramp": tf.ramp(1.5, 5.0, 0.25),
    "cycloid": tf.cycloid(1.5, 5.0, -1.0),
    "spin_up": tf.spin_up(6.0, 15.0),
    "sine": tf.sine(2.0, 3.0, 0.4),
    "ended sine": tf.sine(2.0, 3.0, 0.4, 1.7, 0.3),
    "steps": tf.steps([0.5, 1.0, 2.0], [1.0, -1.0, 3.0]),
    "linear": tf.linear_table(KNOTS, VALUES),
    "spline": tf.spline_table(KNOTS, VALUES),
    "natural": tf.spline_table(KNOTS, VALUES, "natural"),
    "hermite": tf.hermite_table(KNOTS, VALUES, RATES),
    "hermite 2": tf.hermite_table(KNOTS, VALUES, RATES, ACCELERATIONS),
}
each = pytest.mark.parametrize("f", FUNCTIONS.values(), ids=FUNCTIONS.keys())


@each
def test_derivatives_by_central_differences(f: TimeFunction) -> None:
    h = 1e-5
    t = np.linspace(0.01, 8.0, 301)
    t = t[np.all(np.abs(t[:, None] - f.pieces[None, :, 0]) > 2 * h, axis=1)]
    for k in (0, 1):
        difference = (f(t + h, k) - f(t - h, k)) / (2 * h)
        np.testing.assert_allclose(f(t, k + 1), difference, rtol=1e-5, atol=1e-5 * (1 + np.abs(f(t, 3)).max()))


@each
def test_pieces_are_the_contract_of_compiled_code(f: TimeFunction) -> None:
    assert f.pieces.dtype == np.float64
    assert f.pieces.ndim == 2
    assert f.pieces.shape[1] == 8
    assert f.pieces.flags.c_contiguous
    assert not f.pieces.flags.writeable
    for t in (0.0, 0.7, 1.7, 2.5, 30.0):
        row = f.pieces[0]
        for candidate in f.pieces:  # the last row that has begun, as a kernel looks it up
            if candidate[0] <= t:
                row = candidate
        t0, c0, c1, c2, c3, A, w, p = row
        s = t - t0
        assert f(t) == pytest.approx(c0 + c1 * s + c2 * s**2 + c3 * s**3 + A * math.sin(w * s + p), abs=1e-14)


@each
def test_kinks_are_where_the_sides_differ(f: TimeFunction) -> None:
    starts = f.pieces[1:, 0]
    found: dict[int, set[float]] = {0: set(), 1: set(), 2: set()}
    for k in found:
        for t in starts:
            if abs(f(t, k) - f(t, k, "left")) > 1e-8:
                found[k].add(float(t))
    assert f.jumps == tuple(sorted(found[0]))
    assert f.load_kinks == tuple(sorted(found[0] | found[1]))
    assert f.kinks == tuple(sorted(found[0] | found[1] | found[2]))


@each
def test_equal_hashable_immutable_and_copied(f: TimeFunction) -> None:
    twin = pickle.loads(pickle.dumps(f))
    assert twin == f
    assert hash(twin) == hash(f)
    assert not twin.pieces.flags.writeable
    assert copy.deepcopy(f) == f
    assert f.plus(1.0) != f
    assert f.plus(1.0)(0.9) == pytest.approx(f(0.9) + 1.0)
    with pytest.raises(ValueError):
        f.pieces[0, 0] = 1.0


def test_a_scalar_gives_a_float_and_an_array_an_array() -> None:
    f = tf.ramp(1.5, 5.0)
    assert type(f(1.0)) is float
    assert f([[0.0, 5.0]]).shape == (1, 2)
    assert f(5.0, 1, "left") == 0.3
    assert f(5.0, 1) == 0.0
    assert f(-1.0) == pytest.approx(-0.3)
    assert f.start == 0.0
    assert f.end == 5.0


def test_known_formulas() -> None:
    t = np.linspace(0.0, 5.0, 101)
    cycloid = 1.5 * (t / 5 - np.sin(2 * np.pi * t / 5) / (2 * np.pi))
    np.testing.assert_allclose(tf.cycloid(1.5, 5.0)(t), cycloid, atol=1e-15)
    assert tf.cycloid(1.5, 5.0)(9.0) == 1.5
    assert tf.cycloid(1.5, 5.0).kinks == ()
    t = np.linspace(0.0, 15.0, 101)
    spin = 6 / 15 * (t**2 / 2 + (15 / (2 * np.pi)) ** 2 * (np.cos(2 * np.pi * t / 15) - 1))
    np.testing.assert_allclose(tf.spin_up(6.0, 15.0)(t), spin, atol=2e-14)
    assert tf.spin_up(6.0, 15.0)(20.0) == 6 * 20 - 45
    assert tf.spin_up(6.0, 15.0).kinks == ()
    assert tf.ramp(1.5, 5.0).kinks == (5.0,)
    assert tf.pulse(80.0, 2.5).jumps == (2.5,)
    assert tf.pulse(80.0, 2.5)(2.5, side="left") == 80.0
    assert tf.pulse(80.0, 2.5)(2.5) == 0.0
    assert tf.sine(1.0, math.pi, t_end=2.0).jumps == ()
    assert tf.sine(1.0, math.pi, t_end=2.0).load_kinks == (2.0,)


def test_tables_meet_their_rows() -> None:
    t = KNOTS
    for f in (FUNCTIONS["linear"], FUNCTIONS["spline"], FUNCTIONS["hermite"], FUNCTIONS["hermite 2"]):
        np.testing.assert_allclose(f(t), VALUES, atol=1e-13)
        assert f(t[0] / 2) == VALUES[0]
        assert f(t[-1] + 1.0) == VALUES[-1]
        assert f(t[-1] + 1.0, 1) == 0.0
    for f in (FUNCTIONS["hermite"], FUNCTIONS["hermite 2"]):
        np.testing.assert_allclose(f(t[:-1], 1), RATES[:-1], atol=1e-12)
        assert f(t[-1], 1, "left") == pytest.approx(RATES[-1], abs=1e-12)
    two = FUNCTIONS["hermite 2"]
    np.testing.assert_allclose(two(t[:-1], 2), ACCELERATIONS[:-1], atol=1e-10)
    assert two(t[-1], 2, "left") == pytest.approx(ACCELERATIONS[-1], abs=1e-10)
    assert set(two.kinks) == {t[0], t[-1]}  # C2 inside, though made of cubics
    assert set(FUNCTIONS["spline"].kinks) == {t[0], t[-1]}
    assert set(FUNCTIONS["linear"].kinks) == set(t)
    clamped = tf.spline_table(t, VALUES, "clamped")
    assert clamped(t[0], 1) == pytest.approx(0.0, abs=1e-12)


def test_tables_of_a_smooth_motion_converge() -> None:
    exact = tf.cycloid(1.5, 5.0)
    fine = np.linspace(0.0, 5.0, 997)
    errors = []
    for n in (20, 40):
        t = np.linspace(0.0, 5.0, n + 1)
        tables = (
            tf.spline_table(t, exact(t), "clamped"),
            tf.hermite_table(t, exact(t), exact(t, 1)),
            tf.hermite_table(t, exact(t), exact(t, 1), exact(t, 2)),
        )
        errors.append([np.abs(f(fine) - exact(fine)).max() for f in tables])
    order = np.log2(np.array(errors[0]) / np.array(errors[1]))
    np.testing.assert_allclose(order, 4.0, atol=0.4)


def test_round_off_is_no_kink() -> None:
    t = np.linspace(0.0, 1.0, 11)
    assert tf.linear_table(t, 0.3 * t + 0.1 * 3).kinks == (1.0,)
    assert tf.spline_table(t, np.full(11, 0.7)).kinks == ()
    third = tf.linear_table([0.0, 0.1, 0.2, 0.30000000000000004], [0.1, 0.2, 0.30000000000000004, 0.4])
    assert third.kinks == (0.30000000000000004,)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: tf.linear_table([0, 1, 2], [0, math.nan, 1]), "y[1] = nan: must be a finite number, in row 1"),
        (lambda: tf.spline_table([0, math.inf], [0, 1]), "t[1] = inf: must be a finite number (s), in row 1"),
        (lambda: tf.spline_table([0, 1], [0, "1"]), "psi[1] = '1': must be a finite number, in row 1"),
        (lambda: tf.spline_table([0, True], [0, 1]), "t[1] = True: must be"),
        (lambda: tf.linear_table([0, 2, 1], [0, 1, 2]), "t[2] = 1.0: must be later than 2, the time of row 1"),
        (lambda: tf.linear_table([0, 1, 1], [0, 1, 2]), "t[2] = 1.0: must be later than 1, the time of row 1"),
        (lambda: tf.linear_table([-1, 1], [0, 1]), "t[0] = -1.0: must be a time from 0 on (s)"),
        (lambda: tf.linear_table([0], [0]), "t = [0.0]: must hold at least 2 rows"),
        (lambda: tf.linear_table([], []), "t = []: must be a list of numbers that is not empty"),
        (lambda: tf.linear_table([0, 1], [0, 1, 2]), "must hold 2 rows as t does, not 3"),
        (lambda: tf.hermite_table([0, 1], [0, 1], [0, math.nan]), "psi_dot[1] = nan"),
        (lambda: tf.hermite_table([0, 1], [0, 1], [0, 0], [math.nan, 0]), "psi_ddot[0] = nan"),
        (lambda: tf.table([0, 1], [0, 1], psi_ddot=[0, 0]), "psi_dot: missing; psi_ddot needs it too"),
        (lambda: tf.table([0, 1], [0, 1], interpolation="cubic"), "interpolation = 'cubic': must be one of"),
        (lambda: tf.table([0, 1], [0, 1], [0, 0], interpolation="linear"), "must not be given where the table holds"),
        (lambda: tf.spline_table([0, 1], [0, 1], "free"), "boundary = 'free': must be one of"),
        (lambda: tf.from_array(np.zeros(3)), "must be numbers of shape (n, 2 to 4)"),
        (lambda: tf.from_array(np.array([[0.0, 0.0], [1.0, math.nan]])), "psi[1] = nan"),
        (lambda: tf.ramp(1.0, 0.0), "duration = 0.0: must be a positive number (s)"),
        (lambda: tf.ramp("1", 1.0), "rise = '1': must be a finite number"),
        (lambda: tf.pulse(1.0, 1.0, 2.0), "t_end = 1.0: must be a finite number, above 2 (s)"),
        (lambda: tf.constant(math.nan), "value = nan: must be a finite number"),
        (lambda: tf.sine(1.0, 0.0), "omega = 0.0: must be a positive number (rad/s)"),
        (lambda: TimeFunction(np.zeros((2, 7))), "must be rows of 8 numbers"),
        (lambda: TimeFunction(np.full((1, 8), math.nan)), "must hold finite numbers, in row 0"),
        (lambda: TimeFunction(np.zeros((2, 8))), "pieces[1] = 0.0: must be later than 0, the time of row 0"),
        (lambda: tf.ramp(1.0, 1.0)(0.0, 4), "derivative = 4: must be a whole number, from 0 to 3"),
        (lambda: tf.ramp(1.0, 1.0)(0.0, side="both"), "side = 'both': must be one of"),
    ],
)
def test_a_refusal_names_the_row(make: object, message: str) -> None:
    says(message, make)


def test_arrays_and_csv_files(tmp_path: Path) -> None:
    data = np.column_stack([KNOTS, VALUES, RATES, ACCELERATIONS])
    assert tf.from_array(data[:, :2]) == FUNCTIONS["spline"]
    assert tf.from_array(data[:, :2], "linear") == FUNCTIONS["linear"]
    assert tf.from_array(data[:, :3]) == FUNCTIONS["hermite"]
    for n, name in ((2, "spline"), (3, "hermite"), (4, "hermite 2")):
        path = tmp_path / f"{n}.csv"
        rows = [",".join(tf.COLUMNS[:n])] + [",".join(map(repr, row)) for row in data[:, :n].tolist()]
        path.write_text("\n".join(rows) + "\n")
        assert tf.from_csv(path) == FUNCTIONS[name]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "columns = (): must be t,psi"),
        ("time,angle\n0,0\n", "columns = ('time', 'angle'): must be t,psi"),
        ("t,psi\n", "rows = 0: must be at least two"),
        ("t,psi\n0,0\n1,x\n", "[1] = 'x': must be a number, in row 1 of column 'psi'"),
        ("t,psi\n0,0\n1\n", "[1] = ['1']: must hold 2 numbers, in row 1"),
        ("t,psi\n0,0\n1,nan\n", "psi[1] = nan: must be a finite number, in row 1"),
    ],
)
def test_a_wrong_csv_file_is_refused(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "motion.csv"
    path.write_text(content)
    told = refusal(lambda: tf.from_csv(path))
    assert told.startswith(str(path)) and message in told


def test_a_csv_file_that_is_no_text_is_named(tmp_path: Path) -> None:
    path = tmp_path / "motion.csv"
    path.write_bytes(b"PK\x03\x04\xff\xfe")
    refuses(rf"^{path}: not a CSV file: ", lambda: tf.from_csv(path))


def test_a_motion_must_not_jump() -> None:
    tf.ramp(1.0, 2.0).check_no_jump()
    with pytest.raises(ValueError, match=r"^t\[1\] = 2.5: a motion must not jump: row 1 goes from 80 to 0"):
        tf.pulse(80.0, 2.5).check_no_jump()


def test_importing_needs_no_scipy() -> None:
    code = "import sys, flexarm_env.scenes as s; s.named('spin_up'); print('scipy.interpolate' in sys.modules)"
    assert python("-c", code).stdout.strip() == "False"
