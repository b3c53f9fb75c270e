"""The page's colours, read from its style sheet: legible and distinct for colour-blind readers."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest

from ground_station.adapters import web

STYLE = (Path(web.__file__).parent / "page" / "style.css").read_text()
SCHEMES = ("light", "dark")
WORDS = [(ink, ground) for ink in ("ink", "ink2", "ink3") for ground in ("bg", "surface", "raised")]
WORDS += [("blue", "surface"), ("blue", "blue-weak"), ("on-blue", "blue"), ("red", "red-weak"),
          ("red", "surface"), ("amber", "amber-weak"), ("teal", "surface"), ("zone", "land"),
          ("violet", "surface"), ("ink2", "red-weak"), ("ink2", "blue-weak")]  # fmt: skip
SHAPES = ("spare", "truck", "teal", "zone", "red-fill", "edge")
"""Drawn on the ground."""

TEXT, GRAPHIC = 4.5, 3.0
"""WCAG 2.2, 1.4.3 and 1.4.11, level AA."""

APART = 10.0
"""CIELAB 1976; 2.3 is just noticeable (Mahy, Van Eycken and Oosterlinck 1994)."""

SEEN_AS = {
    "all": np.eye(3),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
         [-0.011820, 0.042940, 0.968881]]
    ),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
         [-0.003882, -0.048116, 1.051998]]
    ),
}  # fmt: skip
"""Machado, Oliveira and Fernandes 2009, severity 1, of linear RGB."""

XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750],
     [0.0193339, 0.1191920, 0.9503041]]
)  # fmt: skip
"""Of linear sRGB, D65 (IEC 61966-2-1)."""


def colours(style: str) -> dict[str, dict[str, str]]:
    """By scheme and name."""
    found = re.findall(r"--([a-z0-9-]+): light-dark\((#[0-9a-f]{6}), (#[0-9a-f]{6})\);", style)
    return {scheme: {row[0]: row[k + 1] for row in found} for k, scheme in enumerate(SCHEMES)}


def linear(colour: str) -> np.ndarray:
    """Linear sRGB, 0 to 1."""
    value = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def contrast(one: str, other: str) -> float:
    """WCAG's ratio."""
    low, high = sorted(float(XYZ[1] @ linear(colour)) for colour in (one, other))
    return (high + 0.05) / (low + 0.05)


def lab(rgb: np.ndarray) -> np.ndarray:
    """CIELAB of linear sRGB."""
    ratio = XYZ @ np.clip(rgb, 0.0, 1.0) / XYZ.sum(axis=1)
    x, y, z = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio * (29 / 6) ** 2 / 3 + 4 / 29)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def apart(one: str, other: str, seen_as: str) -> float:
    """Colour difference for this kind of vision."""
    matrix = SEEN_AS[seen_as]
    return float(np.linalg.norm(lab(matrix @ linear(one)) - lab(matrix @ linear(other))))


def test_the_measures_are_the_published_ones():
    """WCAG: black on white 21, #777 on white 4.48; CIELAB of sRGB's red 53.24, 80.09, 67.20."""
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.005)
    assert lab(linear("#ff0000")) == pytest.approx((53.24, 80.09, 67.20), abs=0.02)


def test_canary_red_and_green_of_one_lightness_are_not_apart_for_some():
    assert apart("#b05a3c", "#7d7b33", "all") > APART
    assert apart("#b05a3c", "#7d7b33", "deuteranopia") < APART


@pytest.mark.parametrize("scheme", SCHEMES)
def test_words_and_shapes_stand_out_from_what_they_lie_on(scheme: str):
    found = colours(STYLE)[scheme]
    for word, ground in WORDS:
        assert contrast(found[word], found[ground]) >= TEXT, (word, ground)
    for shape in SHAPES:
        assert contrast(found[shape], found["land"]) >= GRAPHIC, shape


@pytest.mark.parametrize("seen_as", SEEN_AS)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_states_are_told_apart(scheme: str, seen_as: str):
    found = colours(STYLE)[scheme]
    near = {
        (one, other): distance
        for one, other in itertools.combinations(SHAPES, 2)
        if (distance := apart(found[one], found[other], seen_as)) < APART
    }
    assert not near
