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
SOFRONIOU_SPALETTA_2005 = "M. Sofroniou and G. Spaletta 2005, Optim. Methods Softw. 20, 597-613"
BLANES_MOAN_2002 = "S. Blanes and P. C. Moan 2002, J. Comput. Appl. Math. 142, 313-330"
OPTIMISED = (
    "found for this library: fewest stages to a given error, over the solutions of the order "
    "conditions, on an ensemble of nonholonomic particles in R^3, R^4 and R^5"
)

# Of each order at most two, the default first: the one that reached a given error soonest, by the
# clock, on six scenes of the library. Polished by Newton's method on the order conditions, in 50
# decimals.

BASIC = CompositionTable("one step", 2, (1.0,), "the projected step itself", projected=True)
# 1 / (4 - 4^(1/3)), twice on either side; equal stages are the easiest to start an iteration for.
SUZUKI_4 = CompositionTable(
    name="Suzuki",
    order=4,
    stages=palindrome((0.41449077179437573714, 0.41449077179437573714, -0.65796308717750294857), 5),
    source="M. Suzuki 1990, Phys. Lett. A 146, 319-323",
    projected=True,
)
# 10 to 12 % fewer stages than Suzuki's, which pays with an explicit flight; an implicit one takes
# more iterations for stages of unequal size.
SEVEN_STAGES_4 = CompositionTable(
    name="optimised s7",
    order=4,
    stages=palindrome(
        (
            0.19455440409612398482,
            0.24972675563903787986,
            0.27935403974708981274,
            -0.44727039896450335484,
        ),
        7,
    ),
    source=OPTIMISED,
    projected=True,
)
# 26 to 35 % less time than Kahan-Li s9odr6a.
SOFRONIOU_SPALETTA_6 = CompositionTable(
    name="Sofroniou-Spaletta s13",
    order=6,
    stages=palindrome(
        (
            0.13861930854051695246,
            0.13346562851074760407,
            0.13070531011449225191,
            0.12961893756907034773,
            -0.35000324893920896516,
            0.1180553065300238717,
            0.3990775153487158746,
        ),
        13,
    ),
    source=f"{SOFRONIOU_SPALETTA_2005}, order 6 with 13 stages",
    projected=True,
)
# Few stages, for steps that are bounded by something else than the error.
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
# 16 to 24 % less time than Kahan-Li s17odr8a.
SOFRONIOU_SPALETTA_8 = CompositionTable(
    name="Sofroniou-Spaletta s21",
    order=8,
    stages=palindrome(
        (
            0.10647728984550031824,
            0.10837408645835726397,
            0.3533782105265434242,
            -0.23341414023165082199,
            -0.24445266791528841269,
            0.11317848435755633315,
            0.11892905625000350063,
            0.1260391232182598814,
            0.12581718736176041804,
            0.11699135019217642181,
            -0.38263596012643665351,
        ),
        21,
    ),
    source=f"{SOFRONIOU_SPALETTA_2005}, order 8 with 21 stages",
    projected=True,
)
# 3 to 10 % more time on the scenes, 15 % fewer stages on the ensemble of particles, which are more
# strongly coupled.
TWENTY_ONE_STAGES_8 = CompositionTable(
    name="optimised s21",
    order=8,
    stages=palindrome(
        (
            0.0859680418901260082,
            0.14770143366116550345,
            -0.19253973212964136225,
            0.12375093521287780264,
            0.10412124921715947803,
            0.10762701782023110512,
            0.4001931485888476283,
            -0.30968855273299047167,
            0.094771123172855755082,
            0.15323543846367853043,
            -0.43028020632861995467,
        ),
        21,
    ),
    source=OPTIMISED,
    projected=True,
)

BASIC_DOUBLED = doubled(BASIC)
# 7 to 10 % less time than Blanes-Moan S6.
FOURTEEN_STAGES_4 = CompositionTable(
    name="optimised s14",
    order=4,
    stages=palindrome(
        (
            0.069708950184057200837,
            0.10323641681404291437,
            0.21398867063367913632,
            -0.27102252991831877421,
            0.18753730339971009641,
            0.081016782476121439844,
            0.11553440641070798642,
        ),
        14,
    ),
    source=OPTIMISED,
    projected=False,
)
# From a = 0.0792036964311957, 0.353172906049774, -0.0420650803577195, ... and
# b = 0.209515106613362, -0.143851773179818, ...; fewer stages where a few steps are enough.
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
    source=f"{BLANES_MOAN_2002}, S6 of order 4",
    projected=False,
)
# From a = 0.0502627644003922, 0.413514300428344, 0.0450798897943977, -0.188054853819569,
# 0.541960678450780, ... and b = 0.148816447901042, -0.132385865767784, 0.067307604692185,
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
    source=f"{BLANES_MOAN_2002}, S10 of order 6",
    projected=False,
)
# A method and its adjoint need at least 54 stages for order 8 (27 conditions on a palindrome).
TWENTY_ONE_STAGES_8_DOUBLED = doubled(TWENTY_ONE_STAGES_8)

PROJECTED_TABLES = (
    BASIC,
    SUZUKI_4,
    SEVEN_STAGES_4,
    SOFRONIOU_SPALETTA_6,
    KAHAN_LI_6,
    SOFRONIOU_SPALETTA_8,
    TWENTY_ONE_STAGES_8,
)
BARE_TABLES = (
    BASIC_DOUBLED,
    FOURTEEN_STAGES_4,
    BLANES_MOAN_4,
    BLANES_MOAN_6,
    TWENTY_ONE_STAGES_8_DOUBLED,
)
PROJECTED_DEFAULTS = {
    2: BASIC,
    4: SUZUKI_4,
    6: SOFRONIOU_SPALETTA_6,
    8: SOFRONIOU_SPALETTA_8,
}
BARE_DEFAULTS = {
    2: BASIC_DOUBLED,
    4: FOURTEEN_STAGES_4,
    6: BLANES_MOAN_6,
    8: TWENTY_ONE_STAGES_8_DOUBLED,
}


def default_table(order: int, projected: bool) -> CompositionTable:
    """The table of the given order: for the projected step K~, or for the bare step K.

    Raises InputError if no table has that order.
    """
    available = PROJECTED_DEFAULTS if projected else BARE_DEFAULTS
    if isinstance(order, bool) or not isinstance(order, int) or order not in available:
        raise InputError(
            f"no composition table has order {order!r}; the orders are "
            f"{', '.join(map(str, available))}"
        )
    return available[order]
