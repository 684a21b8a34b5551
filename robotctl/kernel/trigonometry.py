"""Elementary functions with the same result, bit for bit, on every processor and C library.

They use only + - * / and `sqrt`, which IEEE 754 rounds exactly. Method and constants: fdlibm 5.3
(Sun Microsystems 1993), `k_sin.c`, `k_cos.c`, `e_rem_pio2.c`, `s_atan.c`, `e_exp.c`. Errors are at
most 1 ulp, those of `tan` and `hypot` 2 ulp.
"""

from __future__ import annotations

from math import copysign, inf, pi, sqrt, tau

_S1, _S2, _S3 = -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04
_S4, _S5, _S6 = 2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10
_C1, _C2, _C3 = 4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05
_C4, _C5, _C6 = -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11
_TWO_OVER_PI = 6.36619772367581382433e-01
_HALF_PI_HIGH, _HALF_PI_LOW = 1.57079632673412561417e00, 6.07710050650619224932e-11
"""The leading 33 bits of pi/2, and the rest of it."""

_PARTS_BELOW = (
    (6.07710050630396597660e-11, 2.02226624879595063154e-21),
    (2.02226624871116645580e-21, 8.47842766036889956997e-32),
)
"""The second 33 bits of pi/2 and the rest after them; the third 33 bits and their rest."""

_QUARTER_PI, _MANY_TURNS_RAD = 0.25 * pi, 2.0**19


def sin(angle_rad: float) -> float:
    """Return the sine; ValueError for an infinite angle."""
    return direction(angle_rad)[1]


def cos(angle_rad: float) -> float:
    """Return the cosine; ValueError for an infinite angle."""
    return direction(angle_rad)[0]


def direction(angle_rad: float) -> tuple[float, float]:
    """Return cosine and sine; ValueError for an infinite angle."""
    if -_QUARTER_PI <= angle_rad <= _QUARTER_PI:
        quadrant, x, tail = 0, angle_rad, 0.0
    else:
        quadrant, x, tail = _reduced(angle_rad)
    z = x * x
    w = z * z
    v = z * x
    half = 0.5 * z
    rest = 1.0 - half
    r = z * (_C1 + z * (_C2 + z * _C3)) + w * w * (_C4 + z * (_C5 + z * _C6))
    cosine = rest + (((1.0 - rest) - half) + (z * r - x * tail))
    r = _S2 + z * (_S3 + z * _S4) + z * w * (_S5 + z * _S6)
    sine = x - ((z * (0.5 * tail - v * r) - tail) - v * _S1)
    if quadrant & 1:
        cosine, sine = -sine, cosine
    return (-cosine, -sine) if quadrant & 2 else (cosine, sine)


def tan(angle_rad: float) -> float:
    """Return the tangent; ValueError for an infinite angle."""
    x, y = direction(angle_rad)
    return y / x


def _reduced(angle_rad: float) -> tuple[int, float, float]:
    """Return the number of quarter turns in an angle, and the rest as head plus tail [rad]."""
    if not -_MANY_TURNS_RAD <= angle_rad <= _MANY_TURNS_RAD:
        if angle_rad != angle_rad:
            return 0, angle_rad, 0.0
        if abs(angle_rad) == inf:
            raise ValueError("an infinite angle has no direction")
        angle_rad %= tau  # these whole turns are not counted
    quarters = round(angle_rad * _TWO_OVER_PI)
    rest, tail = angle_rad - quarters * _HALF_PI_HIGH, quarters * _HALF_PI_LOW
    head = rest - tail
    least = abs(angle_rad) * 2.0**-16
    if -least <= head <= least:  # almost a multiple of pi/2: its first bits cancel out
        for part, remainder in _PARTS_BELOW:
            before, lost = rest, quarters * part
            rest = before - lost
            tail = quarters * remainder - ((before - rest) - lost)
            head = rest - tail
            least *= 2.0**-33
            if abs(head) > least:
                break
    return quarters, head, (rest - head) - tail


_ATAN_PARTS = (
    (4.63647609000806093515e-01, 2.26987774529616870924e-17),
    (7.85398163397448278999e-01, 3.06161699786838301793e-17),
    (9.82793723247329054082e-01, 1.39033110312309984516e-17),
    (1.57079632679489655800e00, 6.12323399573676603587e-17),
)
"""The arc tangents of 0.5, 1, 1.5 and infinity, each with the part that rounding cut off."""

_A0, _A1, _A2 = 3.33333333333329318027e-01, -1.99999999998764832476e-01, 1.42857142725034663711e-01
_A3, _A4, _A5 = -1.11111104054623557880e-01, 9.09088713343650656196e-02, -7.69187620504482999495e-02
_A6, _A7, _A8 = 6.66107313738753120669e-02, -5.83357013379057348645e-02, 4.97687799461593236017e-02
_A9, _A10 = -3.65315727442169155270e-02, 1.62858201153657823623e-02
_PI_LOW = 1.22464679914735317720e-16
"""The part of pi that rounding cut off from `pi`."""


def atan2(y: float, x: float) -> float:
    """Return the direction of (x, y) [rad], as `math.atan2` does, also for zeros and infinities."""
    if x != x or y != y:
        return x + y
    if y == 0.0:
        return copysign(pi if copysign(1.0, x) < 0.0 else 0.0, y)
    if x == 0.0:
        return copysign(0.5 * pi, y)
    if abs(y) == inf and abs(x) == inf:
        return copysign(0.75 * pi if x < 0.0 else _QUARTER_PI, y)
    ratio = abs(y / x)
    if ratio > 2.0**60:
        return copysign(0.5 * pi, y)
    angle = _atan(ratio)
    if x < 0.0:
        angle = pi - (angle - _PI_LOW)
    return copysign(angle, y)


def _atan(x: float) -> float:
    """Return the arc tangent of x >= 0."""
    if x < 0.4375:
        if x < 2.0**-29:
            return x
        return x - x * _atan_series(x)
    if x < 0.6875:
        base, x = 0, (2.0 * x - 1.0) / (2.0 + x)
    elif x < 1.1875:
        base, x = 1, (x - 1.0) / (x + 1.0)
    elif x < 2.4375:
        base, x = 2, (x - 1.5) / (1.0 + 1.5 * x)
    else:
        base, x = 3, -1.0 / x
    high, low = _ATAN_PARTS[base]
    return high - ((x * _atan_series(x) - low) - x)


def _atan_series(x: float) -> float:
    z = x * x
    w = z * z
    odd = z * (_A0 + w * (_A2 + w * (_A4 + w * (_A6 + w * (_A8 + w * _A10)))))
    return odd + w * (_A1 + w * (_A3 + w * (_A5 + w * (_A7 + w * _A9))))


def hypot(x: float, y: float) -> float:
    """Return the length of (x, y)."""
    square = x * x + y * y
    if 1e-280 < square < 1e300:
        return sqrt(square)
    if abs(x) == inf or abs(y) == inf:
        return inf
    scale = 2.0**-600 if square > 1.0 else 2.0**600
    x, y = x * scale, y * scale
    return sqrt(x * x + y * y) / scale


_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_P1, _P2, _P3 = 1.66666666666666019037e-01, -2.77777777770155933842e-03, 6.61375632143793436117e-05
_P4, _P5 = -1.65339022054652515390e-06, 4.13813679705723846039e-08


def exp(x: float) -> float:
    """Return e to the power of x; ValueError outside -700 to 700."""
    if not -700.0 <= x <= 700.0:
        raise ValueError("the exponent must be between -700 and 700")
    doublings = round(x / (_LN2_HIGH + _LN2_LOW))
    high, low = x - doublings * _LN2_HIGH, doublings * _LN2_LOW
    x = high - low
    z = x * x
    c = x - z * (_P1 + z * (_P2 + z * (_P3 + z * (_P4 + z * _P5))))
    return (1.0 - ((low - (x * c) / (2.0 - c)) - high)) * 2.0**doublings
