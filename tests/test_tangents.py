"""Derivatives by tangents: of tapes, and of runs by their initial state and parameters."""

from __future__ import annotations

import numpy as np
import pytest

import bayeq as bq
from bayeq.expressions import FUNCTIONS, Tape, parse, run_tape
from bayeq.expressions.evaluate import RowTangents, dependence, registers_for, run_on_rows
from bayeq.numerics.rk4 import Drive, interpolant, shoot
from tests.simulated import coarse

UNARY = [name for name, one in FUNCTIONS.items() if one.arguments == (1, 1) and name != "acosh"]


TEXTS = (
    [f"{name}(0.3*x)+{name}(0.2*y)*y" for name in UNARY]
    + ["acosh(1+x)*y", "max(x,y*x)", "min(x,y,1)", "atan2(x,y)", "mod(x,y)*y", "mod(y,0.31)", "where(x<y,x**2,y*x)"]
    + ["where(x>=y,x**2,y*x)", "cbrt(-x)*y", "floor(x)*y", "heaviside(x-y)*x", "relu(x-y)*x", "sigmoid(x*y)"]
    + ["x+y*x", "x-y", "x/y", "-x", "x**3*y**2", "x**-2", "x**y", "2**x", "x**0.5", "(x*y)**2.5", "abs(-x)*y"]
)


@pytest.mark.parametrize("text", TEXTS)
def test_tangents_are_the_derivatives(text):
    tape = Tape.compile([parse(text)], ["x", "y"])
    rng = np.random.default_rng(0)
    for x, y in rng.uniform(0.2, 1.5, (5, 2)):
        program = tape.program([x, y])
        tangents = np.zeros((len(program.registers), 2))
        tangents[0, 0] = tangents[1, 1] = 1.0
        run_tape(program, tangents)
        assert program.registers[tape.outputs[0]] == tape([x, y])[0]
        h = 1e-6
        twin = [
            (tape([x + h, y])[0] - tape([x - h, y])[0]) / (2 * h),
            (tape([x, y + h])[0] - tape([x, y - h])[0]) / (2 * h),
        ]
        np.testing.assert_allclose(tangents[tape.outputs[0]], twin, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("text", TEXTS)
def test_many_rows_at_a_time_are_as_one_by_one(text):
    tape = Tape.compile([parse(text)], ["x", "y", "z"])
    points = np.random.default_rng(1).uniform(-1.5, 1.5, (7, 3))
    points[0, :2] = points[1, 0] = 0.0  # where slopes are infinite, or undefined
    registers = registers_for(tape, 9)
    registers[:3, :7] = points.T
    tangents = RowTangents(np.zeros((len(registers), 3, 9)), np.zeros((len(registers), 3), dtype=bool))
    tangents.values[range(3), range(3)], tangents.depends[range(3), range(3)] = 1.0, True
    dependence(tape.code, tangents.depends)
    run_on_rows(tape.code, registers, 7, tangents)
    for k, point in enumerate(points):
        program, twin = tape.program(point), np.zeros((len(registers), 3))
        twin[:3] = np.eye(3)
        run_tape(program, twin)
        np.testing.assert_array_equal(registers[:, k], program.registers)
        # one by one a tangent that is 0 by construction makes NaN of what is not finite
        values = np.where(np.isnan(twin), np.nan, tangents.values[:, :, k])
        np.testing.assert_array_equal(values, twin)
    assert not tangents.depends[tape.outputs[0], 2]


def test_tangents_at_zero():
    # powers of zero, and what has no slope there
    tape = Tape.compile([parse("x**2"), parse("x**0.5*0"), parse("sign(x)"), parse("abs(x)")], ["x"])
    program = tape.program([0.0])
    tangents = np.zeros((len(program.registers), 1))
    run_tape(program, tangents)
    assert tangents[tape.outputs].tolist() == [[0.0]] * 4


def test_sensitivities_of_a_run_are_those_by_differences():
    record = coarse("duffing", 600, 4, {"x": 0.02, "v": 0.02, "a": 0.02})
    eq = bq.discover(record, chains="x:v:a", inputs=["u"], dictionary=["x", "v", "x**3", "u"], smooth="none")
    dynamics, time = eq.dynamics(), record.time[:80]
    theta, start, channels = dynamics.mean, np.array([0.02, -0.4]), np.arange(3, dtype=np.uint32)
    wide = np.full(2, 1e6)
    drive = Drive.over(time, interpolant(time, record["u"][:80, None], "cubic"), -wide, wide)
    drive = drive._replace(step=1.0 / (3.0 * record.fs))

    def run(start, theta):
        values, jacobian = np.empty((80, 3)), np.empty((80, 3, 7))
        done = shoot(dynamics.program(), drive, theta, start, channels, values, jacobian)
        assert done == 80
        return values, jacobian

    _, jacobian = run(start, theta)
    both = np.concatenate([start, theta])
    for j, size in enumerate(np.maximum(np.abs(both), 1e-3)):
        h = 1e-5 * size
        step = np.zeros(7)
        step[j] = h
        above, below = ((both + s * step) for s in (1, -1))
        twin = (run(above[:2], above[2:])[0] - run(below[:2], below[2:])[0]) / (2 * h)
        scale = np.abs(twin).max(axis=0)
        np.testing.assert_allclose(jacobian[:, :, j] / scale, twin / scale, rtol=0, atol=1e-6)
