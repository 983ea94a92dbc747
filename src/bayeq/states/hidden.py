"""Hidden states: quantities that no channel measures, whose rates are stated, such as ``df = (u - f)/{tau}``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import ChainError, ExpressionError, InputError, UnknownNameError, require_texts, some_of
from bayeq.expressions import Evaluator, Expression, Symbol, Tape, parse
from bayeq.expressions.functions import TIME
from bayeq.numerics.rk4 import Drive, free_runs, interpolant
from bayeq.states.roles import Chain, Roles

# A hidden state starts from its steady state under the first samples of its drivers, if a run as long as the record
# reaches that: over its last share LAST the state changes by at most a share AT_REST. Otherwise it starts at 0.
LAST, AT_REST = 0.1, 1e-3

# Runge-Kutta steps between two samples.
SUBSTEPS = 4


def with_laws(laws: str | Sequence[str], roles: Roles) -> Roles:
    """The roles with a hidden state for each stated law, such as ``"df = (u - f)/{tau}"``.

    A ChainError refuses a law that is not of this form, or of a state that has an equation already; an ExpressionError
    or InputError a right-hand side that is no expression of channels and states.

    Examples
    --------
    >>> roles = with_laws("df = (u - f)/{tau}", Roles.parse("x::", inputs=["u"]))
    >>> roles.targets, roles.hidden[0].law.text
    (('ddx', 'df'), '(u-f)/{tau}')
    """
    require_texts(laws, "law")
    sides = [_sides(text) for text in ([laws] if isinstance(laws, str) else laws)]
    chains = [*roles.seen.chains, *roles.hidden]
    if len(roles.hidden) > 1 or (roles.hidden and sides):
        raise ChainError(
            f"chain '{roles.hidden[-1]}': one hidden state may have a dictionary; state laws of others, --law"
        )
    for name, text in sides:
        if name in roles.names or f"d{name}" in roles.names or [one for one, _ in sides].count(name) > 1:
            raise ChainError(f"law {text[:60]!r}: {name} has an equation, or is an input: give the state another name")
        chains.append(Chain((None, None), (name, None)))
    names = (*roles.names, *(chain.names[0] for chain in chains[len(roles.chains) :]), TIME)
    for k, (name, text) in enumerate(sides, len(roles.chains)):
        try:
            law = parse(text.partition("=")[2].strip(), names)
        except UnknownNameError as error:
            raise InputError(f"law d{name}: {error}; an unknown constant is written {{{error.name}}}") from error
        except ExpressionError as error:
            raise ExpressionError(f"law d{name}: {error}") from error
        held = law.names & {chain.target for chain in chains}
        if held:
            raise InputError(f"law d{name}: {some_of(sorted(held), 20)} is a highest derivative: use states and inputs")
        chains[k] = replace(chains[k], law=law)
    return roles.with_chains(chains)


def _sides(text: str) -> tuple[str, str]:
    """The name of the state whose rate a law gives, and the text of the law."""
    left, equals, right = text.partition("=")
    name = left.strip()
    form = f"law {text[:60]!r}: write the rate of a state and what it is, as in df = (u - f)/{{tau}}"
    if not equals or not right.strip() or len(name) < 2 or name[0] != "d" or not name.isidentifier():
        raise ChainError(form)
    if right.startswith("="):
        raise ChainError(f"{form}, with one =")
    words = re.findall(r"\w+", right)
    if name.startswith("dd") and name[1:] not in words and name[2:] in words:
        raise ChainError(f"{form}: it is of first order; write two laws, d{name[2:]} = g and dg = ...")
    return name[1:], text


def hidden_columns(roles: Roles, columns: Mapping[str, Floats], time: Floats | None) -> dict[str, Floats]:
    """Hidden states and their rates, (n,) each, integrated over `time` [s] with the `columns` in their laws;
    an InputError where they are not finite."""
    states = [name for chain in roles.hidden for name in chain.states]
    laws = [chain.law for chain in roles.hidden if chain.law is not None]
    if time is None:
        raise InputError("hidden states need time: name its column (time=, --time) or give the sampling rate (fs=)")
    known = {**columns, TIME: np.asarray(time, dtype=np.float64)}
    drivers = sorted({name for law in laws for name in law.names} - set(states))
    samples = np.column_stack([known[name] for name in drivers]) if drivers else np.zeros((len(time), 0))
    rates = list[Expression]()
    for chain, law in zip(roles.hidden, laws, strict=True):
        rates += [*(Expression(Symbol(name)) for name in chain.states[1:]), law]
    tape = Tape.compile(rates, [*states, *drivers])
    anywhere = np.full(len(states), np.inf)
    drive = Drive.over(time, interpolant(time, samples, "linear"), -anywhere, anywhere)
    drive = drive._replace(step=drive.step / SUBSTEPS)

    def run(inputs: Floats, first: Floats) -> Floats:
        out, stopped = np.empty((1, len(time), len(states))), np.zeros(1, dtype=np.uint32)
        free_runs(tape.program(), drive._replace(inputs=inputs), np.zeros((1, 0)), first[None].copy(), stopped, out)
        return out[0]

    still = np.broadcast_to(drive.inputs[:1], drive.inputs.shape).copy()
    still[:, :, 1:] = still[:, :, :1] * np.array([1.0, 0.0, 0.0])
    first = np.zeros(len(states))
    for start in (first, first + 1.0):  # a root or a logarithm has no value at 0
        rested = run(still, start)
        last = rested[int((1.0 - LAST) * len(time)) :]
        if np.isfinite(last).all() and (np.ptp(last, axis=0) <= AT_REST * np.abs(last[-1])).all():
            first = last[-1]
            break
    path = run(drive.inputs, first)
    found = {name: np.ascontiguousarray(values) for name, values in zip(states, path.T, strict=True)}
    found |= hidden_rates(roles, {**known, **found}, len(time))
    if not all(np.isfinite(values).all() for values in found.values()):
        written = "; ".join(f"{chain.target} = {law.text}" for chain, law in zip(roles.hidden, laws, strict=True))
        raise InputError(f"law {written[:80]}: not finite along the record; write abs() where a root or power needs it")
    return found


def hidden_rates(roles: Roles, columns: Mapping[str, Floats], n: int) -> dict[str, Floats]:
    """Highest derivatives of the hidden states by their laws, (n,) each."""
    evaluate = Evaluator(columns)
    laws = [(chain.target, chain.law) for chain in roles.hidden if chain.law is not None]
    return {name: np.broadcast_to(evaluate(law), n).astype(np.float64) for name, law in laws}
