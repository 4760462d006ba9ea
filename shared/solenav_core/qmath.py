"""Fixed-point primitives. Every intermediate fits a signed 32-bit word.

Q-format: a value x is held as the integer x * 2**q. Sources: the multiply splits each factor
into signed 16-bit halves, so that no partial product passes 2**30; the division is long
division; root and arctangent are the digit-by-digit method and CORDIC (Volder 1959).
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
    if den < 0x800000:
        while n >= 8:
            r = r << 8
            digit = r // den
            q = (q << 8) + digit
            r = r - digit * den
            n = n - 8
        q = (q << n) + (r << n) // den
    else:
        while n > 0:
            r = r << 1
            q = q << 1
            if r >= den:
                r = r - den
                q = q + 1
            n = n - 1
    if negative:
        return 0 - q
    return q


@micropython.viper
def isqrt(x: int) -> int:
    """The integer square root of 0 <= x < 2**31, rounded down."""
    root = 0
    rem = 0
    shift = 30
    while shift > 0 and x >> shift == 0:
        shift = shift - 2
    while shift >= 0:
        rem = (rem << 2) + ((x >> shift) & 3)
        trial = (root << 2) + 1
        root = root << 1
        if rem >= trial:
            rem = rem - trial
            root = root + 1
        shift = shift - 2
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
