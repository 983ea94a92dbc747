"""Expressions as tapes, and ``Evaluator``, on whole columns of samples, which shares common sub-expressions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayeq.arrays import Bools, Floats
from bayeq.errors import InputError, UnknownNameError
from bayeq.expressions.functions import (
    ABS,
    COMPARISONS,
    CONSTANTS,
    FUNCTIONS,
    PAIRS,
    PICK,
    SIGN,
    UNLESS,
    apply_function,
    apply_pair,
)
from bayeq.expressions.nodes import Binary, Call, Constant, Expression, Negate, Node, Number, Symbol, Unknown
from bayeq.expressions.parse import substituted, template
from bayeq.kernels import kernel

# Integer powers up to here are products, x**5 = x**4*x, so that the monomials of a dictionary share them.
MAX_INTEGER_POWER = 16

ARITHMETIC: dict[str, np.ufunc] = {"+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "**": np.power}


class Evaluator:
    """Evaluates expressions on columns; every sub-expression is computed once.

    Columns are the channels (arrays of one common shape, usually ``(n,)``) and parameters (floats) by name; InputError
    if the arrays differ in shape. Results are read-only, since later results may share them. Numerical trouble
    (division by zero, overflow, the logarithm of a negative number) gives non-finite values and no warning.

    >>> from bayeq.expressions import parse
    >>> evaluate = Evaluator({"x": [1.0, 2.0, 3.0], "k": 2.0})
    >>> evaluate(parse("k*x**2"))
    array([ 2.,  8., 18.])
    """

    def __init__(self, columns: Mapping[str, ArrayLike]) -> None:
        # Values are float64 arrays of the common shape, or np.float64 where constant; never 0-d arrays.
        self._memo: dict[Node, Floats | np.float64] = {}
        self._powers: dict[Node, list[Floats | np.float64]] = {}
        self._names = list(columns)
        shapes: dict[tuple[int, ...], str] = {}
        for name, column in columns.items():
            array = np.asarray(column, dtype=np.float64)
            if array.ndim == 0:
                self._memo[Symbol(name)] = np.float64(array)
                continue
            shapes.setdefault(array.shape, name)
            view = array.view()
            view.flags.writeable = False
            self._memo[Symbol(name)] = view
        if len(shapes) > 1:
            (one, first), (two, second) = list(shapes.items())[:2]
            raise InputError(f"columns differ in shape: {first!r} has {one}, {second!r} has {two}")
        self._shape = next(iter(shapes), ())

    def __call__(self, expression: Expression) -> Floats:
        """Values in the shape of the columns, read-only; UnknownNameError for a name that is no column."""
        with np.errstate(all="ignore"):
            value = self._value(expression.tree)
        if isinstance(value, np.float64):
            value = np.full(self._shape, value)
        value.flags.writeable = False
        return value

    def _value(self, node: Node) -> Floats | np.float64:
        if node not in self._memo:
            self._memo[node] = self._compute(node)
        return self._memo[node]

    def _compute(self, node: Node) -> Floats | np.float64:
        match node:
            case Number(value) | Unknown(value=value):
                return np.float64(value)
            case Constant(name):
                return np.float64(CONSTANTS[name])
            case Symbol(name):
                raise UnknownNameError("channel", name, self._names)
            case Negate(operand):
                return -self._value(operand)
            case Call(function, arguments):
                return FUNCTIONS[function].numpy(*map(self._value, arguments))
            case Binary("**", left, right):
                return self._power(left, self._value(right))
            case Binary(op, left, right) if op in COMPARISONS:
                return COMPARISONS[op].numpy(self._value(left), self._value(right)) * np.float64(1.0)
            case Binary(op, left, right):
                return ARITHMETIC[op](self._value(left), self._value(right))

    def _power(self, base: Node, exponent: Floats | np.float64) -> Floats | np.float64:
        value = self._value(base)
        if not isinstance(exponent, np.float64) or not exponent.is_integer() or abs(exponent) > MAX_INTEGER_POWER:
            return np.power(value, exponent)
        k = int(exponent)
        if k == 0:
            return np.float64(1.0)
        powers = self._powers.setdefault(base, [value])
        while len(powers) < abs(k):
            powers.append(powers[-1] * value)
        return powers[k - 1] if k > 0 else np.float64(1.0) / powers[-k - 1]


IndexArray: TypeAlias = NDArray[np.uint32]

# in the order of ARITHMETIC, and the sign
ADD, SUBTRACT, MULTIPLY, DIVIDE, POWER, NEGATE = range(6)
_OPCODES = {op: k for k, op in enumerate(ARITHMETIC)} | {op: one.opcode for op, one in COMPARISONS.items()}
# results of instructions on constants
_ON_CONSTANTS: dict[int, Callable[..., Any]] = {
    **dict(enumerate(ARITHMETIC.values())),
    **{one.opcode: one.numpy for one in COMPARISONS.values()},
    **{one.opcode: one.numpy for one in FUNCTIONS.values() if one.opcode},
    NEGATE: np.negative,
    PICK: lambda a, b: b if a else 0.0,
    UNLESS: lambda a, b: 0.0 if a else b,
}


class Program(NamedTuple):
    """A tape in the form that kernels take."""

    code: IndexArray  # (instructions, 4), opcode, destination, first and second operand of each instruction
    outputs: IndexArray  # (n_expressions,), the register of each expression's value
    # (n_registers,), the values of the variables in front; changed in place, so that each run needs its own
    registers: Floats


@kernel(borrowing=True)
def run_tape(program: Program, tangents: Floats | None) -> None:
    """Execute a tape: afterwards the outputs stand in ``program.registers[program.outputs]``.

    The values of the variables are in the first registers. Tangents (n_registers, q) are derivatives of each register
    along q directions: those of the variables in front are given (0 for constants), the others are computed. With None,
    for which the kernel is compiled separately, they cost nothing.
    """
    code, registers = program.code, program.registers
    for i in range(code.shape[0]):
        opcode, to, left, right = code[i, 0], code[i, 1], code[i, 2], code[i, 3]
        a = registers[left]
        b = registers[right]
        if opcode == MULTIPLY:
            value = a * b
            if tangents is not None:
                for j in range(tangents.shape[1]):
                    tangents[to, j] = a * tangents[right, j] + b * tangents[left, j]
        elif opcode == ADD:
            value = a + b
            if tangents is not None:
                for j in range(tangents.shape[1]):
                    tangents[to, j] = tangents[left, j] + tangents[right, j]
        elif opcode == SUBTRACT:
            value = a - b
            if tangents is not None:
                for j in range(tangents.shape[1]):
                    tangents[to, j] = tangents[left, j] - tangents[right, j]
        elif opcode == DIVIDE:
            value = a / b
            if tangents is not None:
                for j in range(tangents.shape[1]):
                    tangents[to, j] = (tangents[left, j] - value * tangents[right, j]) / b
        elif opcode == NEGATE:
            value = -a
            if tangents is not None:
                for j in range(tangents.shape[1]):
                    tangents[to, j] = -tangents[left, j]
        else:
            value = _value(opcode, a, b)
            if tangents is not None:
                for j in range(tangents.shape[1]):
                    tangents[to, j] = _slope(opcode, a, b, tangents[left, j], tangents[right, j])
        registers[to] = value


@kernel(borrowing=True)
def _value(opcode: int, a: float, b: float) -> float:
    """Value of a power or a function."""
    if opcode == POWER:
        return a**b
    if opcode >= PAIRS:
        return apply_pair(opcode, a, b)[0]
    return apply_function(opcode, a, False)


@kernel(borrowing=True)
def _slope(opcode: int, a: float, b: float, along_a: float, along_b: float) -> float:
    """Derivative of a power or a function along a direction of its arguments; a factor that is 0 leaves out what would
    be infinite or undefined."""
    slope = 0.0
    if opcode == POWER:
        if along_a != 0.0:
            slope = b * a ** (b - 1.0) * along_a
        if along_b != 0.0:
            slope += a**b * math.log(a) * along_b
    elif opcode >= PAIRS:
        _, by_a, by_b = apply_pair(opcode, a, b)
        if along_a != 0.0 and by_a != 0.0:
            slope = by_a * along_a
        if along_b != 0.0 and by_b != 0.0:
            slope += by_b * along_b
    elif along_a != 0.0:
        slope = apply_function(opcode, a, True) * along_a
    return slope


@dataclass(frozen=True, eq=False)
class Tape:
    """Expressions compiled for `run_tape`; make one with `Tape.compile`.

    >>> from bayeq.expressions import Tape, parse
    >>> tape = Tape.compile([parse("v"), parse("-2*v-x**3")], ["x", "v"])
    >>> tape([2.0, 1.0])
    array([  1., -10.])
    """

    variables: tuple[str, ...]  # their values are the first registers, in this order
    code: IndexArray  # (instructions, 4), opcode, destination, first and second operand
    initial: Floats  # (n_registers,), the constants in their places, and 0 elsewhere
    outputs: IndexArray  # (n_expressions,), the register of each expression's value

    @classmethod
    def compile(cls, expressions: Iterable[Expression], variables: Sequence[str]) -> Tape:
        """Compile expressions in some variables, common parts once; UnknownNameError for a name that is none."""
        compiler = _Compiler(variables)
        with np.errstate(all="ignore"):
            outputs = [compiler.register(e.tree) for e in expressions]
        return cls(
            variables=tuple(variables),
            code=np.array(compiler.code, dtype=np.uint32).reshape(-1, 4),
            initial=np.array(compiler.initial, dtype=np.float64),
            outputs=np.array(outputs, dtype=np.uint32),
        )

    def program(self, values: ArrayLike = ()) -> Program:
        """The tape with fresh registers; `values` are those of the first variables, the others are 0."""
        registers = self.initial.copy()
        given = np.asarray(values, dtype=np.float64)
        if given.ndim != 1 or len(given) > len(self.variables):
            raise InputError(f"expected at most {len(self.variables)} values, got shape {given.shape}")
        registers[: len(given)] = given
        return Program(self.code, self.outputs, registers)

    def __call__(self, values: ArrayLike) -> Floats:
        """Values of the expressions, ``(n_expressions,)``, at one point: a value per variable."""
        program = self.program(values)
        run_tape(program, None)
        return program.registers[self.outputs]


class _Compiler:
    """Assigns registers to values: the same operation on the same registers gets the same register."""

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
        match node:
            case Number(value) | Unknown(value=value):
                return self.constant(np.float64(value))
            case Symbol(name):
                if name not in self.variables:
                    raise UnknownNameError("channel", name, self.variables)
                return self.variables[name]
            case Constant(name):
                return self.constant(np.float64(CONSTANTS[name]))
            case Negate(operand):
                return self.emit(NEGATE, self.register(operand))
            case Call(function, arguments):
                return self.call(function, arguments)
            case Binary("**", left, right):
                return self.power(self.register(left), self.register(right))
            case Binary(op, left, right):
                return self.emit(_OPCODES[op], self.register(left), self.register(right))

    def call(self, function: str, arguments: Sequence[Node]) -> int:
        row = FUNCTIONS[function]
        if row.definition:
            return self.register(substituted(template(row.definition), arguments))
        registers = [self.register(argument) for argument in arguments]
        if function == "where":
            # what is not picked counts as 0, whatever it is
            condition, first, second = registers
            return self.emit(ADD, self.emit(PICK, condition, first), self.emit(UNLESS, condition, second))
        if len(registers) == 1:
            return self.emit(row.opcode, registers[0])
        return reduce(lambda a, b: self.emit(row.opcode, a, b), registers)

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
            return self.constant(np.float64(_ON_CONSTANTS[opcode](*(self.values[r] for r in operands))))
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


def registers_for(tape: Tape, rows: int) -> Floats:
    """Work space of `run_on_rows`, (n_registers, rows), with the constants in their places."""
    return np.repeat(tape.initial[:, None], rows, axis=1)


class RowTangents(NamedTuple):
    """Derivatives of registers along q directions in R rows; where `depends` is false they are left as they are."""

    values: Floats  # (n_registers, q, R)
    depends: Bools  # (n_registers, q), see `dependence`


@kernel
def dependence(code: IndexArray, depends: Bools) -> None:
    """On which variables each register depends: completes `depends`, (n_registers, q), given for the variables."""
    for i in range(code.shape[0]):
        to, left, right = code[i, 1], code[i, 2], code[i, 3]
        for j in range(depends.shape[1]):
            depends[to, j] = depends[left, j] or depends[right, j]


@kernel
def run_on_rows(code: IndexArray, registers: Floats, rows: int, tangents: RowTangents | None) -> None:
    """As `run_tape`, on the first `rows` columns of `registers`, (n_registers, R); variables are given in the first."""
    for i in range(code.shape[0]):
        opcode, to, left, right = code[i, 0], code[i, 1], code[i, 2], code[i, 3]
        out, a, b = registers[to], registers[left], registers[right]
        if tangents is not None:
            _tangents_on_rows(code[i], registers, rows, tangents.values, tangents.depends[to])
        if opcode == MULTIPLY:
            for k in range(rows):
                out[k] = a[k] * b[k]
        elif opcode == ADD:
            for k in range(rows):
                out[k] = a[k] + b[k]
        elif opcode == SUBTRACT:
            for k in range(rows):
                out[k] = a[k] - b[k]
        elif opcode == DIVIDE:
            for k in range(rows):
                out[k] = a[k] / b[k]
        elif opcode == NEGATE:
            for k in range(rows):
                out[k] = -a[k]
        elif opcode == ABS:
            for k in range(rows):
                out[k] = abs(a[k])
        elif opcode == SIGN:
            for k in range(rows):
                out[k] = a[k] if a[k] == 0.0 or a[k] != a[k] else np.copysign(1.0, a[k])
        else:
            for k in range(rows):
                out[k] = _value(opcode, a[k], b[k])


@kernel(borrowing=True)
def _tangents_on_rows(instruction: IndexArray, registers: Floats, rows: int, tangents: Floats, depends: Bools) -> None:
    """Derivatives of an instruction's result."""
    opcode, to, left, right = instruction[0], instruction[1], instruction[2], instruction[3]
    for j in range(tangents.shape[1]):
        if not depends[j]:
            continue
        if opcode == MULTIPLY:
            for k in range(rows):
                a, b = registers[left, k], registers[right, k]
                tangents[to, j, k] = a * tangents[right, j, k] + b * tangents[left, j, k]
        elif opcode == ADD:
            for k in range(rows):
                tangents[to, j, k] = tangents[left, j, k] + tangents[right, j, k]
        elif opcode == SUBTRACT:
            for k in range(rows):
                tangents[to, j, k] = tangents[left, j, k] - tangents[right, j, k]
        elif opcode == DIVIDE:
            for k in range(rows):
                b = registers[right, k]
                value = registers[left, k] / b
                tangents[to, j, k] = (tangents[left, j, k] - value * tangents[right, j, k]) / b
        elif opcode == NEGATE:
            for k in range(rows):
                tangents[to, j, k] = -tangents[left, j, k]
        else:
            for k in range(rows):
                a, b = registers[left, k], registers[right, k]
                tangents[to, j, k] = _slope(opcode, a, b, tangents[left, j, k], tangents[right, j, k])
