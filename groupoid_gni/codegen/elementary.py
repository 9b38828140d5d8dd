"""Sine and cosine as LLVM IR: one polynomial for every number of lanes.

Reduction ``x = k pi/2 + r`` with pi/2 in three parts and fused products, then the minimax
polynomials of Sun's fdlibm on |r| <= pi/4. Maximal error 1.4 ulp for |x| <= 1e6 (measured); beyond
that, and for infinities and NaN, the C library is called lane by lane.
"""

from __future__ import annotations

from groupoid_gni.codegen.emitter import Emitter

_PI_HALF = (1.5707963267948966, 6.123233995736766e-17, -1.4973849048591833e-33)
_TWO_OVER_PI = 0.6366197723675814
_LARGEST = 1e6
_SINE = (
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
_COSINE = (
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)


def sine_cosine_function(lanes: int, fused: bool) -> tuple[list[str], set[str]]:
    """IR text of ``@gni_sincos`` and the declarations it needs."""
    e = Emitter(lanes, fused)
    pair = f"{{ {e.type}, {e.type} }}"
    lines = [f"define internal fastcc {pair} @gni_sincos({e.type} %x) alwaysinline {{", "entry:"]
    if fused:
        small = e.compare("ole", e.intrinsic("fabs", "%x"), e.constant(_LARGEST))
        near = _polynomials(e)
        e.line(f"br i1 {_all(e, small)}, label %near, label %far")
        e.label("near")
        _return(e, pair, *near)
        e.label("far")
        # lanes that are not far keep their polynomial: a neighbour must not change their bits
        far = (e.library("sin", "%x"), e.library("cos", "%x"))
        _return(e, pair, *[e.select(small, n, f) for n, f in zip(near, far, strict=True)])
    else:
        # three-part reduction needs single-rounding products: without them the library is safer
        _return(e, pair, e.library("sin", "%x"), e.library("cos", "%x"))
    return [*lines, *e.lines, "}"], e.declarations


def _all(e: Emitter, flag: str) -> str:
    if e.lanes == 1:
        return flag
    bits = e.assign(f"bitcast {e.flag_type} {flag} to i{e.lanes}")
    return e.assign(f"icmp eq i{e.lanes} {bits}, -1")


def _return(e: Emitter, pair: str, sine: str, cosine: str) -> None:
    first = e.assign(f"insertvalue {pair} undef, {e.type} {sine}, 0")
    both = e.assign(f"insertvalue {pair} {first}, {e.type} {cosine}, 1")
    e.line(f"ret {pair} {both}")


def _horner(e: Emitter, z: str, coefficients: tuple[float, ...]) -> str:
    value = e.constant(coefficients[-1])
    for c in reversed(coefficients[:-1]):
        value = e.multiply_add(value, z, e.constant(c))
    return value


def _polynomials(e: Emitter) -> tuple[str, str]:
    k = e.intrinsic("rint", e.binary("fmul", "%x", e.constant(_TWO_OVER_PI)))
    minus_k = e.negate(k)
    r = "%x"
    for part in _PI_HALF:
        r = e.multiply_add(minus_k, e.constant(part), r)
    z = e.binary("fmul", r, r)
    sine = e.multiply_add(e.binary("fmul", r, z), _horner(e, z, _SINE), r)
    half = e.binary("fmul", z, e.constant(0.5))
    one = e.constant(1.0)
    head = e.binary("fsub", one, half)
    tail = e.binary("fsub", e.binary("fsub", one, head), half)
    square = e.binary("fmul", z, z)
    cosine = e.binary("fadd", head, e.multiply_add(square, _horner(e, z, _COSINE), tail))
    return _into_quadrant(e, k, sine, cosine)


def _into_quadrant(e: Emitter, k: str, sine: str, cosine: str) -> tuple[str, str]:
    integer = "i64" if e.lanes == 1 else f"<{e.lanes} x i64>"

    def splat(value: int) -> str:
        return str(value) if e.lanes == 1 else "<" + ", ".join([f"i64 {value}"] * e.lanes) + ">"

    quadrant = e.assign(f"fptosi {e.type} {k} to {integer}")

    def bit_is_set(value: str, bit: int) -> str:
        masked = e.assign(f"and {integer} {value}, {splat(bit)}")
        return e.assign(f"icmp ne {integer} {masked}, {splat(0)}")

    swap = bit_is_set(quadrant, 1)
    s = e.select(swap, cosine, sine)
    c = e.select(swap, sine, cosine)
    s = e.select(bit_is_set(quadrant, 2), e.negate(s), s)
    shifted = e.assign(f"add {integer} {quadrant}, {splat(1)}")
    c = e.select(bit_is_set(shifted, 2), e.negate(c), c)
    return s, c
