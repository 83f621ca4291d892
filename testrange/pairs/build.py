"""From a formula in mpmath to a reference pair: exact inputs, 30 digits, condition number, tolerance, mistakes told apart.

Knows no formula; those are in `clauses`.
"""

from collections.abc import Callable, Mapping, Sequence
from decimal import Decimal
from typing import Any, Literal

import mpmath
from mpmath import mpf

from testrange.pairs.model import DIGITS, Input, Numbers, Pair, PairsError, Result

WORKING_DIGITS = 60
ORDINARY = "1e-9"
_UNIT_ROUNDOFF = mpf(2) ** -53
_ROUNDINGS = 16  # of each input that a careful double-precision algorithm may commit
_LEAST_APART = 5  # tolerances between a result and a mistake, and between two mistakes

Values = dict[str, Any]  # name -> mpf, list of mpf, or list of lists
Formula = Callable[[Values], Any]  # -> mpf, or sequence of numbers in the order of the results
Kind = Literal["ordinary", "boundary", "ill_conditioned", "published"]

WELL_CONDITIONED = "double precision loses a few units of 1.1e-16 times the condition number, far below 1e-9"
BACKWARD_STABLE = (
    "1.1e-16 (unit roundoff) times 16 roundings times the condition number: what a backward stable algorithm keeps in double "
    "precision"
)


def quantised(value: Any, bits: int) -> float:
    """The nearest multiple of 2^-bits: a double whose decimals are few."""
    return float(mpmath.nint(mpf(value) * 2**bits) / mpf(2) ** bits)


def exact(value: float | int) -> str:
    """A double written out in full; it must be the nearest to its own 15 digits, which is all that spreadsheets keep."""
    if float(f"{value:.15g}") != value:
        raise PairsError("an input does not survive 15 digits", got=repr(value))
    return format(Decimal(value), "f")


def given(name: str, unit: str, meaning: str, value: Any) -> Input:
    """One input from Python numbers, or lists of them."""
    return Input(name=name, unit=unit, meaning=meaning, value=_texts(value))


def _texts(value: Any) -> Numbers:
    if not isinstance(value, (list, tuple)):
        return exact(value)
    if value and isinstance(value[0], (list, tuple)):
        return tuple(tuple(exact(v) for v in row) for row in value)
    return tuple(exact(v) for v in value)


def numbers(value: Numbers, kind: Callable[[str], Any] = mpf) -> Any:
    """Texts to numbers, in the same nesting."""
    if isinstance(value, str):
        return kind(value)
    return [numbers(v, kind) for v in value]


def _flat(found: Any) -> list[mpf]:
    if isinstance(found, (list, tuple)):
        return [x for part in found for x in _flat(part)]
    return [mpf(found)]


def _text(value: mpf) -> str:
    """30 significant digits; plain zero for zero."""
    if value == 0:
        return "0"
    return str(mpmath.nstr(value, DIGITS, strip_zeros=False, min_fixed=-6, max_fixed=DIGITS))


def pair(
    id: str,
    formula: str,
    clause: str,
    statement: str,
    inputs: Sequence[Input],
    results: Sequence[tuple[str, str]],
    solve: Formula,
    mistakes: Mapping[str, Formula],
    *,
    kind: Kind = "ordinary",
    scale: Sequence[float] | None = None,
    condition: Callable[[Values], mpf] | None = None,
    condition_note: str | None = None,
    tolerance_why: str | None = None,
    derived_tolerance: bool = False,
    published: str | None = None,
) -> Pair:
    """One reference pair.

    Parameters
    ----------
    solve : callable
        The formula in mpmath.
    mistakes : mapping
        What went wrong -> the formula with that mistake; those whose value cannot be told from the result's are refused.
    scale : sequence of float, optional
        What the relative tolerance refers to where a result's own size will not do (zero, an element of a rotation). One for all
        results, or one each.
    condition : callable, optional
        Where differences in every input would take too long; the default takes them.
    derived_tolerance : bool
        The tolerance follows from the condition number where that asks for more than 1e-9.

    Raises
    ------
    PairsError
        A result without scale, or a mistake that does not show.
    """
    with mpmath.workdps(WORKING_DIGITS):
        values = {i.name: numbers(i.value) for i in inputs}
        found = _flat(solve(values))
        if len(found) != len(results):
            raise PairsError("as many results as names", where=id, got=len(found), expected=len(results))
        sizes = [abs(v) for v in found] if scale is None else [mpf(scale[i % len(scale)]) for i in range(len(found))]
        if any(s == 0 for s in sizes):
            raise PairsError("a result is zero and has no scale", where=id)
        kappa = (condition or (lambda v: _condition(solve, v, sizes)))(values)
        share = mpf(ORDINARY)
        why = tolerance_why or WELL_CONDITIONED
        if derived_tolerance and _ROUNDINGS * _UNIT_ROUNDOFF * kappa > share:
            share, why = mpf(mpmath.nstr(_ROUNDINGS * _UNIT_ROUNDOFF * kappa, 2)), tolerance_why or BACKWARD_STABLE
        tolerance = [share * s for s in sizes]
        wrong = {name: _flat(one(values)) for name, one in mistakes.items()}
        _tell_apart(id, found, tolerance, wrong)
        return Pair(
            id=id,
            formula=formula,
            clause=clause,
            kind=kind,
            statement=" ".join(statement.split()),
            inputs=tuple(inputs),
            results=tuple(
                Result(name=name, unit=unit, value=_text(v), tolerance=mpmath.nstr(t, 3))
                for (name, unit), v, t in zip(results, found, tolerance, strict=True)
            ),
            condition=mpmath.nstr(kappa, 2),
            condition_note=condition_note or "greatest over the results: sum over all inputs x of |x df/dx| / |f|",
            tolerance_relative=mpmath.nstr(share, 2),
            tolerance_why=why,
            mistakes={name: tuple(_text(v) for v in values) for name, values in wrong.items()},
            published=published,
        )


def _tell_apart(id: str, found: list[mpf], tolerance: list[mpf], wrong: Mapping[str, list[mpf]]) -> None:
    known = {"the result": found}
    for name, values in wrong.items():
        if len(values) != len(found):
            raise PairsError(f"mistake {name!r} has another number of values", where=id)
        for other, those in known.items():
            if max(abs(a - b) / t for a, b, t in zip(values, those, tolerance, strict=True)) < _LEAST_APART:
                raise PairsError(f"mistake {name!r} cannot be told from {other!r}", where=id)
        known[name] = values


def _condition(solve: Formula, values: Values, sizes: list[mpf]) -> mpf:
    """max over results of sum over inputs of |x df/dx| / size, by central differences."""
    total = [mpf(0)] * len(sizes)
    step = mpf(10) ** -18

    def vary(rebuilt: Callable[[mpf], Values], x: mpf) -> None:
        if x == 0:
            return
        above, below = (_flat(solve(rebuilt(x * (1 + s)))) for s in (step, -step))
        for j, (a, b) in enumerate(zip(above, below, strict=True)):
            total[j] += abs(a - b) / (2 * step) / sizes[j]

    for name, value in values.items():
        if not isinstance(value, list):
            vary(lambda x, n=name: {**values, n: x}, value)  # type: ignore[misc]
            continue
        for i, part in enumerate(value):
            if not isinstance(part, list):
                vary(lambda x, n=name, v=value, k=i: {**values, n: [*v[:k], x, *v[k + 1 :]]}, part)  # type: ignore[misc]
                continue
            for j, x0 in enumerate(part):
                vary(
                    lambda x, n=name, v=value, p=part, k=i, m=j: {  # type: ignore[misc]
                        **values,
                        n: [*v[:k], [*p[:m], x, *p[m + 1 :]], *v[k + 1 :]],
                    },
                    x0,
                )
    return max(total)
