"""Tables of step fractions that raise the order of a step by composition.

Two basic steps are composed (Phi a first-order free step, Phi* its adjoint, R the reflection):

- the *projected* step K~_h: self-adjoint, of order 2, K~_0 = 1. Then
  ``K~_{g_s h} ... K~_{g_2 h} K~_{g_1 h}`` obeys the order conditions of symmetric composition
  (Yoshida 1990, Phys. Lett. A 150; Hairer, Lubich, Wanner 2006, V.3);
- the *bare* step ``K_h = Phi_{h/2} R Phi*_{h/2}``: self-adjoint, but K_0 = R. Here
  ``M_h = K_h R`` is a first-order method with adjoint ``M*_h = R K_h``, and since R R = 1,
  ``K_{g_2 h} K_{g_1 h} = M_{g_2 h} M*_{g_1 h}``: an even number of bare steps obeys the order
  conditions of a method composed with its adjoint, which are those of splittings
  ``e^{b_i h B} e^{a_i h A}`` in two parts (McLachlan 1995, SIAM J. Sci. Comput. 16).

Stages are listed in the order in which they are taken. A palindrome, ``g_i = g_{s+1-i}``, makes the
composed step self-adjoint.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

from groupoid_gni.errors import InputError

ROUND_OFF = 1e-14


@dataclass(frozen=True)
class CompositionTable:
    """Fractions g_1, ..., g_s of the step, one for each stage, and where they come from.

    name : what to call it.
    order : p; the composed step differs from the flow by O(h^(p+1)).
    stages : (s,) floats, in the order in which they are taken; they sum to 1.
    source : paper, year, journal, and which table of it.
    projected : True for stages of the projected step K~, False for stages of the bare step K, whose
        number must be even so that the reflections pair up.

    Raises InputError if the stages cannot compose a consistent step.
    """

    name: str
    order: int
    stages: tuple[float, ...]
    source: str
    projected: bool

    def __post_init__(self) -> None:
        where = f"composition table {self.name!r}"
        if not isinstance(self.stages, tuple) or not self.stages:
            raise InputError(f"{where}: stages must be a non-empty tuple, not {self.stages!r}")
        if self.order < 1:
            raise InputError(f"{where}: order must be at least 1, not {self.order}")
        for number, stage in enumerate(self.stages, start=1):
            if not math.isfinite(stage) or stage == 0:
                raise InputError(
                    f"{where}: stage {number} is {stage!r}; every stage must be finite and not 0"
                )
        if abs(math.fsum(self.stages) - 1) > ROUND_OFF:
            raise InputError(
                f"{where}: the stages sum to {math.fsum(self.stages)!r}; they must sum to 1"
            )
        if not self.projected and len(self.stages) % 2:
            raise InputError(
                f"{where}: {len(self.stages)} bare stages leave one reflection over; their number "
                "must be even (split each in halves, or give projected=True)"
            )

    def __str__(self) -> str:
        return f"{self.name} (order {self.order}, {self.number_of_stages} stages)"

    @property
    def number_of_stages(self) -> int:
        """s, the number of basic steps in one composed step."""
        return len(self.stages)

    @property
    def symmetric(self) -> bool:
        """Whether the stages read the same backwards, so that the composed step is self-adjoint."""
        return self.stages == self.stages[::-1]

    @property
    def path_length(self) -> float:
        """``sum |g_i|``: the time walked, forwards and back, per unit of time gained."""
        return math.fsum(map(abs, self.stages))

    @property
    def largest_stage(self) -> float:
        """``max |g_i|``, which limits the step when a stage has an equation to solve."""
        return max(map(abs, self.stages))


def stages_of_splitting(a: Sequence[float], b: Sequence[float]) -> tuple[float, ...]:
    """Bare stages with the order conditions of ``e^{a_1 A} e^{b_1 B} e^{a_2 A} ... e^{a_{s+1} A}``.

    a : (s + 1,) and b : (s,), each with sum 1.
    Returns the 2 s numbers ``g_1 = a_1, g_2 = b_1 - g_1, g_3 = a_2 - g_2, ...``, so that each
    coefficient of the splitting is the sum of two neighbours (McLachlan 1995, section 2).
    Raises InputError if a is not one longer than b, or the sums differ from 1.
    """
    if len(a) != len(b) + 1:
        raise InputError(
            f"a splitting that starts and ends with A has one a more than b, not {len(a)} and "
            f"{len(b)}"
        )
    for letter, coefficients in (("a", a), ("b", b)):
        if abs(math.fsum(coefficients) - 1) > ROUND_OFF:
            raise InputError(
                f"the coefficients {letter} sum to {math.fsum(coefficients)!r}; they must sum to 1"
            )
    alternating = [c for pair in zip(a, b, strict=False) for c in pair]
    return tuple(accumulate(alternating, lambda previous, c: c - previous))


def doubled(table: CompositionTable) -> CompositionTable:
    """The table for bare steps from one for projected steps: every stage as two of half its size.

    ``K_{g h/2} K_{g h/2} = M_{g h/2} M*_{g h/2}`` is self-adjoint, of order 2 and tends to the
    identity, so the conditions of symmetric composition apply to it.
    Raises InputError if the table is for bare steps already.
    """
    if not table.projected:
        raise InputError(f"{table} is for bare steps already; double a table for projected steps")
    return CompositionTable(
        name=f"{table.name}, doubled",
        order=table.order,
        stages=tuple(stage / 2 for stage in table.stages for _ in range(2)),
        source=f"{table.source}; each stage as two of half its size",
        projected=False,
    )


def palindrome(first_half: Sequence[float], number: int) -> tuple[float, ...]:
    """The ``number`` stages that read the same backwards; an odd number counts the centre once."""
    return tuple(first_half) + tuple(reversed(first_half))[number % 2 :]


KAHAN_LI_1997 = "W. Kahan and R.-C. Li 1997, Math. Comp. 66, 1089-1099"
BLANES_MOAN_2002 = "S. Blanes and P. C. Moan 2002, J. Comput. Appl. Math. 142, 313-330"

BASIC = CompositionTable("one step", 2, (1.0,), "the projected step itself", projected=True)
# 1 / (4 - 4^(1/3)), twice on either side.
SUZUKI_4 = CompositionTable(
    name="Suzuki",
    order=4,
    stages=palindrome((0.41449077179437573714, 0.41449077179437573714, -0.65796308717750294857), 5),
    source="M. Suzuki 1990, Phys. Lett. A 146, 319-323",
    projected=True,
)
KAHAN_LI_6 = CompositionTable(
    name="Kahan-Li s9odr6a",
    order=6,
    stages=palindrome(
        (
            0.39216144400731413928,
            0.3325991367893594386,
            -0.70624617255763935981,
            0.08221359629355080023,
            0.7985439909348299634,
        ),
        9,
    ),
    source=f"{KAHAN_LI_1997}, s9odr6a",
    projected=True,
)
KAHAN_LI_8 = CompositionTable(
    name="Kahan-Li s17odr8a",
    order=8,
    stages=palindrome(
        (
            0.13020248308889008088,
            0.56116298177510838456,
            -0.38947496264484728641,
            0.1588419065551556009,
            -0.39590389413323757734,
            0.18453964097831570709,
            0.25837438768632204729,
            0.29501172360931029887,
            -0.6055085338300345117,
        ),
        17,
    ),
    source=f"{KAHAN_LI_1997}, s17odr8a",
    projected=True,
)
# a = 0.0792036964311957, 0.353172906049774, -0.0420650803577195, ...;
# b = 0.209515106613362, -0.143851773179818, ...
BLANES_MOAN_4 = CompositionTable(
    name="Blanes-Moan S6",
    order=4,
    stages=palindrome(
        (
            0.079203696431195660405,
            0.13031141018216637747,
            0.22286149586760767498,
            -0.36671326904742571397,
            0.32464818868970618275,
            0.10968847787674981837,
        ),
        12,
    ),
    source=f"{BLANES_MOAN_2002}, Table 2, S6 of order 4",
    projected=False,
)
# a = 0.0502627644003922, 0.413514300428344, 0.0450798897943977, -0.188054853819569,
# 0.541960678450780, ...; b = 0.148816447901042, -0.132385865767784, 0.067307604692185,
# 0.432666402578175, ...
BLANES_MOAN_6 = CompositionTable(
    name="Blanes-Moan S10",
    order=6,
    stages=palindrome(
        (
            0.050262764400392588607,
            0.098553683500650514634,
            0.3149606169276941955,
            -0.44734648269547755476,
            0.49242637248987548909,
            -0.42511876779769087476,
            0.23706391397812117439,
            0.19560248860005212062,
            0.34635818985072833889,
            -0.3627627792543459922,
        ),
        20,
    ),
    source=f"{BLANES_MOAN_2002}, Table 2, S10 of order 6",
    projected=False,
)
BASIC_DOUBLED = doubled(BASIC)
KAHAN_LI_8_DOUBLED = doubled(KAHAN_LI_8)

PROJECTED_TABLES = (BASIC, SUZUKI_4, KAHAN_LI_6, KAHAN_LI_8)
BARE_TABLES = (BASIC_DOUBLED, BLANES_MOAN_4, BLANES_MOAN_6, KAHAN_LI_8_DOUBLED)

DEFAULTS = {
    True: {2: BASIC, 4: SUZUKI_4, 6: KAHAN_LI_6, 8: KAHAN_LI_8},
    False: {2: BASIC_DOUBLED, 4: BLANES_MOAN_4, 6: BLANES_MOAN_6, 8: KAHAN_LI_8_DOUBLED},
}


def default_table(order: int, projected: bool) -> CompositionTable:
    """The table of the given order: for the projected step K~, or for the bare step K.

    Raises InputError if no table has that order.
    """
    available = DEFAULTS[bool(projected)]
    if isinstance(order, bool) or not isinstance(order, int) or order not in available:
        raise InputError(
            f"no composition table has order {order!r}; the orders are "
            f"{', '.join(map(str, available))}"
        )
    return available[order]
