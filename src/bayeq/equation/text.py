"""The answer as text, and the table of its terms."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from rich import box, markup
from rich.console import Console
from rich.table import Table

from bayeq.dictionary.specification import split_at
from bayeq.equation.answer import Answer
from bayeq.equation.equation import Equation
from bayeq.equation.verdict import CLIPPED, LEAST_SHOWN
from bayeq.equation.written import chance, moment, odds_text, plain_sd, round_to, with_interval
from bayeq.errors import in_digits, printable
from bayeq.forecast.score import Scores, percent, percentages
from bayeq.inference.engines import ENGINES, NOTEWORTHY_PIP
from bayeq.markup import printed, text_console
from bayeq.regression.residuals import Driver
from bayeq.states import rates

# Wider than any table: in a pipe no line is broken.
WIDE = 10_000
# Longer names are shortened in tables; to half of this on terminals with fewer columns than ROOMY.
LONGEST_NAME, ROOMY = 24, 110

# The likelihood's own coefficients are printed too if they differ by more than this many standard deviations.
FAR = 3.0

# An intercept of zero with a smaller standard deviation was not estimated.
NOTHING = 1e-100

# A term of a higher PIP is called certain.
CERTAIN = 0.99

# Mark of intervals over models, and its footnote.
MARK = "*"
OVER_MODELS = "interval over all models that hold the term; given the terms shown: shown_ci95, --conditional"
# Terms that the record does not determine are listed up to this number.
MOST_UNDETERMINED = 6

# A form is undecided if the second likeliest has more than this probability: within 3 nats.
FORMS = 0.05

# A property of the residuals is reported if its p-value is smaller.
DOUBTFUL = 1e-3

# Names of the interpolations of inputs between samples.
BETWEEN = {"linear": "straight lines", "hold": "held", "band-limited": "band-limited", "cubic": "smooth"}


def escape(text: str) -> str:
    """Text from a file, with markup escaped and without control characters of terminals."""
    return markup.escape(printable(text))


def render(eq: Answer, with_warnings: bool = True, conditional: bool = False) -> str:
    """The equations, styled on a terminal, else Markdown; with `conditional` intervals are given the terms shown."""
    console = text_console(WIDE)
    console.print(f"verdict: {escape(str(eq.verdict))}\n")
    for equation in eq.equations:
        _render_equation(console, equation, ENGINES[eq.method].score, eq.scores, conditional)
    console.print(f"{markup.escape(source_of(eq))}; method: {eq.method} (bayeq discover -h)")
    if eq.data.estimated:
        how = "smoothing" if eq.data.smoothed else "central differences"
        console.print(f"not measured, estimated by {how}: {escape(', '.join(eq.data.estimated))}")
    for line in given_of(eq):
        console.print(escape(line))
    for name, kind in eq.data.interpolation.items():
        console.print(f"{escape(name)} between samples: {BETWEEN[kind]}")
    for message in eq.warnings if with_warnings else ():
        console.print(f"[yellow]warning:[/yellow] {escape(message)}")
    return printed(console)


def given_of(eq: Answer) -> list[str]:
    """Lines on hidden states, the band, given noise and calibration, learned lags, refinement and constraints."""
    known, out = eq.data.sensors, hidden_of(eq)
    if eq.data.band is not None:
        low, high = eq.data.band
        out.append(f"band: the record is believed between {low:g} and {high:g} Hz")
    listed = ", ".join(f"{name} {sd:.3g}" for name, sd in known.noise.items() if name not in known.of_reading)
    if listed:
        out.append(f"noise given, standard deviation: {listed}")
    for name, share in known.of_reading.items():
        out.append(f"noise of {name}: in proportion to the reading, {f'{100 * share:.3g} %' if share else 'learned'}")
    if known.tails == "student":
        out.append("noise: Student's t, with degrees of freedom estimated per channel")
    if known.gain_sd:
        listed = ", ".join(f"{name} {100 * sd:.3g} %" for name, sd in known.gain_sd.items())
        out.append(f"intervals {'do not include' if eq.refined else 'include'} the calibration: {listed}")
    out += learned_of(eq)
    if eq.refined:
        out.append(str(eq.refined))
    if eq.constraints:
        out.append(f"constraints: {'; '.join(eq.constraints)}")
    return out


def hidden_of(eq: Answer) -> list[str]:
    """A line for each hidden state with the odds of the equations without it."""
    out = []
    for one in eq.hidden:
        odds = odds_text(one.log_odds_without) if math.isfinite(one.log_odds_without) else "not known, no fit has it"
        out.append(f"hidden {one.state}: odds of the equations without it {odds}")
    return out


def learned_of(eq: Answer) -> list[str]:
    """A line for each lag or calibration factor of a channel that was learned."""
    found = {"lag": eq.data.sensors.lags, "factor": eq.data.sensors.gains}
    return [f"{what} of {name}: {one} (learned)" for what, learned in found.items() for name, one in learned.items()]


def source_of(eq: Answer, short: bool = False) -> str:
    """Rows, rate and file, and which rows were used and held out; in fewer words with `short`."""
    names = [name for name in eq.data.files if name]
    source = f" of {printable(names[0])}" if len(names) == 1 else f" of {len(eq.data.files)} records" if names else ""
    used = f"{eq.data.n_train} used"
    if eq.data.stretches:
        judged = "fits" if eq.data.refitted else "residuals"
        used = "all used" if eq.data.refitted else used
        used += f"; {judged}, free runs and verdict are those of {eq.data.stretches} stretches of them"
    elif eq.data.refitted and short:
        used = f"all used; checks are of the first {eq.data.n_train}"
    elif eq.data.refitted:
        runs = " and free runs" if eq.states else ""
        used = f"all used; fits{runs} on the last {eq.data.n_held_out} are those of the first {eq.data.n_train}"
    rate = ""  # and length of the records, as far as known
    if eq.data.rows_as_time and not eq.roles.discrete:
        rate = ", time not known"
    elif eq.data.sampling is not None and not eq.roles.discrete:
        rate = " at {}, {}".format(*eq.data.sampling)
    return f"{eq.data.n} rows{rate}{',' if rate and source else ''}{source}, {used}"


def _render_equation(
    console: Console, equation: Equation, score: str, scores: Scores | None, conditional: bool
) -> None:
    console.print(f"[bold]{escape(equation.text)}[/bold]\n")
    rows = rows_of(equation, conditional)
    longest = LONGEST_NAME if console.width >= ROOMY else LONGEST_NAME // 2
    names = short_names([row.name for row in rows if row.score], longest)
    _print_table(console, equation, rows, score, names)
    if names:
        console.print(escape(f"\nin the table: {', '.join(f'{short} is {name}' for name, short in names.items())}"))
    if any(row.over_models for row in rows):
        console.print(f"\n{MARK} {OVER_MODELS}")
    if equation.chain.stated:
        console.print("")
        return
    rest = len(equation.terms) - sum(bool(row.score) for row in rows)
    if rest:
        low = [p for p in equation.posterior.pip if p < NOTEWORTHY_PIP]
        console.print(f"\n{rest} more candidates not included, {score} at most {max(low, default=0.0):.2g}")
    if not equation.chain.hidden:
        console.print(f"noise sd {round_to(equation.noise_sd, equation.noise_sd / 50)}")
    doubts = [*forms_of(equation), *equation.at_ends, *_differences(equation, score), *unseen(equation)]
    for line in (*_checks(equation, scores), *doubts):
        console.print(escape(line))
    # models that are likelier only because terms were left out are no runners-up
    runners_up = [r for r in equation.runners_up if not equation.left_out or r.log_odds <= 0]
    if runners_up:
        console.print("runners-up, with their posterior odds against this equation:")
        for r in runners_up:
            console.print(f"{r.odds:>10}  {escape(str(r))}")
    console.print("")


def forms_of(equation: Equation) -> list[str]:
    """A line with the probabilities of the members of each either-or in the equation."""
    out, shown = [], set(equation.shown)
    for found in equation.forms.values():
        if len(found) > 1 and any(shown.issuperset(split_at(name)) for name in found):
            ranked = sorted(found, key=lambda name: -found[name])
            weights = [math.exp(found[name] - found[ranked[0]]) for name in ranked]
            shares = [weight / sum(weights) for weight in weights]
            listed = [f"{name.replace(', ', ' and ')} {share:.3f}" for name, share in zip(ranked, shares, strict=True)]
            out.append(f"form{'' if shares[1] < FORMS else ' undecided'}: {', '.join(listed)}")
    return out


def _differences(equation: Equation, score: str) -> list[str]:
    """Lines on terms that are included or shown but not both, and on coefficients far from the likelihood's own."""
    p, shown, out = equation.posterior, equation.shown_posterior, list[str]()
    for left in equation.left_out:
        sure = "certain" if left.pip > CERTAIN else "likely"
        found = f"{score} {left.pip:.3f}, explains {percent(left.share)}"
        if left.reason == "tolerance":
            out.append(f"{left.name} is {sure}, but changes nothing here: left out ({found}; --tolerance 0 shows it)")
        else:
            out.append(f"included, but left out ({left.reason}): {left.name}, {found}")
    for j, term in enumerate(equation.terms):
        if shown.support[j] and not p.support[j]:
            out.append(f"shown, though its {score} is {p.pip[j]:.3f}: {term.text} ({equation.why[term.text]})")
    if shown.projected is not None:
        own, sd = shown.projected.coef, shown.projected.sd
        # if the discrepancy is a force of long memory, independent of the motion, the likelihood is more accurate
        far = np.flatnonzero(shown.support & (np.abs(shown.coef - own) > FAR * sd))
        listed = [f"{equation.terms[j].text} {round_to(own[j], sd[j])}" for j in far]
        if listed:
            out.append(
                f"by the likelihood alone, as if what is left out were a force independent of the motion:"
                f" {', '.join(listed)} (likelihood_ci95)"
            )
    return out


def _print_table(
    console: Console, equation: Equation, rows: Sequence[Row], score: str, names: Mapping[str, str]
) -> None:
    """Print the table of terms, without units and shares of variance if the terminal is too narrow for them."""
    left_out, terminal = list[str](), console.is_terminal
    kept = np.flatnonzero(equation.shown_posterior.support)
    # further columns, where they are known
    extra = ["share"] if equation.share is not None and len(kept) else []
    extra += ["unit"] if any(equation.coef_units[j] for j in kept) else []
    while True:
        table = Table(box=box.SIMPLE_HEAD if terminal else box.MARKDOWN, pad_edge=True)
        table.add_column("term", overflow="fold")
        for name in ("coefficient", "sd", "95 % interval", score):
            table.add_column(name, justify="right", no_wrap=True)
        for name in extra:
            table.add_column(name, justify="left" if name == "unit" else "right", no_wrap=True)
        for row in rows:
            further = (escape(getattr(row, name)) for name in extra)
            number = row.coefficient or row.absent
            table.add_row(with_names(escape(row.name), names), number, row.sd, row.marked, row.score, *further)
        needed = console.measure(table, options=console.options.update(width=WIDE)).maximum
        if not (terminal and extra and needed > console.width):
            break
        left_out.insert(0, extra.pop())
    console.print(table)
    if left_out:
        console.print(f"\n{' and '.join(left_out)}: not shown: the terminal is too narrow")


def unseen(equation: Equation, most: int = MOST_UNDETERMINED, advice: str = "") -> list[str]:
    """A line on terms too small to be seen in the record that could matter at other amplitudes; empty if none are."""
    if not equation.undetermined or equation.bound is None:
        return []
    bound = dict(zip([term.text for term in equation.terms], equation.bound.tolist(), strict=True))
    listed = [f"{name} below {bound[name]:.2g}" for name in equation.undetermined[:most]]
    rest = len(equation.undetermined) - len(listed)
    return [f"too small to be seen here: {', '.join(listed)}{f', {rest} more{advice}' if rest else ''}"]


def _checks(equation: Equation, scores: Scores | None) -> Iterator[str]:
    """Lines on factors between channels of inconsistent units, on fits, the free run and the residuals."""
    chain = equation.chain
    factors = rates(chain, equation.unit_gains)
    if not all(math.isclose(factor, 1.0) for factor in factors):
        links = zip(chain.names[:-1], factors, chain.names[1:], strict=True)
        yield f"units of the channels: {', '.join(f'd{low}/dt = {factor:.6g} {high}' for low, factor, high in links)}"
    if chain.hidden:
        return
    for label, fit in (("training", equation.train), ("held-out", equation.held_out)):
        if fit is not None:
            r2 = f"{fit.r2:.4f}" if fit.r2 > -1e4 else f"{fit.r2:.2g}"
            yield f"{label} rows ({fit.n}): R2 {r2}, normalised RMS error {in_digits(100 * fit.nrmse)} %"
    run = {} if scores is None else {name: scores.free_run[name] for name in chain.states if name in scores.free_run}
    if scores is not None and scores.blew_up_at is not None:
        yield f"free run over the held-out rows: blew up at {moment(scores.blew_up_at, chain.discrete)}"
    elif run:  # a state is measured
        yield f"free run over the held-out rows: normalised RMS error {percentages(run)}"
    found, left = equation.residuals, left_beside_noise(equation)
    shape = "no normal distribution" if found.normality < DOUBTFUL else "what is left looks like noise"
    yield f"residuals: lag-1 autocorrelation {found.lag1:.2f}, effective sample size {found.n_eff:.0f} of {found.n}"
    yield (
        f"residuals: {shape} (skewness {found.skewness:.2f}, excess kurtosis {found.kurtosis:.2f},"
        f" {chance(found.normality)})"
    )
    if left is not None:
        yield f"unexplained beside noise: {left} of the target's standard deviation"
    driver = followed(equation)
    if driver is not None:
        yield f"residuals: follow {driver} ({chance(driver.p_value)})"
    elif found.driver is not None and found.driver.p_value >= DOUBTFUL:
        yield "residuals: follow no input or state at any lag"


def followed(equation: Equation) -> Driver | None:
    """The input or state that residuals follow, unless tests that say more found nothing."""
    driver = equation.residuals.driver
    # errors of an estimated derivative follow the motion: the tests behind the verdict say more
    by_likelihood = equation.chain.measured[-1] is None or equation.likelihood_model is not None
    tested = by_likelihood and (equation.verdict.kind == "found" or CLIPPED in str(equation.verdict))
    return None if driver is None or driver.p_value >= DOUBTFUL or tested else driver


def left_beside_noise(equation: Equation) -> str | None:
    """Discrepancy that terms leave beside noise, in per cent of the target's standard deviation; None if not known."""
    share = equation.residuals.discrepancy if equation.error_share is None else equation.error_share
    if share is None:
        return None
    return percent(share) if share > LEAST_SHOWN else f"less than {100 * LEAST_SHOWN:g} %"


_NAME = re.compile(r"[^\W\d]\w*")


@dataclass(frozen=True, slots=True)
class Row:
    """A row of the table: a term, a constant inside terms, or the intercept; texts may be empty."""

    name: str  # the term, ``{name}`` of a constant, or ``intercept``
    coefficient: str = ""  # empty, like `sd` and `interval`, for a term that is not shown
    sd: str = ""
    interval: str = ""
    over_models: bool = False  # whether the interval is the one over models
    absent: str = ""  # text in place of the coefficient of a term that is not shown
    pip: float = math.nan  # posterior inclusion probability; NaN for a constant or the intercept
    share: str = ""  # share of the target's variance
    unit: str = ""

    @property
    def marked(self) -> str:
        """The interval, marked where it is the one over models."""
        return self.interval + f" {MARK}" * self.over_models

    @property
    def score(self) -> str:
        """Text of the probability; empty for a constant or the intercept."""
        return "" if math.isnan(self.pip) else f"{self.pip:.3f}"


def rows_of(equation: Equation, conditional: bool = False) -> list[Row]:
    """Terms shown, included or likely, constants, intercept; with `conditional` intervals are given the terms shown."""
    p, shown, rows = equation.posterior, equation.shown_posterior, list[Row]()
    intervals = equation.shown_ci95 if conditional else equation.printed_ci95
    for j, term in enumerate(() if equation.chain.stated else equation.terms):  # a stated law has no candidates
        pip = float(p.pip[j])
        if shown.support[j]:
            share = math.nan if equation.share is None else equation.share[j]
            rows.append(
                Row(
                    term.text,
                    *with_interval(shown.coef[j], shown.sd[j], intervals[j]),
                    over_models=bool(equation.printed_over_models[j]) and not conditional,
                    pip=pip,
                    share=percent(share) if math.isfinite(share) else "",
                    unit=equation.coef_units[j] or "",
                )
            )
        elif p.support[j] or pip >= NOTEWORTHY_PIP:
            rows.append(Row(term.text, absent="not shown" if p.support[j] else "not included", pip=pip))
    for one in equation.shown_constants:
        numbers, unit = with_interval(one.value, plain_sd(one), one.ci95), equation.constant_units.get(one.name, "")
        rows.append(Row(f"{{{one.name}}}", *numbers, unit=unit))
    model = equation.shown_model
    if shown.intercept == 0.0 and model.intercept_sd < NOTHING:
        return [*rows, Row("intercept", absent="none")]
    ends = equation.intercept_ci95 if conditional else equation.printed_intercept_ci95
    over_models, unit = ends != equation.intercept_ci95, equation.units.get(equation.target, "")
    numbers = with_interval(model.intercept, model.intercept_sd, ends)
    return [*rows, Row("intercept", *numbers, over_models=over_models, unit=unit)]


def short_names(texts: Sequence[str], longest: int) -> dict[str, str]:
    """Shorter spellings of the names in terms that have more than `longest` characters, by name.

    Beginning and end are kept. Names that would look alike are shortened less.

    >>> short_names(["x", "displacement_of_mass_1**3", "displacement_of_mass_2"], 12)
    {'displacement_of_mass_1': 'displa…ass_1', 'displacement_of_mass_2': 'displa…ass_2'}
    """
    names = list(dict.fromkeys(name for text in texts for name in _NAME.findall(text)))
    for length in range(longest, max(map(len, names), default=0)):
        front = length // 2
        out = {
            name: name if len(name) <= length else f"{name[:front]}…{name[len(name) - (length - front - 1) :]}"
            for name in names
        }
        if len(set(out.values())) == len(names):
            return {name: short for name, short in out.items() if short != name}
    return {}


def with_names(text: str, names: Mapping[str, str]) -> str:
    """A term with its names replaced as in `names`.

    >>> with_names("displacement**3*dis", {"displacement": "dis…ent"})
    'dis…ent**3*dis'
    """
    return _NAME.sub(lambda found: names.get(found.group(), found.group()), text)
