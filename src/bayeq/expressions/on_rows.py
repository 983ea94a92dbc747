"""A tape run on many rows at once: every instruction goes over a block of rows that stays in the cache."""

from __future__ import annotations

import numpy as np

from bayeq.expressions.evaluate import FloatArray
from bayeq.expressions.functions import ABS, PAIRS, SIGN
from bayeq.expressions.tape import (
    ADD,
    DIVIDE,
    MULTIPLY,
    NEGATE,
    POWER,
    SUBTRACT,
    IndexArray,
    Tape,
    apply_function,
    apply_pair,
)
from bayeq.kernels import kernel

__all__ = ["registers_for", "run_on_rows"]


def registers_for(tape: Tape, rows: int) -> FloatArray:
    """Work space of `run_on_rows`, (n_registers, rows), with the constants in their places."""
    return np.repeat(tape.initial[:, None], rows, axis=1)


@kernel
def run_on_rows(code: IndexArray, registers: FloatArray, rows: int) -> None:
    """Execute a tape on the first `rows` columns of `registers`, (n_registers, R); variables are given in the first."""
    for i in range(code.shape[0]):
        opcode, to, left, right = code[i, 0], code[i, 1], code[i, 2], code[i, 3]
        out, a, b = registers[to], registers[left], registers[right]
        if opcode == MULTIPLY:
            for j in range(rows):
                out[j] = a[j] * b[j]
        elif opcode == ADD:
            for j in range(rows):
                out[j] = a[j] + b[j]
        elif opcode == SUBTRACT:
            for j in range(rows):
                out[j] = a[j] - b[j]
        elif opcode == DIVIDE:
            for j in range(rows):
                out[j] = a[j] / b[j]
        elif opcode == NEGATE:
            for j in range(rows):
                out[j] = -a[j]
        elif opcode == ABS:
            for j in range(rows):
                out[j] = abs(a[j])
        elif opcode == SIGN:
            for j in range(rows):
                out[j] = a[j] if a[j] == 0.0 or a[j] != a[j] else np.copysign(1.0, a[j])
        elif opcode == POWER:
            for j in range(rows):
                out[j] = a[j] ** b[j]
        elif opcode >= PAIRS:
            for j in range(rows):
                out[j] = apply_pair(opcode, a[j], b[j])[0]
        else:
            for j in range(rows):
                out[j] = apply_function(opcode, a[j], False)
