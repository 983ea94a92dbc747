"""``Tape``: expressions compiled for a register machine, to be evaluated point by point in kernels.

An integrator needs the right-hand side at one state at a time, where arrays do not help. A tape is plain
arrays, so that one compiled integrator serves every system without compiling anything per system.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayeq.errors import InputError, UnknownNameError
from bayeq.expressions.evaluate import ARITHMETIC, MAX_INTEGER_POWER, FloatArray
from bayeq.expressions.functions import (
    ABS,
    ACOS,
    ASIN,
    ATAN,
    COS,
    COSH,
    EXP,
    FUNCTIONS,
    LOG,
    SIGN,
    SIN,
    SINH,
    SQRT,
    TAN,
    TANH,
)
from bayeq.expressions.nodes import Binary, Call, Expression, Negate, Node, Number, Symbol
from bayeq.kernels import kernel

__all__ = ["IndexArray", "Tape", "apply_function", "run_tape"]

IndexArray: TypeAlias = NDArray[np.uint32]

ADD, SUBTRACT, MULTIPLY, DIVIDE, POWER, NEGATE = range(6)
_OPCODES = {"+": ADD, "-": SUBTRACT, "*": MULTIPLY, "/": DIVIDE, "**": POWER}
_UFUNCS: dict[int, np.ufunc] = {
    **{opcode: ARITHMETIC[op] for op, opcode in _OPCODES.items()},
    **{function.opcode: function.numpy for function in FUNCTIONS.values()},
    NEGATE: np.negative,
}


@kernel
def apply_function(opcode: int, a: float) -> float:
    """Value of the function with this opcode at `a` (NaN for an opcode that does not exist)."""
    if opcode == SIN:
        return math.sin(a)
    if opcode == COS:
        return math.cos(a)
    if opcode == TAN:
        return math.tan(a)
    if opcode == ASIN:
        return math.asin(a)
    if opcode == ACOS:
        return math.acos(a)
    if opcode == ATAN:
        return math.atan(a)
    if opcode == EXP:
        return math.exp(a)
    if opcode == LOG:
        return math.log(a)
    if opcode == SQRT:
        return math.sqrt(a)
    if opcode == SINH:
        return math.sinh(a)
    if opcode == COSH:
        return math.cosh(a)
    if opcode == TANH:
        return math.tanh(a)
    return math.nan


@kernel
def run_tape(code: IndexArray, registers: FloatArray) -> None:
    """Execute a tape: afterwards the outputs stand in ``registers[tape.outputs]``.

    Parameters
    ----------
    code : (instructions, 4) uint32 array
        Opcode, destination, first and second operand of each instruction.
    registers : (n,) float array
        From `Tape.registers`, with the values of the variables in front; changed in place.
    """
    for i in range(code.shape[0]):
        opcode = code[i, 0]
        a = registers[code[i, 2]]
        b = registers[code[i, 3]]
        if opcode == MULTIPLY:
            value = a * b
        elif opcode == ADD:
            value = a + b
        elif opcode == SUBTRACT:
            value = a - b
        elif opcode == DIVIDE:
            value = a / b
        elif opcode == NEGATE:
            value = -a
        elif opcode == POWER:
            value = a**b
        elif opcode == ABS:
            value = abs(a)
        elif opcode == SIGN:
            value = 1.0 if a > 0.0 else -1.0 if a < 0.0 else 0.0 if a == 0.0 else a
        else:
            value = apply_function(opcode, a)
        registers[code[i, 1]] = value


@dataclass(frozen=True, eq=False)
class Tape:
    """Expressions compiled for `run_tape`; make one with `Tape.compile`.

    Attributes
    ----------
    variables : tuple of str
        Their values are the first registers, in this order.
    code : (instructions, 4) uint32 array
        Opcode, destination, first and second operand.
    initial : (n_registers,) float array
        The constants in their places, and 0 elsewhere.
    outputs : (n_expressions,) uint32 array
        The register of each expression's value.

    Examples
    --------
    >>> from bayeq.expressions import Tape, parse
    >>> tape = Tape.compile([parse("v"), parse("-2*v-x**3")], ["x", "v"])
    >>> tape([2.0, 1.0])
    array([  1., -10.])
    """

    variables: tuple[str, ...]
    code: IndexArray
    initial: FloatArray
    outputs: IndexArray

    @classmethod
    def compile(cls, expressions: Iterable[Expression], variables: Sequence[str]) -> Tape:
        """Compile expressions in the given variables; common sub-expressions are computed once.

        Raises
        ------
        UnknownNameError
            If an expression uses a name that is not a variable.
        """
        compiler = _Compiler(variables)
        with np.errstate(all="ignore"):
            outputs = [compiler.register(e.tree) for e in expressions]
        return cls(
            variables=tuple(variables),
            code=np.array(compiler.code, dtype=np.uint32).reshape(-1, 4),
            initial=np.array(compiler.initial, dtype=np.float64),
            outputs=np.array(outputs, dtype=np.uint32),
        )

    def registers(self, values: ArrayLike = ()) -> FloatArray:
        """Fresh registers for `run_tape`; `values` are those of the first variables, the others are 0."""
        registers = self.initial.copy()
        given = np.asarray(values, dtype=np.float64)
        if given.ndim != 1 or len(given) > len(self.variables):
            raise InputError(f"expected at most {len(self.variables)} values, got shape {given.shape}")
        registers[: len(given)] = given
        return registers

    def __call__(self, values: ArrayLike) -> FloatArray:
        """Values of the expressions, ``(n_expressions,)``, at one point: a value per variable."""
        registers = self.registers(values)
        run_tape(self.code, registers)
        return registers[self.outputs]


class _Compiler:
    """Numbers values: the same operation on the same registers is the same register."""

    def __init__(self, variables: Sequence[str]) -> None:
        self.variables = {name: i for i, name in enumerate(variables)}
        if len(self.variables) < len(variables):
            raise InputError(f"variables are repeated: {', '.join(variables)}")
        self.initial = [0.0] * len(self.variables)
        self.code: list[tuple[int, int, int, int]] = []
        self.constants: dict[bytes, int] = {}
        self.values: dict[int, np.float64] = {}
        self.known: dict[tuple[int, int, int], int] = {}

    def register(self, node: Node) -> int:
        """The register that holds the value of a node."""
        match node:
            case Number(value):
                return self.constant(np.float64(value))
            case Symbol(name):
                if name not in self.variables:
                    raise UnknownNameError("channel", name, self.variables)
                return self.variables[name]
            case Negate(operand):
                return self.emit(NEGATE, self.register(operand))
            case Call(function, argument):
                return self.emit(FUNCTIONS[function].opcode, self.register(argument))
            case Binary("**", left, right):
                return self.power(self.register(left), self.register(right))
            case Binary(op, left, right):
                return self.emit(_OPCODES[op], self.register(left), self.register(right))

    def constant(self, value: np.float64) -> int:
        key = value.tobytes()  # the bits: 0.0 and -0.0 differ, NaN equals itself
        if key not in self.constants:
            self.constants[key] = len(self.initial)
            self.values[len(self.initial)] = value
            self.initial.append(float(value))
        return self.constants[key]

    def emit(self, opcode: int, a: int, b: int | None = None) -> int:
        operands: tuple[int, ...] = (a,) if b is None else (a, b)
        if all(r in self.values for r in operands):
            return self.constant(np.float64(_UFUNCS[opcode](*(self.values[r] for r in operands))))
        if opcode in (ADD, MULTIPLY):
            operands = tuple(sorted(operands))
        key = (opcode, operands[0], operands[-1])
        if key not in self.known:
            self.known[key] = len(self.initial)
            self.code.append((opcode, len(self.initial), operands[0], operands[-1]))
            self.initial.append(0.0)
        return self.known[key]

    def power(self, base: int, exponent: int) -> int:
        """As in `Evaluator`: small integer powers are products."""
        value = self.values.get(exponent)
        if value is None or not value.is_integer() or abs(value) > MAX_INTEGER_POWER:
            return self.emit(POWER, base, exponent)
        if value == 0:
            return self.constant(np.float64(1.0))
        product = base
        for _ in range(1, abs(int(value))):
            product = self.emit(MULTIPLY, product, base)
        return product if value > 0 else self.emit(DIVIDE, self.constant(np.float64(1.0)), product)
