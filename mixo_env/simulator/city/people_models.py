"""How people look: bodies of flat bars whose legs and arms swing, one mesh a pose.

Lengths of limbs are shares of the body height (Drillis and Contini 1966, as in Winter, "Biomechanics and motor control
of human movement"). The angles of hip and knee over a walking cycle follow the usual curves of level walking (Perry and
Burnfield, "Gait analysis", 2010): hip from 30 degrees flexed to 10 extended, knee 15 degrees bent under load and 60 in
the swing; arms swing against the legs. Whoever cycles turns the pedals; the knee follows from both ends of the leg.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from mixo_env.simulator.city.mesh import (
    CUT_OUT,
    SHADE,
    TWO_SIDED,
    Mesh,
    Patch,
    Surface,
    Vector,
    mesh_of,
    quad,
)
from mixo_env.simulator.city.people import LOOKS, PHASES
from mixo_env.simulator.city.textures import Atlas, Bytes, plain, rgba

_TAU = 2.0 * math.pi
_SKINS = ((0.75, 0.52, 0.40), (0.55, 0.36, 0.25), (0.30, 0.18, 0.12), (0.80, 0.60, 0.48))
_HAIRS = ((0.02, 0.02, 0.02), (0.09, 0.05, 0.03), (0.22, 0.15, 0.07), (0.30, 0.30, 0.30))
_CLOTHES = (
    (0.05, 0.06, 0.09),
    (0.35, 0.06, 0.06),
    (0.70, 0.70, 0.68),
    (0.10, 0.16, 0.35),
    (0.12, 0.12, 0.12),
    (0.50, 0.38, 0.18),
    (0.10, 0.25, 0.14),
    (0.75, 0.55, 0.10),
)
_WHEEL_M, _AXLE_M = 0.34, 0.52  # of the bicycle: radius, and distance of both axles from its middle
_CRANK_M = 0.17
_CRANK_AT = (-0.06, 0.30)
_HIP_AT, _HAND_AT = (-0.24, 0.98), (0.40, 1.03)
_LEAN_RAD = math.radians(35.0)  # of the rider's back


class _Clothes(NamedTuple):
    """Surfaces of one person, and the height in metres."""

    skin: Surface
    hair: Surface
    top: Surface
    legs: Surface
    shoes: Surface
    height_m: float


def _bar(
    surface: Surface, a: tuple[float, float], b: tuple[float, float], y: float, size: tuple[float, float]
) -> list[Patch]:
    """A bar from ``a`` to ``b`` (x, z) at ``y``, ``size`` thick (in its plane) and wide (across it), with both ends."""
    (ax, az), (bx, bz) = a, b
    along = np.array([bx - ax, 0.0, bz - az])
    length = float(np.linalg.norm(along))
    along /= length
    front, side = np.array([-along[2], 0.0, along[0]]), np.array([0.0, 1.0, 0.0])
    thick, wide = size
    patches = []

    def face(origin: np.ndarray, u: np.ndarray, v: np.ndarray) -> None:
        patches.append(quad(surface, _vector(origin), _vector(u), _vector(v), (40.0 * ax % 64.0, 40.0 * az % 64.0)))

    start, middle = np.array([ax, y, az]), np.array([0.5 * (ax + bx), y, 0.5 * (az + bz)])
    for out, half, across in ((front, thick, wide), (-front, thick, wide), (side, wide, thick), (-side, wide, thick)):
        u = np.cross(out, along) * across
        face(start + 0.5 * half * out - 0.5 * u, u, along * length)
    for out in (along, -along):
        u, v = side * wide, np.cross(side, out) * thick
        face(middle + 0.5 * length * out - 0.5 * u - 0.5 * v, u, v)
    return patches


def _vector(values: np.ndarray) -> Vector:
    x, y, z = values.tolist()
    return x, y, z


def leg_angles(phase: float) -> tuple[float, float]:
    """Flexion of hip and knee [rad] at a share of the walking cycle, which begins as the heel touches the ground."""
    phase %= 1.0
    hip = math.radians(10.0) + math.radians(20.0) * math.cos(_TAU * phase)
    bumps = ((15.0, 0.15, 0.07), (57.0, 0.73, 0.10), (57.0, -0.27, 0.10))
    knee = 4.0 + sum(high * math.exp(-(((phase - at) / wide) ** 2)) for high, at, wide in bumps)
    return hip, math.radians(knee)


def _hanging(at: tuple[float, float], angle: float, length: float) -> tuple[float, float]:
    """The end of a limb that hangs from ``at``, turned forward by ``angle``."""
    return at[0] + length * math.sin(angle), at[1] - length * math.cos(angle)


def _walker(look: _Clothes, phase: float | None) -> list[Patch]:
    """A walking person at a share of the cycle, or one who stands."""
    h = look.height_m
    angles = [(0.0, 0.02), (0.0, 0.02)] if phase is None else [leg_angles(phase), leg_angles(phase + 0.5)]
    swings = [-0.4 * math.cos(_TAU * (phase + part)) if phase is not None else 0.05 for part in (0.0, 0.5)]
    # The hips are as high as the leg on the ground lets them be.
    legs = []
    for hip, knee in angles:
        knee_at = _hanging((0.0, 0.0), hip, 0.245 * h)
        legs.append((knee_at, _hanging(knee_at, hip - knee, 0.246 * h)))
    hips = 0.039 * h - min(ankle[1] for _, ankle in legs)
    patches: list[Patch] = []
    for y, (knee, ankle) in zip((0.095 * 0.6 * h, -0.095 * 0.6 * h), legs, strict=True):
        knee, ankle = (knee[0], knee[1] + hips), (ankle[0], ankle[1] + hips)
        patches += _bar(look.legs, (0.0, hips), knee, y, (0.085 * h, 0.085 * h))
        patches += _bar(look.legs, knee, ankle, y, (0.065 * h, 0.065 * h))
        heel = (ankle[0] - 0.03 * h, ankle[1] - 0.02 * h)
        patches += _bar(look.shoes, heel, (heel[0] + 0.15 * h, max(heel[1], 0.02 * h)), y, (0.04 * h, 0.055 * h))
    shoulder = (0.02 * h, hips + 0.288 * h)
    patches += _trunk(look, (0.0, hips - 0.02 * h), shoulder)
    for y, swing in zip((0.135 * h, -0.135 * h), swings, strict=True):
        elbow = _hanging(shoulder, swing, 0.186 * h)
        hand = _hanging(elbow, swing + 0.35, 0.2 * h)
        patches += _bar(look.top, shoulder, elbow, y, (0.06 * h, 0.06 * h))
        patches += _bar(look.top, elbow, hand, y, (0.05 * h, 0.05 * h))
    return patches


def _trunk(look: _Clothes, hips: tuple[float, float], shoulder: tuple[float, float]) -> list[Patch]:
    """Trunk, neck and head above the hips."""
    h = look.height_m
    neck = (shoulder[0] + 0.01 * h, shoulder[1] + 0.045 * h)
    chin, crown = (neck[0] + 0.01 * h, neck[1] + 0.005 * h), (neck[0] + 0.01 * h, neck[1] + 0.09 * h)
    return [
        *_bar(look.top, shoulder, hips, 0.0, (0.13 * h, 0.22 * h)),
        *_bar(look.skin, neck, (shoulder[0], shoulder[1] - 0.01 * h), 0.0, (0.06 * h, 0.06 * h)),
        *_bar(look.skin, crown, chin, 0.0, (0.105 * h, 0.085 * h)),
        *_bar(look.hair, (crown[0] - 0.01 * h, crown[1] + 0.035 * h), crown, 0.0, (0.12 * h, 0.095 * h)),
    ]


def _knee(hip: tuple[float, float], foot: tuple[float, float], thigh: float, shank: float) -> tuple[float, float]:
    """Where the knee is, forward of the line from hip to foot."""
    dx, dz = foot[0] - hip[0], foot[1] - hip[1]
    far = min(math.hypot(dx, dz), 0.999 * (thigh + shank))
    along = (far * far + thigh * thigh - shank * shank) / (2.0 * far)
    aside = math.sqrt(max(thigh * thigh - along * along, 0.0))
    ux, uz = dx / far, dz / far
    return hip[0] + along * ux - aside * uz, hip[1] + along * uz + aside * ux


def _cyclist(look: _Clothes, bicycle: Surface, phase: float) -> list[Patch]:
    """A person on a bicycle at a share of a turn of the pedals."""
    h = look.height_m
    high = 1.05
    side = (bicycle, (_AXLE_M + _WHEEL_M, 0.0, high), (-2.0 * (_AXLE_M + _WHEEL_M), 0.0, 0.0), (0.0, 0.0, -high))
    patches = [quad(*side)]
    for x in (-_AXLE_M, _AXLE_M):  # tyres as they are seen from ahead and from behind
        tyre = ((0.0, 0.04, 0.0), (0.0, 0.0, -2.0 * _WHEEL_M))
        patches.append(quad(replace(look.shoes, shape=TWO_SIDED), (x, -0.02, 2.0 * _WHEEL_M), *tyre))
    patches += _bar(
        look.shoes,
        (_HAND_AT[0] - 0.02, _HAND_AT[1] - 0.02),
        (_HAND_AT[0] + 0.02, _HAND_AT[1] - 0.02),
        0.0,
        (0.03, 0.56),
    )
    shoulder = (_HIP_AT[0] + 0.288 * h * math.sin(_LEAN_RAD), _HIP_AT[1] + 0.288 * h * math.cos(_LEAN_RAD))
    patches += _trunk(look, _HIP_AT, shoulder)
    for number, y in enumerate((0.1, -0.1)):
        turn = _TAU * (phase + 0.5 * number)  # clockwise as seen from the right, so that the bicycle rolls forward
        foot = (_CRANK_AT[0] + _CRANK_M * math.sin(turn), _CRANK_AT[1] + _CRANK_M * math.cos(turn))
        knee = _knee(_HIP_AT, (foot[0] - 0.04, foot[1] + 0.06), 0.245 * h, 0.246 * h)
        patches += _bar(look.legs, _HIP_AT, knee, y, (0.085 * h, 0.08 * h))
        patches += _bar(look.legs, knee, (foot[0] - 0.04, foot[1] + 0.06), y, (0.06 * h, 0.06 * h))
        patches += _bar(look.shoes, (foot[0] - 0.1, foot[1] + 0.03), (foot[0] + 0.13, foot[1] + 0.02), y, (0.06, 0.09))
        elbow = _knee(_HAND_AT, shoulder, 0.2 * h, 0.186 * h)
        arm = 2.2 * y
        patches += _bar(look.top, shoulder, elbow, arm, (0.055 * h, 0.055 * h))
        patches += _bar(look.top, elbow, _HAND_AT, arm, (0.045 * h, 0.045 * h))
    return patches


def _bicycle() -> Bytes:
    """Picture of a bicycle's side, front to the left; 256 x 128 over both wheels and the handlebar's height."""
    high, wide = 128, 256
    per_x, per_z = wide / (2.0 * (_AXLE_M + _WHEEL_M)), high / 1.05
    covered = np.zeros((high, wide), np.uint8)

    def at(x: float, z: float) -> tuple[int, int]:
        return int((_AXLE_M + _WHEEL_M - x) * per_x), int((1.05 - z) * per_z)

    def line(*points: tuple[float, float], thick: int = 5) -> None:
        for a, b in itertools.pairwise(points):
            cv2.line(covered, at(*a), at(*b), 255, thick)

    for x in (-_AXLE_M, _AXLE_M):
        axes = (int((_WHEEL_M - 0.02) * per_x), int((_WHEEL_M - 0.02) * per_z))
        cv2.ellipse(covered, at(x, _WHEEL_M), axes, 0, 0, 360, 255, 6)
        for turn in np.arange(8) * _TAU / 8.0:
            line((x, _WHEEL_M), (x + 0.32 * math.cos(turn), _WHEEL_M + 0.32 * math.sin(turn)), thick=1)
    seat, head = (-0.2, 0.85), (0.36, 0.85)
    line((-_AXLE_M, _WHEEL_M), _CRANK_AT, seat, head, _CRANK_AT)
    line((-_AXLE_M, _WHEEL_M), seat, (-0.22, 0.95))
    line((_AXLE_M, _WHEEL_M), head, (0.36, 1.02), (0.42, 1.02))
    line((-0.34, 0.95), (-0.1, 0.95), thick=7)
    image = np.full((high, wide, 3), 45.0, np.float32)
    image[: high // 2 + 20] = (70.0, 60.0, 60.0)
    return rgba(image, covered.astype(np.float32))


def people_models(
    atlas: Atlas, rng: np.random.Generator, ground: int, ground_texels_per_m: float
) -> dict[tuple[str, int], list[Mesh]]:
    """Meshes by kind and look, one for every pose (``PersonState.pose``): x forward, z up, origin on the ground.

    The last patch of each is the dark ground under the person, as under vehicles.
    """
    cloth = Surface(atlas.add(plain(rng, (222.0, 222.0, 222.0), 0.10, 64)), (60.0, 60.0), detail_m=0.9, detail=0.5)
    wide = 2.0 * (_AXLE_M + _WHEEL_M)
    bicycle = Surface(atlas.add(_bicycle()), (256.0 / wide, 128.0 / 1.05), detail=0.0, shape=CUT_OUT | TWO_SIDED)
    scale = (ground_texels_per_m, ground_texels_per_m)
    under = Surface(ground, scale, tint=(0.25, 0.25, 0.25), detail=0.5, material=SHADE)
    models: dict[tuple[str, int], list[Mesh]] = {}
    for number in range(LOOKS):
        skin, top, legs = (
            colours[int(rng.integers(len(colours)))] for colours in (_SKINS, _CLOTHES, (*_CLOTHES[:5], _CLOTHES[4]))
        )
        look = _Clothes(
            replace(cloth, tint=skin),
            replace(cloth, tint=_HAIRS[int(rng.integers(len(_HAIRS)))]),
            replace(cloth, tint=top),
            replace(cloth, tint=legs),
            replace(cloth, tint=(0.06, 0.06, 0.06)),
            float(np.clip(rng.normal(1.70, 0.09), 1.5, 1.92)),
        )
        for kind in ("walker", "cyclist"):
            half = 0.2 if kind == "walker" else 0.8
            shade = quad(under, (-half, 0.18, 0.015), (2.0 * half, 0.0, 0.0), (0.0, -0.36, 0.0))
            poses: list[Mesh] = []
            for pose in range(PHASES + 1):
                phase = None if pose == PHASES else pose / PHASES
                parts = _walker(look, phase) if kind == "walker" else _cyclist(look, bicycle, phase or 0.0)
                poses.append(mesh_of([*parts, shade]))
            models[kind, number] = poses
    return models
