"""Fixed-point primitives. Every intermediate fits a signed 32-bit word.

Q-format: a value x is held as the integer x * 2**q. Sources: the multiply splits each factor
into signed 16-bit halves, so that no partial product passes 2**30; the division is long
division, the root Newton's, the arctangent CORDIC (Volder 1959).
"""

from solenav_core.compat import const, micropython, ptr32

_T_ATAN = const(257)


@micropython.viper
def mulshift(a: int, b: int, n: int) -> int:
    """a * b / 2**n, rounded to nearest (halves up), for 17 <= n <= 46.

    |a| and |b| must stay below 2**31 - 2**16 and the result must fit a word.
    """
    al = ((a + 32768) & 65535) - 32768
    ah = (a - al) >> 16
    bl = ((b + 32768) & 65535) - 32768
    bh = (b - bl) >> 16
    mid = ah * bl + al * bh
    low = (mid & 65535) + ((al * bl) >> 16)
    high = ah * bh + (mid >> 16) + (low >> 16)
    low = low & 65535
    # The product is high * 2**32 + low * 2**16 + (16 bits that no n >= 17 can see).
    k = n - 16
    if k <= 16:
        return (high << (16 - k)) + ((low + (1 << (k - 1))) >> k)
    return (high + (1 << (k - 17))) >> (k - 16)


@micropython.viper
def mulsat(a: int, b: int, n: int) -> int:
    """`mulshift`, limited to +-(2**30 - 1), for 17 <= n <= 38.

    a * b / 2**(n + 8) must still fit a word.
    """
    rough = int(mulshift(a, b, n + 8))
    if rough >= 0x3FFFFF:
        return 0x3FFFFFFF
    if rough <= -0x3FFFFF:
        return -0x3FFFFFFF
    return int(mulshift(a, b, n))


@micropython.viper
def div(num: int, den: int, n: int) -> int:
    """num * 2**n / den, truncated towards zero, for 0 <= n <= 30 and den > 0.

    |num| and the quotient must stay below 2**31; den <= 0 gives 0 (the callers' variances are
    never negative).
    """
    if den <= 0:
        return 0
    negative = int(num < 0)
    if negative:
        num = 0 - num
    if den >= 0x3FFFFFFF:
        # The remainder doubles below; a divisor of 31 bits loses its last one.
        den = den >> 1
        num = num >> 1
    q = num // den
    r = num - q * den
    bits = n & 7
    while n > 0:
        if den < 0x800000:
            r = r << bits
            digit = r // den
            r = r - digit * den
        else:
            # The remainder has no room for them: a digit from the divisor's upper part, which
            # is at most one too large.
            upper = den >> bits
            digit = r // upper  # > 0: den is 2**23 at least
            r = ((r - digit * upper) << bits) - digit * (den - (upper << bits))
            if r < 0:
                r = r + den
                digit = digit - 1
        q = (q << bits) + digit
        n = n - bits
        bits = 8
    if negative:
        return 0 - q
    return q


@micropython.viper
def isqrt(x: int) -> int:
    """The integer square root of 0 <= x < 2**31, rounded down."""
    if x < 1:
        return 0
    top = x
    shift = 16
    if top >= 0x100000:
        top = top >> 10
        shift = 11
    if top >= 0x10000:
        top = top >> 6
        shift = shift - 3
    if top >= 0x4000:
        top = top >> 4
        shift = shift - 2
    if top >= 0x1000:
        top = top >> 2
        shift = shift - 1
    # A parabola, good to 0.6 % between 1024 and 4096; after a step of Newton never below the root.
    root = (top * (1077 - ((top * 81) >> 10)) + 1087456) >> shift
    root = (root + x // root) >> 1  # > 0: 16 at least
    # The largest root there is: so the square below fits a word.
    if root > 46340:
        root = 46340
    while root * root > x:
        root = (root + x // root) >> 1  # > 0: the root of x or above
    return root


@micropython.viper
def clamp(x: int, limit: int) -> int:
    """x limited to -limit..limit."""
    if x > limit:
        return limit
    if x < 0 - limit:
        return 0 - limit
    return x


@micropython.viper
def azimuth(east: int, north: int, t: ptr32) -> int:
    """The angle of (east, north) clockwise from North, 2**16 a turn, -32768..32767.

    |east| and |north| must stay below 2**29; (0, 0) gives 0. CORDIC, 16 turns, good to about
    one part in 2**16 of a turn for vectors longer than 2**16.
    """
    angle = 0
    x = north
    y = east
    if x < 0:
        x = 0 - x
        y = 0 - y
        angle = 8388608
    i = 0
    while i < 16:
        step = t[_T_ATAN + i]
        dx = y >> i
        dy = x >> i
        if y > 0:
            x = x + dx
            y = y - dy
            angle = angle + step
        elif y < 0:
            x = x - dx
            y = y + dy
            angle = angle - step
        i = i + 1
    angle = (angle + 128) >> 8
    return ((angle + 32768) & 65535) - 32768
