"""An analytic foot trajectory: position, velocity and attitude in closed form at any time.

A walk is a row of footprints and the strides between them. In stance the foot is exactly still
and flat; a stride adds to the way between two footprints polynomial bumps for lift, sway, pitch
and roll, and a heel-strike transient, all with three vanishing derivatives at both ends. So
acceleration and jerk are continuous, and the foot comes to rest where the footprint says. A walk
is made of legs, each in one style: on a floor, running, or up and down stairs, whose footprints
are a riser apart. Which way of moving a stride is, is known (`solenav.modes.labels`).

Frames: navigation East-North-Up, body right-front-up (x right, y front of the foot, z up).
`yaw` is counter-clockwise about Up and 0 where the foot points North; `heading` (azimuth) is
clockwise from North, hence its negative. Positive pitch is toe-up. Metres, seconds, radians.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from solenav.errors import SolenavError
from solenav.modes.labels import Label
from solenav.recording import FloatArray

MAX_DURATION_S = 3600.0
MIN_DURATION_S = 2.0

STRIKE_S = 0.050
"""Support of the heel-strike transient; its main lobe takes 38 % of it, side lobes the rest."""
STRIKE_START = 0.83
"""Heel contact as a share of the stride's motion; afterwards the foot rolls down flat."""

TABLE_END_ENU = (-34.46, -6.08)
"""True end of the paper's walk in metres, as printed (35 m at 190 degrees, to a centimetre)."""
TABLE_DURATION_S = 130.0


@dataclass(frozen=True)
class Style:
    """How somebody walks; amplitudes are those of a full stride.

    `cycle_s` is the time from lift-off to lift-off and `motion_share` the part of it in which
    the foot is not flat and still; `strike` is the peak upward acceleration of the heel strike
    in m/s²; angles in radians. `rise_m` is how far a full stride climbs, `mode` what it is called.
    """

    stride_m: float
    cycle_s: float
    motion_share: float
    lift_m: float
    toe_down: float
    toe_up: float
    strike: float
    roll: float = math.radians(12)
    toe_out: float = math.radians(8)
    sway_m: float = 0.03
    variation: float = 0.04
    rise_m: float = 0.0
    mode: str = "walk"


BRISK = Style(1.2, 1.05, 0.61, 0.14, math.radians(58), math.radians(24), 40.0)
SLOW = Style(0.8, 1.8, 0.44, 0.12, math.radians(50), math.radians(20), 28.0)
HURRIED = Style(1.6, 0.92, 0.66, 0.16, math.radians(62), math.radians(28), 60.0)
RUN = Style(
    2.1, 0.72, 0.86, 0.26, math.radians(80), math.radians(16), 110.0, variation=0.05, mode="run"
)
RISER_M = 0.15
UPSTAIRS = Style(
    0.66, 1.0, 0.62, 0.13, math.radians(32), math.radians(6), 60.0, rise_m=2 * RISER_M,
    mode="upstairs",
)  # fmt: skip
DOWNSTAIRS = Style(
    0.68, 0.86, 0.62, 0.05, math.radians(36), math.radians(4), 80.0, rise_m=-2 * RISER_M,
    mode="downstairs",
)  # fmt: skip
"""Strides, times and risers of the stairs are those of gaitmap's recordings of one flight."""
FAST = Style(1.5, 0.88, 0.64, 0.16, math.radians(62), math.radians(26), 55.0)


@dataclass(frozen=True)
class Gait:
    """K strides between K + 1 footprints; every array but the footprints is (K,).

    `foot` (K + 1, 3) positions ENU in m, `yaw` (K + 1,) in rad, unwrapped; `lift_off` and
    `landing` in s bound the motion of each stride; the others are amplitudes as in `Style`.
    `modes` say how the foot moves when.
    """

    duration_s: float
    foot: FloatArray
    yaw: FloatArray
    lift_off: FloatArray
    landing: FloatArray
    lift_m: FloatArray
    toe_down: FloatArray
    toe_up: FloatArray
    strike: FloatArray
    roll: FloatArray
    toe_out: FloatArray
    sway_m: FloatArray
    modes: tuple[Label, ...] = ()

    @property
    def initial_heading_rad(self) -> float:
        """Azimuth of the foot's front at the start, clockwise from North, in [0, 2 pi)."""
        return float(-self.yaw[0] % (2 * math.pi))

    @property
    def closed_loop(self) -> bool:
        return bool(np.allclose(self.foot[0], self.foot[-1], rtol=0, atol=1e-9))


@dataclass(frozen=True)
class Motion:
    """State of the foot at m times.

    `position_enu` (m, 3) in m, `velocity_enu` (m, 3) in m/s, `attitude` (m, 4) quaternion body
    to navigation, scalar first, `stance` (m,) True where the foot is flat and still.
    """

    position_enu: FloatArray
    velocity_enu: FloatArray
    attitude: FloatArray
    stance: NDArray[np.bool_]


def motion(gait: Gait, time_s: FloatArray) -> Motion:
    """State of the foot at `time_s` (m,), in seconds from the start of the trajectory."""
    if not len(gait.lift_off):
        still = np.zeros((len(time_s), 3))
        return Motion(
            position_enu=still + gait.foot[0],
            velocity_enu=still,
            attitude=attitude(still[:, 0] + gait.yaw[0], still[:, 0], still[:, 0]),
            stance=np.ones(len(time_s), dtype=bool),
        )
    k = np.maximum(np.searchsorted(gait.lift_off, time_s, side="right") - 1, 0)
    span = (gait.landing - gait.lift_off)[k]
    u = np.clip((time_s - gait.lift_off[k]) / span, 0.0, 1.0)
    w = np.clip((time_s - gait.lift_off[k] - STRIKE_START * span) / STRIKE_S, 0.0, 1.0)

    way, way_du = progress(u)
    lift, lift_du = bump(u, 4, 6)
    toe, toe_du = bump(u, 13, 4)
    side, side_du = bump(u, 4, 4)
    hit, hit_dw = bump(w, 4, 4)

    chord = np.diff(gait.foot, axis=0)
    level = chord * [1.0, 1.0, 0.0]
    length = np.linalg.norm(level, axis=1, keepdims=True)
    front = level / np.where(length > 0, length, 1.0)
    right = np.stack([front[:, 1], -front[:, 0], 0 * front[:, 0]], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    # The heel pad gives way downward and forward and comes back: no net velocity or distance.
    # 32 is the curvature of bump(w, 4, 4) at its peak.
    pad = (gait.strike * STRIKE_S**2 / 32)[:, None] * (0.4 * front - up)
    sway = gait.sway_m[:, None] * right
    rise = gait.lift_m[:, None] * up
    # The instep goes up a second time where the toes are up and the heel comes down.
    heel = 0.2 * rise

    position = (
        gait.foot[k]
        + chord[k] * way[:, None]
        + rise[k] * lift[:, None]
        + heel[k] * toe[:, None]
        + sway[k] * side[:, None]
        + pad[k] * hit[:, None]
    )
    velocity = (
        chord[k] * way_du[:, None]
        + rise[k] * lift_du[:, None]
        + heel[k] * toe_du[:, None]
        + sway[k] * side_du[:, None]
    ) / span[:, None] + pad[k] * hit_dw[:, None] / STRIKE_S

    yaw = gait.yaw[k] + np.diff(gait.yaw)[k] * way - gait.toe_out[k] * side
    pitch = gait.toe_up[k] * toe - gait.toe_down[k] * bump(u, 4, 8)[0]
    return Motion(
        position_enu=position,
        velocity_enu=velocity,
        attitude=attitude(yaw, pitch, gait.roll[k] * side),
        stance=(u <= 0.0) | (u >= 1.0),
    )


def progress(u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """From 0 to 1 with three vanishing derivatives at both ends, and the derivative by u."""
    return (((-20 * u + 70) * u - 84) * u + 35) * u**4, 140 * (u * (1 - u)) ** 3


def bump(u: FloatArray, m: int, n: int) -> tuple[FloatArray, FloatArray]:
    """u^m (1 - u)^n scaled to a peak of 1, at u = m / (m + n), and its derivative by u."""
    scale = (m + n) ** (m + n) / (m**m * n**n)
    inner = scale * u ** (m - 1) * (1 - u) ** (n - 1)
    return inner * u * (1 - u), inner * (m * (1 - u) - n * u)


def attitude(yaw: FloatArray, pitch: FloatArray, roll: FloatArray) -> FloatArray:
    """Quaternions (m, 4) body to navigation: yaw about z, then pitch about x, then roll about y."""
    return multiply(multiply(_about(2, yaw), _about(0, pitch)), _about(1, roll))


def multiply(a: FloatArray, b: FloatArray) -> FloatArray:
    """Quaternion products a ⊗ b, both (m, 4), scalar first."""
    aw, ax, ay, az = a.T
    bw, bx, by, bz = b.T
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=1,
    )


def _about(axis: int, angle: FloatArray) -> FloatArray:
    q = np.zeros((len(angle), 4))
    q[:, 0] = np.cos(angle / 2)
    q[:, 1 + axis] = np.sin(angle / 2)
    return q


@dataclass(frozen=True)
class Path:
    """A line on the floor from the origin: straight pieces and arcs with a common tangent.

    `yaw` in rad is the direction at the start, `pieces` are (length in m, curvature in 1/m),
    positive curvature to the left.
    """

    yaw: float
    pieces: tuple[tuple[float, float], ...]

    @property
    def length(self) -> float:
        return sum(length for length, _ in self.pieces)

    def at(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Position (m, 2) East, North in m and yaw (m,) in rad, at the way `s` (m,) in m."""
        position = np.zeros((len(s), 2))
        yaw = np.full(len(s), self.yaw)
        start = 0.0
        for length, curvature in self.pieces:
            along = np.clip(s - start, 0.0, length)
            half_turn = curvature * along / 2
            chord = along * np.sinc(half_turn / np.pi)
            position += chord[:, None] * forward(yaw + half_turn)
            yaw += 2 * half_turn
            start += length
        return position, yaw


def forward(yaw: FloatArray) -> FloatArray:
    """Horizontal unit vectors (m, 2) East, North of a foot's front."""
    return np.stack([-np.sin(yaw), np.cos(yaw)], axis=1)


def rounded_rectangle(length: float, width: float, radius: float, yaw: float) -> Path:
    """Once around to the left, from the middle of a long side; sides are outer measures in m."""
    long, short = length - 2 * radius, width - 2 * radius
    corner = (math.pi / 2 * radius, 1 / radius)
    half_round = (corner, (short, 0.0), corner)
    return Path(yaw, ((long / 2, 0.0), *half_round, (long, 0.0), *half_round, (long / 2, 0.0)))


@dataclass(frozen=True)
class Leg:
    """A part of a course in one `style`, along `pieces` as in `Path`; then `rest_s` of standing."""

    style: Style
    pieces: tuple[tuple[float, float], ...]
    rest_s: float = 0.0

    @property
    def length(self) -> float:
        return sum(length for length, _ in self.pieces)


def walk(
    path: Path, style: Style, rng: np.random.Generator, before_s: float, duration_s: float
) -> Gait:
    """A walk along `path` in one style: see `course`."""
    return course(path.yaw, (Leg(style, path.pieces),), rng, before_s, duration_s)


def course(
    yaw: float,
    legs: tuple[Leg, ...],
    rng: np.random.Generator,
    before_s: float,
    duration_s: float | None = None,
) -> Gait:
    """Legs one after another from the origin, still for `before_s` before and until `duration_s`.

    The first and the last stride are half ones, as in a walk that begins and ends with the feet
    together. Variations are scaled so that each leg's sums, hence end point and duration, are
    exact; no stride on stairs varies in length, for the treads don't. `duration_s` None stands
    as long after the walk as before it.
    """
    path = Path(yaw, tuple(piece for leg in legs for piece in leg.pieces))
    ends = np.zeros(len(legs))
    ends[0] += 0.5
    ends[-1] += 0.5
    counts = [
        round(leg.length / leg.style.stride_m) + 1
        if len(legs) == 1
        else round(leg.length / leg.style.stride_m + end)
        for leg, end in zip(legs, ends, strict=True)
    ]
    walked = sum(n * leg.style.cycle_s + leg.rest_s for n, leg in zip(counts, legs, strict=True))
    if duration_s is None:
        duration_s = 2 * before_s + walked
    check_duration(duration_s, before_s + walked + MIN_DURATION_S)
    count = sum(counts)
    of_leg = np.repeat(np.arange(len(legs)), counts)

    def each(name: str) -> FloatArray:
        """What the style of each stride's leg says, (count,)."""
        return np.array([getattr(leg.style, name) for leg in legs])[of_leg]

    def vary() -> FloatArray:
        return 1 + each("variation") * np.clip(rng.standard_normal(count), -2, 2)

    share = np.ones(count)
    share[[0, -1]] = 0.5
    level = each("rise_m") == 0.0
    strides = share * np.where(level, vary(), 1.0)
    cycles = vary()
    rests = np.zeros(count)
    for i, leg in enumerate(legs):
        mine = of_leg == i
        strides[mine] *= leg.length / strides[mine].sum()
        cycles[mine] *= counts[i] * leg.style.cycle_s / cycles[mine].sum()
        rests[np.flatnonzero(mine)[-1]] = leg.rest_s
    lift_off = before_s + np.concatenate([[0.0], np.cumsum(cycles + rests)[:-1]])

    floor, yaws = path.at(np.concatenate([[0.0], np.cumsum(strides)]))
    between = np.ones(count + 1)
    between[[0, -1]] = 0.0
    floor += (between * rng.normal(0, 0.01, count + 1).clip(-0.02, 0.02))[:, None] * forward(
        yaws - math.pi / 2
    )
    yaws += between * rng.normal(0, math.radians(1.5), count + 1)
    height = np.concatenate([[0.0], np.cumsum(share * each("rise_m"))])

    size = (1 + share) / 2
    landing = lift_off + cycles * each("motion_share") * vary()
    return Gait(
        duration_s=duration_s,
        foot=np.column_stack([floor, height]),
        yaw=yaws,
        lift_off=lift_off,
        landing=landing,
        lift_m=each("lift_m") * size * vary(),
        toe_down=each("toe_down") * size * vary(),
        toe_up=each("toe_up") * size * vary(),
        # The impact scatters far more than the shape of a stride.
        strike=each("strike") * size * vary() ** 4,
        roll=each("roll") * size * vary(),
        toe_out=each("toe_out") * size * vary(),
        sway_m=each("sway_m") * size * vary(),
        modes=_modes(legs, of_leg, lift_off, landing, duration_s),
    )


def _modes(
    legs: tuple[Leg, ...],
    of_leg: NDArray[np.intp],
    lift_off: FloatArray,
    landing: FloatArray,
    duration_s: float,
) -> tuple[Label, ...]:
    """When the foot moves how: a leg from its first lift-off to its last landing, else still.

    Legs that follow on each other without a rest meet where the later lifts off.
    """
    found = [Label(0.0, float(lift_off[0]), "still")]
    for i, leg in enumerate(legs):
        mine = np.flatnonzero(of_leg == i)
        last = i == len(legs) - 1
        end = float(landing[mine[-1]] if leg.rest_s or last else lift_off[mine[-1] + 1])
        found.append(Label(float(lift_off[mine[0]]), end, leg.style.mode))
        until = duration_s if last else float(lift_off[mine[-1] + 1])
        if until > end:
            found.append(Label(end, until, "still"))
    return tuple(found)


def person(style: Style, rng: np.random.Generator) -> Style:
    """Somebody else's way of moving in that style: pace, lift, angles and impact differ."""

    def factor(spread: float) -> float:
        return float(np.exp(spread * np.clip(rng.standard_normal(), -2, 2)))

    # Treads are as deep and as high for everybody.
    stride = 1.0 if style.rise_m else factor(0.12)
    return replace(
        style,
        stride_m=style.stride_m * stride,
        cycle_s=style.cycle_s * factor(0.08),
        motion_share=style.motion_share * factor(0.04),
        lift_m=style.lift_m * factor(0.2),
        toe_down=style.toe_down * factor(0.15),
        toe_up=style.toe_up * factor(0.3),
        strike=style.strike * factor(0.4),
        roll=style.roll * factor(0.3),
    )


def line35(rng: np.random.Generator, duration_s: float | None = None) -> Gait:
    """The paper's experiment: 35 m straight at 190 degrees counter-clockwise from East, 130 s.

    The paper doesn't say how long the foot stood before and after; 30 s and 19 s leave 81 s of
    slow walking. A longer duration makes the standing at the end longer.
    """
    east, north = TABLE_END_ENU
    path = Path(math.atan2(-east, north), ((math.hypot(east, north), 0.0),))
    return walk(path, SLOW, rng, 30.0, TABLE_DURATION_S if duration_s is None else duration_s)


LAPS = 5


def laps(rng: np.random.Generator, duration_s: float | None = None) -> Gait:
    """Five times around the rectangle of `loop` (343 m in six minutes), without a rest."""
    once = rounded_rectangle(24.0, 12.0, 2.0, yaw=math.radians(-40))
    path = Path(once.yaw, LAPS * once.pieces)
    return walk(path, BRISK, rng, 15.0, 330.0 if duration_s is None else duration_s)


def loop(rng: np.random.Generator, duration_s: float | None = None) -> Gait:
    """Once around a rectangle of 24 m by 12 m with rounded corners (68.6 m), back to the start."""
    path = rounded_rectangle(24.0, 12.0, 2.0, yaw=math.radians(-40))
    return walk(path, BRISK, rng, 15.0, 85.0 if duration_s is None else duration_s)


def corridor(rng: np.random.Generator, duration_s: float | None = None) -> Gait:
    """Once around a corridor of 38 m by 60 m (193 m), back to the start, after a minute's rest."""
    path = rounded_rectangle(60.0, 38.0, 2.0, yaw=math.radians(-40))
    return walk(path, BRISK, rng, 60.0, 240.0 if duration_s is None else duration_s)


def corridor_fast(rng: np.random.Generator, duration_s: float | None = None) -> Gait:
    """The same corridor at 1.7 m/s, where `corridor` is walked at 1.1 m/s."""
    path = rounded_rectangle(60.0, 38.0, 2.0, yaw=math.radians(-40))
    return walk(path, FAST, rng, 60.0, 185.0 if duration_s is None else duration_s)


def stand(rng: np.random.Generator, duration_s: float | None = None) -> Gait:
    """The foot stands still, pointing North."""
    duration = 60.0 if duration_s is None else duration_s
    check_duration(duration, MIN_DURATION_S)
    none = np.empty(0)
    return Gait(
        duration_s=duration,
        foot=np.zeros((1, 3)),
        yaw=np.zeros(1),
        lift_off=none,
        landing=none,
        lift_m=none,
        toe_down=none,
        toe_up=none,
        strike=none,
        roll=none,
        toe_out=none,
        sway_m=none,
        modes=(Label(0.0, duration, "still"),),
    )


FLIGHT = 14
"""Risers of a flight of stairs."""
_TURN = ((math.pi / 2 * 1.2, 1 / 1.2),) * 2
"""A half turn to the left."""


def run(rng: np.random.Generator, duration_s: float | None = None) -> Gait:
    """Twice around a rectangle of 30 m by 15 m, running: 170 m."""
    once = rounded_rectangle(30.0, 15.0, 4.0, yaw=math.radians(25))
    return course(once.yaw, (Leg(person(RUN, rng), 2 * once.pieces),), rng, 15.0, duration_s)


def stairs(rng: np.random.Generator, duration_s: float | None = None) -> Gait:
    """Two flights up with a landing between them, a turn, and the same way back down."""
    on_floor = person(BRISK, rng)
    up, down = (_flights(person(style, rng), on_floor) for style in (UPSTAIRS, DOWNSTAIRS))
    level = Leg(on_floor, ((5.0, 0.0),))
    around = Leg(on_floor, ((2.0, 0.0), *_TURN, (2.0, 0.0)))
    return course(0.0, (level, *up, around, *down, level), rng, 15.0, duration_s)


def modes(rng: np.random.Generator, duration_s: float | None = None) -> Gait:
    """Walking at three paces, running, two flights up, two flights down, rests between."""
    slow, brisk, fast, running = (person(style, rng) for style in (SLOW, BRISK, HURRIED, RUN))
    up, down = (_flights(person(style, rng), brisk) for style in (UPSTAIRS, DOWNSTAIRS))
    half_round = (*_TURN, (12.0, 0.0))
    legs = (
        Leg(slow, ((10.0, 0.0),), rest_s=4.0),
        Leg(brisk, ((15.0, 0.0), *half_round)),
        Leg(running, ((20.0, 0.0), (math.pi * 6.0, 1 / 6.0), (20.0, 0.0))),
        Leg(brisk, ((12.0, 0.0),), rest_s=3.0),
        Leg(fast, ((24.0, 0.0),)),
        Leg(brisk, ((4.0, 0.0),)),
        *up,
        Leg(brisk, half_round, rest_s=3.0),
        Leg(brisk, ((5.0, 0.0),)),
        *down,
        Leg(slow, ((8.0, 0.0),)),
    )
    return course(math.radians(60), legs, rng, 10.0, duration_s)


def _flights(on_stairs: Style, on_floor: Style) -> tuple[Leg, Leg, Leg]:
    """Two flights and the landing between them."""
    flight = Leg(on_stairs, ((FLIGHT / 2 * on_stairs.stride_m, 0.0),))
    return flight, Leg(on_floor, ((1.5, 0.0),)), flight


def check_duration(duration_s: float, shortest_s: float) -> None:
    if not shortest_s <= duration_s <= MAX_DURATION_S:
        raise SolenavError(
            f"the duration {duration_s:g} s is out of range for this scenario",
            f"choose from {shortest_s:.1f} to {MAX_DURATION_S:.0f} s, or leave it out",
        )


SCENARIOS: dict[str, Callable[[np.random.Generator, float | None], Gait]] = {
    "line35": line35,
    "loop": loop,
    "laps": laps,
    "corridor": corridor,
    "corridor-fast": corridor_fast,
    "stand": stand,
    "run": run,
    "stairs": stairs,
    "modes": modes,
}
